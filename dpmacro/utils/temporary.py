"""Temporary folders that go however their process ends; those of processes that were killed go later."""

import shutil
import tempfile
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path

from dpmacro.utils.claims import locked

__all__ = ["remove_all", "temporary_folder"]

PREFIX, LOCK = "dpmacro-files-", ".lock"
_open: set[Path] = set()  # of this process


@contextmanager
def temporary_folder() -> Iterator[Path]:
    """An empty folder in the place for temporary files (TMPDIR), which goes when the block is left.

    The first call in a process removes the folders of processes that were killed, with a warning.
    """
    _sweep(tempfile.gettempdir())
    folder = Path(tempfile.mkdtemp(prefix=PREFIX))
    _open.add(folder)
    try:
        with (folder / LOCK).open("w") as lock:
            locked(lock)
            yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)
        _open.discard(folder)


def remove_all() -> None:
    """Remove the folders of this process, which ends without leaving its blocks."""
    for folder in list(_open):
        shutil.rmtree(folder, ignore_errors=True)


@cache
def _sweep(place: str) -> None:
    swept = [folder for folder in sorted(Path(place).glob(f"{PREFIX}*")) if _is_left(folder)]
    for folder in swept:
        shutil.rmtree(folder, ignore_errors=True)
    if swept:
        warnings.warn(
            f"removed temporary files of processes that were killed: {', '.join(map(str, swept))}",
            stacklevel=2,
        )


def _is_left(folder: Path) -> bool:
    """Whether the folder's process has ended: nobody holds its lock."""
    try:
        with (folder / LOCK).open("r+") as lock:
            return locked(lock) is True
    except (FileNotFoundError, NotADirectoryError, PermissionError):  # just made, no folder, somebody else's
        return False
