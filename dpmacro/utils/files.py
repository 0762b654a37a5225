"""Files that are there whole or not at all, and what is said where a disk is full."""

import errno
import os
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from safetensors import SafetensorError

__all__ = ["NO_SPACE", "named", "replacing", "telling_what_is_safe"]

NO_SPACE = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)  # a disk, a share of one, or a file that may not grow
NUMBER = re.compile(r"os error (\d+)|errno (\d+)", re.IGNORECASE)  # in messages of libraries


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A temporary path beside `path` to write to, flushed to disk and renamed to `path` on leaving.

    Folders above are made. Where the body raises, the temporary file goes and `path` stays as it was.
    The temporary name keeps the suffix, by which many writers choose a format. An error of the file system
    names `path`.
    """
    temporary = path.with_name(f".{path.stem}-{os.getpid()}{path.suffix}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        yield temporary
        with temporary.open("rb") as written:
            os.fsync(written.fileno())
        temporary.replace(path)
    except (OSError, SafetensorError) as error:
        told = named(error, path, temporary)
        if told is error:
            raise
        raise told from error
    finally:
        temporary.unlink(missing_ok=True)


def named(error: Exception, path: Path, temporary: Path | None = None) -> Exception:
    """The error as an OSError of `path`, where it names no file or the temporary one; else itself."""
    number = _number(error)
    known = getattr(error, "filename", None)
    if number is None or (known is not None and str(known) != str(temporary)):
        return error
    return OSError(number, os.strerror(number), str(path))


@contextmanager
def telling_what_is_safe(place: Path, safe: Callable[[], str]) -> Iterator[None]:
    """Where the block ends for lack of space, one line names the file, what is safe, and a remedy.

    Args:
        place: where the block writes; named where the error names no file.
        safe: called then, says what is complete, like "the policy is in outputs/x".

    Raises OSError with that line; other errors pass.
    """
    try:
        yield
    except (OSError, SafetensorError) as error:
        number = _number(error)
        if number not in NO_SPACE:
            raise
        name = getattr(error, "filename", None) or place
        raise OSError(
            f"{name}: cannot be written ({os.strerror(number)}); {safe()}; free some space or give another "
            "place, and run it again"
        ) from error


def _number(error: Exception) -> int | None:
    """The operating system's number of an error; that in its message where a library keeps it there alone."""
    number = getattr(error, "errno", None)
    if isinstance(number, int):
        return number
    found = NUMBER.search(str(error))
    return int(found[1] or found[2]) if found else None
