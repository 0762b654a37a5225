"""The files of a LeRobot dataset, read without LeRobot: no network, no copy in a cache, no torch.

A dataset is a folder: `meta/info.json` names the features, `meta/episodes` says in which file every episode
lies (`layout`), `data/**.parquet` holds a row per frame (images as PNG bytes), `videos/**.mp4` the rest.
"""

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from jaxtyping import Float64

from dpmacro.data.images import DatasetError
from dpmacro.data.lerobot.layout import StoredEpisode, read_episodes, read_tasks
from dpmacro.data.lerobot.rows import Rows
from dpmacro.data.lerobot.schema import MOST_FPS, check_info, check_world, is_whole
from dpmacro.data.lerobot.tables import column_names, is_file, read_json, read_table, to_numpy

__all__ = ["WORLD_FILE", "StoredDataset"]

WORLD_FILE = "meta/dpmacro.json"


@dataclass(frozen=True)
class StoredDataset:
    """What `meta/` says of a dataset; frames are read on demand.

    Attributes:
        root: the dataset's folder.
        info: `meta/info.json`.
        features: name -> {"dtype", "shape", "names", ...}; the type is there, the others where info.json has
            them.
        episodes: all of them, in the order of `episode_index`.
        notes: what a user should know of where the metadata contradicts itself, a line each.
    """

    root: Path
    info: dict[str, Any]
    features: dict[str, dict[str, Any]]
    episodes: list[StoredEpisode]
    notes: tuple[str, ...] = ()

    @classmethod
    def open(cls, root: Path) -> "StoredDataset":
        """Reads the metadata; raises DatasetError where it is missing, half-written or of no known layout."""
        if not root.is_dir():
            raise DatasetError(f"dataset {root}: no such folder; record one with datasets/record.py")
        info = read_json(root / "meta/info.json")
        check_info(root, info)
        if is_file(root / WORLD_FILE):
            check_world(root / WORLD_FILE, read_json(root / WORLD_FILE))
        named = info["features"]
        videos = [name for name, feature in named.items() if feature.get("dtype") == "video"]
        episodes, notes = read_episodes(root, info, videos)
        notes += _check_totals(root, info, episodes)
        return cls(root, info, _typed(named, episodes), episodes, tuple(notes))

    @property
    def fps(self) -> float:
        """Frames per second, a fraction where it is one; by the timestamps where info.json has no number."""
        fps = self.info["fps"]
        if not isinstance(fps, bool) and isinstance(fps, int | float) and 0 < fps <= MOST_FPS:
            return float(fps)
        measured = self._measured_fps
        if measured is None:
            raise DatasetError(
                f"{self.root / 'meta/info.json'}: fps is {json.dumps(fps)[:80]}; write how many frames a "
                "second has"
            )
        return measured

    @cached_property
    def _measured_fps(self) -> float | None:
        """One over the usual step between timestamps of the first episode of two frames or more."""
        if "timestamp" not in self.features:
            return None
        for episode in self.episodes:
            if episode.length is None or episode.length > 1:
                steps = np.diff(self.stamps([episode]))
                step = float(np.median(steps)) if steps.size else 0.0
                return round(1 / step, 3) if 1 / MOST_FPS <= step < math.inf else None
        return None

    @cached_property
    def tasks(self) -> dict[int, str]:
        """What there is to do, in words, by task_index; {} where no file says."""
        return read_tasks(self.root)

    def choose(self, indices: Sequence[int] | None) -> list[StoredEpisode]:
        """The episodes asked for, in that order; all of them where `indices` is None."""
        if indices is None:
            indices = [episode.index for episode in self.episodes]
        if len(indices) == 0 or len(set(indices)) < len(indices):
            raise DatasetError(f"dataset {self.root}: episodes={list(indices)}, give each wanted one once")
        by_index = {episode.index: episode for episode in self.episodes}
        for index in indices:
            if index not in by_index:
                raise DatasetError(
                    f"dataset {self.root}: no episode {index}; it has {len(by_index)}, from {min(by_index)} "
                    f"to {max(by_index)}"
                )
        return [by_index[index] for index in indices]

    @property
    def world(self) -> dict[str, Any]:
        """The world recorded from, of `WORLD_FILE`; {} where there is no such file."""
        return self._recorded("world", {})

    @property
    def truth(self) -> dict[str, list[str]]:
        """Columns of true labels with the names of their classes, of `WORLD_FILE`; {} where it names none."""
        return self._recorded("truth", {})

    @property
    def symmetric(self) -> bool:
        """Whether `WORLD_FILE` declares the world and its mirror image alike; false where it does not say."""
        return self._recorded("symmetric", False)

    def largest(self, feature: str) -> int:
        """The largest value of a scalar feature by `meta/stats.json`; -1 where that does not say."""
        path = self.root / "meta/stats.json"
        statistics = read_json(path).get(feature) if path.exists() else None
        most = statistics.get("max") if isinstance(statistics, dict) else None
        numbers: list[Any] = most if isinstance(most, list) else [most]
        known = [value for value in numbers if is_whole(value) or isinstance(value, float)]
        largest = max(known, default=math.nan) if len(known) == len(numbers) else math.nan
        return int(largest) if is_whole(largest) or math.isfinite(largest) else -1

    def locate(self, episodes: Sequence[StoredEpisode]) -> Rows:
        """The rows of the episodes' frames."""
        return Rows.locate(self.root, episodes)

    def stamps(
        self, episodes: Sequence[StoredEpisode], rows: Rows | None = None
    ) -> Float64[np.ndarray, " frames"]:
        """The `timestamp` of every frame, in seconds; arguments and errors as of `columns`."""
        found = self.scalars(["timestamp"], episodes, rows)["timestamp"].astype(np.float64)
        if not np.isfinite(found).all():
            raise DatasetError(f"dataset {self.root}: timestamp is not finite somewhere; write seconds")
        return found

    def scalars(
        self, names: Sequence[str], episodes: Sequence[StoredEpisode], rows: Rows | None = None
    ) -> dict[str, np.ndarray]:
        """Columns of one number a frame, as [frames]; arguments and errors as of `columns`."""
        rows = self.locate(episodes) if rows is None else rows
        found = self.columns(names, episodes, rows)
        for name, values in found.items():
            if values.size != rows.lengths.sum() or values.dtype.kind not in "biuf":
                raise DatasetError(f"dataset {self.root}: {name} is not one number a frame; write one")
        return {name: values.reshape(-1) for name, values in found.items()}

    def columns(
        self, names: Sequence[str], episodes: Sequence[StoredEpisode], rows: Rows | None = None
    ) -> dict[str, np.ndarray]:
        """The named columns of the given episodes, concatenated in their order.

        A scalar feature comes as [frames], a vector of any shape as [frames, size]. `rows` says where the
        frames lie, if that is known already. Raises DatasetError for missing values and for vectors of
        different sizes.
        """
        rows = self.locate(episodes) if rows is None else rows
        pieces: dict[str, list[np.ndarray]] = {name: [] for name in names}
        for part in rows.parts:
            table = read_table(part.path, list(names), part.rows)
            for name in names:
                pieces[name].append(to_numpy(table[name], f"{part.path}: {name}", part.places))
        back = np.argsort(np.concatenate([part.places for part in rows.parts]))
        for name, of_parts in pieces.items():
            shapes = {piece.shape[1:] for piece in of_parts}
            if len({piece.dtype.kind == "O" for piece in of_parts}) > 1:
                raise DatasetError(
                    f"dataset {self.root}: {name} is text in one file and numbers in another; store one kind"
                )
            if len(shapes) > 1:
                raise DatasetError(
                    f"dataset {self.root}: {name} has {' and '.join(map(str, sorted(shapes)))} numbers "
                    "in different "
                    "files; store as many in all"
                )
        return {name: np.concatenate(of_parts)[back] for name, of_parts in pieces.items()}

    def _recorded(self, key: str, default: Any) -> Any:
        path = self.root / WORLD_FILE
        return read_json(path).get(key, default) if path.exists() else default


def _check_totals(root: Path, info: dict[str, Any], episodes: list[StoredEpisode]) -> list[str]:
    """A line where info.json counts more frames than there are; DatasetError where it counts more episodes.

    Files are missing then. LeRobot looks for them on the network, where it reads on without frames.
    """
    lengths = [episode.length for episode in episodes]
    frames = sum(length or 0 for length in lengths)
    promised = {key: info.get(key) for key in ("total_episodes", "total_frames")}
    counts = (
        f"info.json says {promised['total_episodes']} episodes and {promised['total_frames']} frames, "
        f"meta/episodes lists {len(lengths)} and {frames}"
    )
    if isinstance(promised["total_episodes"], int) and promised["total_episodes"] > len(lengths):
        raise DatasetError(
            f"dataset {root}: half-written, {counts}; record or copy it again, or correct total_episodes"
        )
    more = isinstance(promised["total_frames"], int) and promised["total_frames"] > frames
    return [f"{counts}: those are read"] if more and None not in lengths else []


def _typed(named: dict[str, dict[str, Any]], episodes: list[StoredEpisode]) -> dict[str, dict[str, Any]]:
    """The features, each with a type: that of the data where info.json names none."""
    untyped = [name for name, feature in named.items() if not isinstance(feature.get("dtype"), str)]
    named = {
        name: {key: value for key, value in feature.items() if key != "dtype" or name not in untyped}
        for name, feature in named.items()
    }
    first = next((one.data for one in episodes if one.data is not None and one.data.is_file()), None)
    if not untyped or first is None:
        return {name: {"dtype": "", **feature} for name, feature in named.items()}
    there = [name for name in untyped if name in column_names(first)]
    schema = read_table(first, there, np.array([], np.int64)).schema if there else pa.schema([])
    found = {name: {"dtype": _type_name(schema.field(name).type)} for name in there}
    return {name: {"dtype": "", **feature, **found.get(name, {})} for name, feature in named.items()}


def _type_name(kind: pa.DataType) -> str:
    while pa.types.is_list(kind) or pa.types.is_large_list(kind) or pa.types.is_fixed_size_list(kind):
        kind = kind.value_type
    if pa.types.is_struct(kind) or pa.types.is_binary(kind):
        return "image"
    return {"float": "float32", "double": "float64", "halffloat": "float16"}.get(str(kind), str(kind))
