"""A LeRobot dataset with the stages of its frames: a new one, the old one is never written to."""

import errno
import hashlib
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import pyarrow as pa
from tqdm import tqdm

from dpmacro.annotation.exports.base import Export, Labelled, Make
from dpmacro.annotation.exports.folders import copy, files_of, link_or_copy, refuse_places, unfinished
from dpmacro.annotation.exports.formats import FORMATS, choose, default_formats
from dpmacro.annotation.exports.labelling import formats_of, labelled_dataset
from dpmacro.annotation.exports.macro_action import MacroAction
from dpmacro.annotation.exports.rewriting import rewrite
from dpmacro.annotation.exports.statistics import episode_columns, is_statistic_of, with_statistics
from dpmacro.annotation.stages import Stages
from dpmacro.data.lerobot.tables import column_names, read_json
from dpmacro.utils.checks import as_entries, as_kind, as_path
from dpmacro.utils.files import replacing

__all__ = ["WrittenLabels", "write_labels", "writing_labels"]

LAYOUT = 1  # of what is written: another one is not gone on with
INFO, STATISTICS = "meta/info.json", "meta/stats.json"
NO_SPACE = (errno.ENOSPC, errno.EDQUOT)
NO_PLACE = (errno.EACCES, errno.EPERM, errno.EROFS, errno.ENOTDIR, errno.ENAMETOOLONG)


@dataclass(frozen=True)
class WrittenLabels:
    """A dataset with labels.

    Attributes:
        root: its folder.
        formats: those it has, by name.
        notes: what a user should know of it, a line each.
    """

    root: Path
    formats: tuple[str, ...]
    notes: tuple[str, ...]


def write_labels(
    root: str | Path,
    output: str | Path,
    stages: Stages,
    formats: Sequence[str] | None = None,
    *,
    skip: bool = False,
) -> WrittenLabels:
    """Write a dataset's stages into a new dataset, which has all that the old one has.

    Every frame gets `macro_action` int64, `confidence` float32 (0..1), `idle` and `corrected` bool; the
    formats add to them. Columns of the same names are replaced. Videos and image files are hard links to
    those of the old dataset, or copies where the file system has no such links; nothing is encoded again. The
    new folder has its name once it is complete. A call after one that was stopped goes on with what was
    written.

    Args:
        root: the folder of a LeRobot dataset of format v3; it is never written to.
        output: the folder of the new one; it must not exist, or be empty.
        stages: of all its episodes, in any order.
        formats: names of `FORMATS`; by default those that the installed LeRobot reads, and csv. Those that
            the dataset has from an annotation before are written anew beside them.
        skip: whether a format that cannot say what the stages are is left out, with a note; otherwise that
            is an error, and nothing is written.

    Raises ValueError (DatasetError where the dataset is what is wrong), one line with a remedy, for a dataset
    that is damaged, of another format, or has other episodes than the labels; for folders that exist or lie
    in each other; for formats that there are not or that cannot be written. Raises OSError, one line
    with the place, where there is no space, or no right to write.
    """
    with writing_labels(root, output, stages, formats, skip=skip) as written:
        return written


@contextmanager
def writing_labels(
    root: str | Path,
    output: str | Path,
    stages: Stages,
    formats: Sequence[str] | None = None,
    *,
    skip: bool = False,
) -> Iterator[WrittenLabels]:
    """The same for what has to be done before the new folder gets its name, which it does after the block.

    The dataset is written before the block begins. Where the block raises, or is stopped, there is no new
    folder, and a later call goes on with what was written. Arguments and errors are those of `write_labels`.
    """
    root, output = as_path("root", root), as_path("output", output)
    as_kind("stages", stages, Stages)
    if formats is not None:
        as_entries("formats", formats)
    refuse_places(root, output)
    labelled = labelled_dataset(root, stages)
    before = formats_of(root)
    wanted = default_formats() if formats is None else formats
    exports, notes = choose(wanted, before, labelled, skip)
    written = tuple(export.name for export in exports)
    first = MacroAction(labelled, written)
    dropped = tuple(FORMATS[name] for name in before if name not in written)
    build = _Build(labelled, files_of(root), (first, *exports), dropped)
    with ExitStack() as stack:
        try:
            build.write(stack.enter_context(unfinished(output, build.fingerprint)))
        except OSError as error:
            raise _told(output, error) from error
        yield WrittenLabels(output, written, (*build.replaced(), *notes))


@dataclass(frozen=True)
class _Build:
    """What the new dataset's files are made of.

    Attributes:
        labelled: the old dataset and the stages.
        stored: the old dataset's files by their path in it.
        exports: what is added.
        dropped: formats of an annotation before that are not written anew.
    """

    labelled: Labelled
    stored: Mapping[str, Path]
    exports: tuple[Export, ...]
    dropped: tuple[type[Export], ...]

    @cached_property
    def fingerprint(self) -> str:
        """Alike where the same is to be written of the same files."""
        stages = self.labelled.stages
        digest = hashlib.sha256()
        for part in (stages.labels, stages.confidence, stages.idle, stages.corrected, stages.lengths):
            digest.update(str(part.dtype).encode() + part.tobytes())
        sizes = {
            name: (status.st_size, status.st_mtime_ns)
            for name, status in ((name, path.stat()) for name, path in self.stored.items())
        }
        formats = [export.name for export in self.exports], [export.name for export in self.dropped]
        told = LAYOUT, str(self.labelled.store.root.resolve()), stages.names, stages.episodes, sizes, formats
        digest.update(json.dumps(told).encode())
        return digest.hexdigest()

    def write(self, folder: Path) -> None:
        """Write what is not there yet, meta/info.json last; a file under its own name is complete."""
        files = self._files()
        ordered = sorted(files, key=lambda name: (name == INFO, name))
        for name in tqdm(ordered, "Dataset", unit="file"):
            target = folder / name
            if not target.exists():
                files[name](target)
        for path in folder.rglob("*"):  # temporary files of a run that was killed
            if path.is_file() and path.relative_to(folder).as_posix() not in files:
                path.unlink()

    def replaced(self) -> list[str]:
        """Lines for what the old dataset has under the same names."""
        of_episodes = {name for path in self._episode_tables for name in column_names(path)}
        columns = [name for name in self._columns if name in self.labelled.store.features]
        columns += [name for one in self.exports for name in one.episode_columns if name in of_episodes]
        files = [name for one in self.exports for name in one.files if name in self.stored]
        named = {"columns": columns, "files": files}
        return [f"{what} replaced: {', '.join(names)}" for what, names in named.items() if names]

    def _files(self) -> dict[str, Make]:
        """By the path of every file in the new dataset, a function that writes it."""
        gone = {name for export in self.dropped for name in export.files}
        made = {name: _whole(make) for export in self.exports for name, make in export.make().items()}
        copied = {name: self._copy(name, path) for name, path in self.stored.items() if name not in gone}
        return {**copied, **made}

    def _copy(self, name: str, path: Path) -> Make:
        top = name.split("/")[0]
        if path in self.labelled.places:
            return _whole(lambda target: rewrite(path, target, self._of_frames(path), self._gone))
        if path in self._episode_tables:
            return _whole(lambda target: self._write_episodes(path, target))
        if name == INFO:
            return _whole(self._write_info)
        if name == STATISTICS:
            return _whole(lambda target: self._write_statistics(path, target))
        if top in ("videos", "images"):
            return lambda target: link_or_copy(path, target)
        return _whole(lambda target: copy(path, target))

    @cached_property
    def _episode_tables(self) -> list[Path]:
        return [
            path
            for name, path in self.stored.items()
            if name.startswith("meta/episodes/") and name.endswith(".parquet")
        ]

    @cached_property
    def _columns(self) -> list[str]:
        return [name for export in self.exports for name in export.columns]

    @cached_property
    def _gone(self) -> set[str]:
        """Columns of frames that are left out."""
        return {name for export in self.dropped for name in export.columns}

    @cached_property
    def _numbers(self) -> dict[str, Any]:
        return {name: values for export in self.exports for name, values in export.numbers().items()}

    def _of_frames(self, path: Path) -> Callable[[int, pa.Table], dict[str, pa.Array]]:
        places = self.labelled.places[path]

        def columns(first: int, table: pa.Table) -> dict[str, pa.Array]:
            some = places[first : first + len(table)]
            return {
                name: values
                for export in self.exports
                for name, values in export.of_frames(some, table).items()
            }

        return columns

    @cached_property
    def _of_episodes(self) -> dict[str, pa.Array]:
        """New columns of meta/episodes; statistics where it has some already."""
        columns = {name: values for export in self.exports for name, values in export.of_episodes().items()}
        stored = (name for path in self._episode_tables for name in column_names(path))
        if any(name.startswith("stats/") for name in stored):
            columns |= episode_columns(self._numbers, self.labelled.stages.trajectories)
        return columns

    def _write_episodes(self, path: Path, target: Path) -> None:
        place_of = {episode: place for place, episode in enumerate(self.labelled.stages.episodes)}

        def columns(first: int, table: pa.Table) -> dict[str, pa.Array]:
            places = pa.array([place_of[episode] for episode in table["episode_index"].to_pylist()])
            return {name: values.take(places) for name, values in self._of_episodes.items()}

        changed = {*self._gone, *(name for export in self.exports for name in export.columns)}
        gone = {name for export in self.dropped for name in export.episode_columns}
        gone |= {
            name
            for name in column_names(path)
            if is_statistic_of(name, changed) and name not in self._of_episodes
        }
        rewrite(path, target, columns, gone)

    def _write_info(self, target: Path) -> None:
        info = self.labelled.store.info
        features = {name: value for name, value in info["features"].items() if name not in self._gone}
        for export in self.exports:
            features |= export.features()
        _write_json(target, {**info, "features": features})

    def _write_statistics(self, path: Path, target: Path) -> None:
        changed = {*self._gone, *self._columns}
        _write_json(target, with_statistics(read_json(path), self._numbers, changed))


def _whole(make: Make) -> Make:
    """The same for a file that is there complete or not at all."""

    def write(target: Path) -> None:
        with replacing(target) as temporary:
            make(temporary)

    return write


def _write_json(target: Path, content: Any) -> None:
    target.write_text(json.dumps(content, indent=4, ensure_ascii=False) + "\n", encoding="utf-8")


def _told(output: Path, error: OSError) -> OSError:
    """What went wrong in one line, with a remedy."""
    reason = " ".join((error.strerror or str(error)).split())
    where = f" at {error.filename}" if error.filename else ""
    if error.errno in NO_SPACE:
        remedy = "free some space and run it again: it goes on with what is written"
    elif error.errno in NO_PLACE:
        remedy = "give a folder that you may write to"
    else:
        remedy = "run it again: it goes on with what is written"
    return OSError(f"--output={output}: cannot be written ({reason}{where}); {remedy}")
