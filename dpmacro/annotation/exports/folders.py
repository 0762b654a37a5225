"""Folders that are named once they are complete, and the files of a dataset that go into another one."""

import errno
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from dpmacro.data.images import DatasetError
from dpmacro.utils.claims import locked
from dpmacro.utils.files import replacing

__all__ = [
    "copy",
    "files_of",
    "link_or_copy",
    "refuse_places",
    "refuse_unwritable",
    "refuse_within",
    "unfinished",
]

# What a file system says that has no hard links, or none from the one to the other.
NO_LINKS = {
    errno.EXDEV,
    errno.EPERM,
    errno.EACCES,
    errno.EMLINK,
    errno.EOPNOTSUPP,
    errno.ENOSYS,
    errno.EINVAL,
}
INFO = "meta/info.json"


def refuse_places(root: Path, output: Path) -> None:
    """Raise ValueError where `output` exists, or one of the two folders would lie in the other."""
    source, target = root.resolve(), output.resolve()
    if source == target or source in target.parents or target in source.parents:
        raise ValueError(
            f"--output={output} and the dataset {root} lie one in the other: give a folder beside it"
        )
    if output.is_symlink() or (output.exists() and not _is_empty_folder(output)):
        what = "holds a dataset already" if (output / INFO).exists() else "exists already"
        raise ValueError(f"--output={output}: {what}; remove it or give another")


def refuse_unwritable(option: str, folder: Path) -> None:
    """Raise OSError, one line, where nothing can be written into a folder that is yet to be made.

    Nothing is written to find out: what holds the folder is asked for its rights.
    """
    holder = folder
    while not os.path.lexists(holder) and holder != holder.parent:
        holder = holder.parent
    if not holder.is_dir():
        raise NotADirectoryError(f"{option}={folder}: {holder} is no folder; give a place in one")
    if not os.access(holder, os.W_OK | os.X_OK):
        raise PermissionError(
            f"{option}={folder}: {holder.resolve()} cannot be written to; give a folder that you may write to"
        )


def refuse_within(output_dir: Path, root: Path, output: Path | None) -> None:
    """Raise ValueError where the page would lie in one of the datasets: the old one is never written to."""
    page = output_dir.resolve()
    for dataset in (root, output):
        if dataset is not None and (page == dataset.resolve() or dataset.resolve() in page.parents):
            raise ValueError(
                f"--output_dir={output_dir}: lies in the dataset {dataset}; give a folder that does not"
            )


@contextmanager
def unfinished(output: Path, fingerprint: str) -> Iterator[Path]:
    """A hidden folder beside `output` to build a dataset in; leaving the block gives it its name.

    Where the block is left by a ValueError, the folder goes. Where it is left by anything else, or the
    process is killed, the folder stays, and a later call with the same fingerprint goes on with its files.
    Two processes never write to it at once, as far as the file system has locks.

    Raises ValueError where another process writes to it, or `output` has come into being.
    """
    partial = output.with_name(f".{output.name}.partial")
    partial.mkdir(parents=True, exist_ok=True)
    with (partial / "lock").open("w") as lock:
        if locked(lock) is False:  # None where there are no locks
            raise ValueError(f"--output={output}: another process writes it; wait for that, or stop it")
        if output.is_symlink() or (output.exists() and not _is_empty_folder(output)):
            raise ValueError(f"--output={output}: exists already; remove it or give another")
        dataset, written = partial / "dataset", partial / "fingerprint"
        if not written.is_file() or written.read_text() != fingerprint:
            shutil.rmtree(dataset, ignore_errors=True)
            with replacing(written) as temporary:
                temporary.write_text(fingerprint)
        dataset.mkdir(exist_ok=True)
        try:
            yield dataset
        except ValueError:
            shutil.rmtree(partial, ignore_errors=True)
            raise
        dataset.rename(output)
        shutil.rmtree(partial, ignore_errors=True)


def files_of(root: Path) -> dict[str, Path]:
    """The files of a dataset by their path in it, links followed; hidden folders at the top left out.

    Raises DatasetError for what is neither a file nor a folder, and for a folder that holds itself.
    """
    return {path.relative_to(root).as_posix(): path for path in _walk(root, ())}


def copy(source: Path, target: Path) -> None:
    """Write what a file holds to another one."""
    shutil.copyfile(source, target)


def link_or_copy(source: Path, target: Path) -> None:
    """Give a file a second name, or copy it where the file system has no hard links between the two."""
    target.parent.mkdir(parents=True, exist_ok=True)
    try:
        os.link(source.resolve(), target)
    except OSError as error:
        if error.errno not in NO_LINKS:
            raise
        with replacing(target) as temporary:
            copy(source, temporary)


def _walk(folder: Path, above: tuple[Path, ...]) -> Iterator[Path]:
    real = folder.resolve()
    if real in above:
        raise DatasetError(f"{folder}: is a link to a folder that it lies in; remove it")
    for path in sorted(folder.iterdir()):
        if path.is_dir():
            if above or not path.name.startswith("."):
                yield from _walk(path, (*above, real))
        elif path.is_file():
            yield path
        else:
            raise DatasetError(
                f"{path}: is neither a file nor a folder, a broken link say; remove or restore it"
            )


def _is_empty_folder(path: Path) -> bool:
    return path.is_dir() and not any(path.iterdir())
