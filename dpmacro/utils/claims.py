"""Output folders that one process at a time writes to.

A process that writes to a folder holds a claim of it: a file with a lock, which the operating system lifts
when the process ends, however it ends. A file without a lock is the claim of a process that was killed.
"""

import errno
import json
import os
import re
import shutil
import socket
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

__all__ = ["CLAIM", "Claim", "claimed", "locked"]

CLAIM = ".claim"
NO_LOCKS = (errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP)
LARGEST = 1000  # bytes of a claim that are read


@dataclass(frozen=True)
class Claim:
    """That this process alone writes to a folder.

    Attributes:
        folder: the folder.
        dead: number of a process that held a claim of it and was killed; None where there was none.
    """

    folder: Path
    dead: int | None = None


@contextmanager
def claimed(folder: Path, option: str = "--output_dir", *, beside: bool = False) -> Iterator[Claim]:
    """Claim a folder, new or old, until the block is left.

    Then the claim goes, and so do folders that were made and stayed empty. The claim of a process that was
    killed is taken over, with its temporary files removed and a warning that says so. Two processes never
    hold a claim of one folder, as far as the file system has locks.

    Args:
        folder: made with those above it, unless the claim lies beside it.
        option: the command line's name of the folder, for messages.
        beside: whether the claim lies beside the folder, which gets its name when it is complete.

    Raises ValueError where another process has claimed the folder, or `folder` is a file.
    """
    holder = folder.absolute().parent if beside else folder
    path = holder / f".{folder.absolute().name}{CLAIM}" if beside else holder / CLAIM
    made = [one for one in (holder, *holder.parents) if not one.exists()]
    if holder.exists() and not holder.is_dir():
        raise ValueError(f"{option}={folder}: {holder} exists and is no folder; give another place")
    try:
        file, dead = _taken(path, folder, option)
        try:
            if dead is not None:
                _take_over(folder, dead, beside)
            yield Claim(folder, dead)
        finally:
            path.unlink(missing_ok=True)
            file.close()
    finally:
        with suppress(OSError):  # something lies in it
            for one in made:
                with suppress(FileNotFoundError):
                    one.rmdir()


def locked(file: IO[str]) -> bool | None:
    """Whether this process has got the lock of an open file; None where there are no locks."""
    try:
        import fcntl
    except ImportError:  # not on Windows
        return None
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError as error:
        if error.errno not in NO_LOCKS:
            raise
        return None
    return True


def _taken(path: Path, folder: Path, option: str) -> tuple[IO[str], int | None]:
    """The claim's file, open and locked, and the number of the killed process that had claimed it."""
    while True:
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            file = path.open("a+")
        except FileNotFoundError:  # the folder went with the claim of a process that ended just now
            continue
        free = locked(file)
        holder = _holder(file)
        if free is False or (free is None and _runs(holder)):
            file.close()
            raise ValueError(
                f"{option}={folder}: {_told(holder)} writes to it; wait for that, or give another folder"
            )
        if _is_still(path, file):
            file.truncate(0)
            file.write(json.dumps({"process": os.getpid(), "host": socket.gethostname()}))
            file.flush()
            return file, holder.get("process")
        file.close()


def _holder(file: IO[str]) -> dict[str, Any]:
    """What a claim says of its process; {} where it says nothing yet."""
    file.seek(0)
    try:
        found = json.loads(file.read(LARGEST))
    except ValueError:
        return {}
    if not isinstance(found, dict) or type(found.get("process")) is not int or found["process"] < 1:
        return {}
    return found


def _told(holder: dict[str, Any]) -> str:
    if not holder:
        return "another process"
    return f"process {holder['process']} on {holder.get('host')}"


def _runs(holder: dict[str, Any]) -> bool:
    """Whether the process may still run; asked only where there are no locks."""
    if not holder or holder.get("host") != socket.gethostname():
        return bool(holder)
    try:
        os.kill(holder["process"], 0)
    except ProcessLookupError:
        return False
    except PermissionError:  # somebody else's
        return True
    return True


def _is_still(path: Path, file: IO[str]) -> bool:
    """Whether the path still leads to the open file, which its last holder may have removed."""
    try:
        return path.stat().st_ino == os.fstat(file.fileno()).st_ino
    except FileNotFoundError:
        return False


def _take_over(folder: Path, dead: int, beside: bool) -> None:
    """Remove the temporary files of a killed process, and say so."""
    if beside:
        left = sorted(folder.absolute().parent.glob(f".{_literal(folder.absolute().name)}.*.partial"))
    else:
        own = re.compile(rf"\..+-{dead}(\..+)?")
        left = sorted(path for path in folder.rglob(f".*-{dead}*") if own.fullmatch(path.name))
    for path in left:
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path)
        else:
            path.unlink(missing_ok=True)
    removed = f" and removes what it left half-written: {', '.join(map(str, left))}" if left else ""
    warnings.warn(
        f"{folder}: process {dead} was killed while it wrote to it; this one takes over{removed}",
        stacklevel=1,
    )


def _literal(name: str) -> str:
    """A name as a pattern that matches it alone."""
    return re.sub(r"([*?[])", r"[\1]", name)
