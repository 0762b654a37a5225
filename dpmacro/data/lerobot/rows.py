"""Which rows of which parquet files are the frames of chosen episodes, in the order of their frame_index."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Int64

from dpmacro.data.images import DatasetError
from dpmacro.data.lerobot.layout import StoredEpisode
from dpmacro.data.lerobot.tables import HALF_COPIED, column_names, read_table, to_numpy

__all__ = ["Part", "Rows"]


@dataclass(frozen=True)
class Part:
    """Frames that lie in one file: row `rows[k]` of it is frame `places[k]`."""

    path: Path
    rows: Int64[np.ndarray, " frames"]
    places: Int64[np.ndarray, " frames"]


@dataclass(frozen=True)
class Rows:
    """The frames of episodes, concatenated in the order asked for.

    Attributes:
        lengths: frames of each episode.
        parts: where they lie, a file each.
        unordered: indices of the episodes whose frame_index repeats, so that rows are in the files' order.
        skipping: indices of the episodes whose frame_index leaves numbers out.
    """

    lengths: Int64[np.ndarray, " episodes"]
    parts: tuple[Part, ...]
    unordered: tuple[int, ...] = ()
    skipping: tuple[int, ...] = ()

    @classmethod
    def locate(cls, root: Path, episodes: Sequence[StoredEpisode]) -> "Rows":
        """Finds them in the files that the metadata names and, where those lack rows, in all others.

        An episode of which the metadata gives no length may have no rows. Raises DatasetError where one has
        not as many as the metadata says.
        """
        found: dict[int, list[tuple[Path, np.ndarray, np.ndarray]]] = {
            episode.index: [] for episode in episodes
        }
        by_file: dict[Path, list[int]] = {}
        for episode in episodes:
            if episode.data is not None:
                by_file.setdefault(episode.data, []).append(episode.index)
        for path, indices in by_file.items():
            if path.is_file():
                _scan(path, indices, found)
        short = [episode for episode in episodes if not _complete(episode, found)]
        if short:
            for path in sorted((root / "data").glob("**/*.parquet")):
                elsewhere = [one.index for one in short if one.data != path]
                if elsewhere:
                    _scan(path, elsewhere, found)
        for episode in short:
            _refuse_incomplete(root, episode, found[episode.index])
        return cls._of(episodes, found)

    @classmethod
    def _of(
        cls,
        episodes: Sequence[StoredEpisode],
        found: dict[int, list[tuple[Path, np.ndarray, np.ndarray]]],
    ) -> "Rows":
        parts: dict[Path, list[tuple[np.ndarray, np.ndarray]]] = {}
        lengths, unordered, skipping, start = [], [], [], 0
        for episode in episodes:
            pieces = found[episode.index]
            if not pieces:
                lengths.append(0)
                continue
            frame_index = np.concatenate([frame for _, _, frame in pieces])
            order = np.argsort(frame_index, kind="stable")
            steps = np.diff(frame_index[order])
            if (steps == 0).any():  # it numbers nothing
                order = np.arange(len(order))
                unordered.append(episode.index)
            elif (steps > 1).any():
                skipping.append(episode.index)
            places = np.empty(len(order), np.int64)
            places[order] = start + np.arange(len(order))
            first = 0
            for path, rows, _ in pieces:
                parts.setdefault(path, []).append((rows, places[first : first + len(rows)]))
                first += len(rows)
            lengths.append(len(order))
            start += len(order)
        joined = (
            Part(path, *(np.concatenate(side) for side in zip(*pieces, strict=True)))
            for path, pieces in parts.items()
        )
        return cls(np.array(lengths, np.int64), tuple(joined), tuple(unordered), tuple(skipping))


def _scan(
    path: Path, indices: Iterable[int], found: dict[int, list[tuple[Path, np.ndarray, np.ndarray]]]
) -> None:
    """Add the rows of the episodes in a file, with their frame_index, or 0 where it misses a value.

    Where there is no frame_index, rows are numbered as they come.
    """
    names = ["episode_index"] + (["frame_index"] if "frame_index" in column_names(path) else [])
    table = read_table(path, names)
    numbers = np.arange(len(table))
    whole = [name for name in names if name == "episode_index" or not table[name].null_count]
    columns = {name: to_numpy(table[name], f"{path}: {name}", numbers).reshape(-1) for name in whole}
    for name, values in columns.items():
        if len(values) != len(numbers) or values.dtype.kind not in "biuf":
            raise DatasetError(f"{path}: {name} is not one number a row; write one")
    order = np.argsort(columns["episode_index"], kind="stable")
    frame = columns.get("frame_index", numbers if names == whole else np.zeros_like(numbers))
    for index in indices:
        first, last = (
            np.searchsorted(columns["episode_index"], index, side, sorter=order) for side in ("left", "right")
        )
        rows = order[first:last]
        if len(rows):
            found[index].append((path, rows, frame[rows]))


def _complete(episode: StoredEpisode, found: dict[int, list[tuple[Path, np.ndarray, np.ndarray]]]) -> bool:
    count = sum(len(rows) for _, rows, _ in found[episode.index])
    return count > 0 if episode.length is None else count == episode.length


def _refuse_incomplete(
    root: Path, episode: StoredEpisode, pieces: list[tuple[Path, np.ndarray, np.ndarray]]
) -> None:
    count = sum(len(rows) for _, rows, _ in pieces)
    if count == episode.length or (count and episode.length is None):
        return
    if not count and episode.data is not None and not episode.data.is_file():
        raise DatasetError(f"{episode.data}: is missing; {HALF_COPIED}")
    if episode.length is None:
        return
    file = "the data files" if episode.data is None else episode.data.name
    raise DatasetError(
        f"dataset {root}: half-written, episode {episode.index} has {episode.length} frames by "
        "meta/episodes and "
        f"{count} in {file}; record it again"
    )
