"""Folders that are there whole or not at all."""

import os
from pathlib import Path

from dpmacro import interrupts


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
