"""Files and folders that are there whole or not at all."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from dpmacro.utils import interrupts


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A temporary path beside `path` to write to, flushed to disk and renamed to `path` on leaving.

    Folders above are made. Where the body raises, the temporary file goes and `path` stays as it was.
    The temporary name keeps the suffix, by which many writers choose a format.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.stem}-{os.getpid()}{path.suffix}")
    try:
        yield temporary
        with temporary.open("rb") as written:
            os.fsync(written.fileno())
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


def replace_folder(old: Path, new: Path, aside: Path) -> None:
    """`new`, flushed to disk, gets the name of `old`, which gets the name `aside`, free until then.

    All three lie on one file system. No interrupt and no error leaves less under the name of `old` than the
    one folder or the other.
    """
    for path in new.rglob("*"):
        if path.is_file():
            with path.open("rb") as file:
                os.fsync(file.fileno())
    with interrupts.held_back():
        old.rename(aside)
        try:
            new.rename(old)
        except BaseException:
            aside.rename(old)
            raise
