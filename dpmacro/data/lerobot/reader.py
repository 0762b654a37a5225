"""The files of a LeRobot v3 dataset, read without LeRobot: no network, no copy in a cache, no torch.

A dataset is a folder: `meta/info.json` names the features, `meta/episodes/**.parquet` says in which file
every episode lies, `data/**.parquet` holds a row per frame (images as PNG bytes), `videos/**.mp4` the rest.
"""

import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from dpmacro.data.images import DatasetError, FrameBuffer
from dpmacro.data.lerobot.decoding import decode_images, decode_video

WORLD_FILE = "meta/dpmacro.json"


@dataclass(frozen=True)
class StoredDataset:
    """What `meta/` says of a dataset; frames are read on demand.

    Attributes:
        root: the dataset's folder.
        info: `meta/info.json`.
        episodes: one row of `meta/episodes` per episode, in the order of `episode_index`.
    """

    root: Path
    info: dict[str, Any]
    episodes: list[dict[str, Any]]

    @classmethod
    def open(cls, root: Path) -> "StoredDataset":
        """Reads the metadata; raises DatasetError where it is missing, half-written or not v3.x."""
        if not root.is_dir():
            raise DatasetError(f"dataset {root}: no such folder; record one with datasets/record.py")
        info = _read_json(root / "meta/info.json")
        for key in ("codebase_version", "features", "fps", "total_episodes", "total_frames", "data_path"):
            if key not in info:
                raise DatasetError(
                    f"dataset {root}: meta/info.json has no {key}; it is no LeRobot v3 dataset"
                )
        version = str(info.get("codebase_version"))
        if not version.startswith("v3."):
            raise DatasetError(
                f"dataset {root}: LeRobot format {version}, dpmacro reads v3.x; convert it with LeRobot"
            )
        episodes = _read_episodes(root)
        frames = sum(episode["length"] for episode in episodes)
        if info["total_episodes"] > len(episodes) or info["total_frames"] > frames:
            raise DatasetError(
                f"dataset {root}: half-written, info.json says {info['total_episodes']} episodes and "
                f"{info['total_frames']} frames, meta/episodes lists {len(episodes)} and {frames}; "
                "record it again"
            )
        return cls(root, info, episodes)

    @property
    def features(self) -> dict[str, dict[str, Any]]:
        """Name -> {"dtype", "shape", "names"}."""
        return self.info["features"]

    def choose(self, indices: Sequence[int] | None) -> list[dict[str, Any]]:
        """The rows of the episodes asked for, in that order; all of them where `indices` is None."""
        if indices is None:
            indices = [episode["episode_index"] for episode in self.episodes]
        if len(indices) == 0 or len(set(indices)) < len(indices):
            raise DatasetError(f"dataset {self.root}: episodes={list(indices)}, give each wanted one once")
        by_index = {episode["episode_index"]: episode for episode in self.episodes}
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
        """Whether `WORLD_FILE` declares the world and its mirror image alike; false where it does not say.

        Raises DatasetError for a value that is neither true nor false.
        """
        declared = self._recorded("symmetric", False)
        if not isinstance(declared, bool):
            raise DatasetError(
                f"{self.root / WORLD_FILE}: symmetric is {json.dumps(declared)}; write true or false"
            )
        return declared

    def largest(self, feature: str) -> int:
        """The largest value of a scalar feature by `meta/stats.json`; -1 where that does not say."""
        path = self.root / "meta/stats.json"
        statistics = _read_json(path).get(feature, {}) if path.exists() else {}
        return int(max(statistics.get("max", [-1])))

    def columns(self, names: Sequence[str], episodes: list[dict[str, Any]]) -> dict[str, np.ndarray]:
        """The named columns of the given episodes, concatenated in their order.

        A scalar feature comes as [frames], a vector as [frames, size], an image as [frames] of buffers that
        hold its PNG.
        """
        pieces: dict[str, dict[int, np.ndarray]] = {name: {} for name in names}
        for path, group in _by_file(episodes, "data", self._data_file):
            # One row group an episode: the filter skips what other episodes hold without reading it.
            wanted = None if len(episodes) == len(self.episodes) else [row["episode_index"] for row in group]
            table = _read_table(path, ["episode_index", *names], wanted)
            of_row = table["episode_index"].to_numpy()
            order = np.argsort(of_row, kind="stable")
            starts = np.searchsorted(of_row, [row["episode_index"] for row in group], sorter=order)
            ends = np.searchsorted(of_row, [row["episode_index"] for row in group], "right", sorter=order)
            for row, start, end in zip(group, starts, ends, strict=True):
                if end - start != row["length"]:
                    raise DatasetError(
                        f"dataset {self.root}: half-written, episode {row['episode_index']} has "
                        f"{row['length']} frames by meta/episodes and {end - start} in {path.name}; "
                        "record it again"
                    )
            for name in names:
                values = _to_numpy(table[name])
                for row, start, end in zip(group, starts, ends, strict=True):
                    pieces[name][row["episode_index"]] = values[order[start:end]]
        return {
            name: np.concatenate([of_episode[row["episode_index"]] for row in episodes])
            for name, of_episode in pieces.items()
        }

    def fill(self, buffer: FrameBuffer, camera: str, episodes: list[dict[str, Any]]) -> None:
        """Put the frames of a camera into their places, a file at a time; errors as of `FrameBuffer.put`."""
        starts = np.cumsum([0, *(row["length"] for row in episodes)])
        place = {row["episode_index"]: int(start) for row, start in zip(episodes, starts[:-1], strict=True)}
        if self.features[camera]["dtype"] == "video":
            self._fill_from_videos(buffer, camera, episodes, place)
            return
        for _, group in _by_file(episodes, "data", self._data_file):
            encoded = self.columns([camera], group)[camera]
            places = [place[row["episode_index"]] + np.arange(row["length"]) for row in group]
            decode_images(encoded, np.concatenate(places), buffer)
            del encoded
            pa.default_memory_pool().release_unused()  # Arrow would keep the memory of the encoded ones

    def _fill_from_videos(
        self, buffer: FrameBuffer, camera: str, episodes: list[dict[str, Any]], place: dict[int, int]
    ) -> None:
        for path, group in _by_file(episodes, f"videos/{camera}", self._video_file(camera)):
            wanted: dict[int, int] = {}
            for row in group:
                first = round(row[f"videos/{camera}/from_timestamp"] * self.info["fps"])
                start = place[row["episode_index"]]
                wanted |= {first + frame: start + frame for frame in range(row["length"])}
            for number, frame in decode_video(path, self.info["fps"], max(wanted)):
                if number in wanted:
                    buffer.put(wanted.pop(number), frame)
            if wanted:
                raise DatasetError(f"dataset {self.root}: {path.name} of {camera} lacks frame {min(wanted)}")

    def _recorded(self, key: str, default: Any) -> Any:
        path = self.root / WORLD_FILE
        return _read_json(path).get(key, default) if path.exists() else default

    def _data_file(self, row: dict[str, Any]) -> Path:
        return self.root / self.info["data_path"].format(
            chunk_index=row["data/chunk_index"], file_index=row["data/file_index"]
        )

    def _video_file(self, camera: str) -> Callable[[dict[str, Any]], Path]:
        def path(row: dict[str, Any]) -> Path:
            return self.root / self.info["video_path"].format(
                video_key=camera,
                chunk_index=row[f"videos/{camera}/chunk_index"],
                file_index=row[f"videos/{camera}/file_index"],
            )

        return path


def _by_file(
    episodes: list[dict[str, Any]], prefix: str, path: Callable[[dict[str, Any]], Path]
) -> Iterator[tuple[Path, list[dict[str, Any]]]]:
    """The files that hold the episodes' data or videos, each with the episodes it holds."""
    for key in (f"{prefix}/chunk_index", f"{prefix}/file_index"):
        if key not in episodes[0]:
            raise DatasetError(f"meta/episodes has no column {key}, so nothing says where episodes lie")
    groups: dict[Path, list[dict[str, Any]]] = {}
    for episode in episodes:
        groups.setdefault(path(episode), []).append(episode)
    yield from groups.items()


def _read_json(path: Path) -> dict[str, Any]:
    """A JSON object; DatasetError where the file is missing or holds anything else."""
    try:
        content = json.loads(path.read_text())
    except OSError as error:
        raise DatasetError(
            f"{path}: cannot be read ({error.strerror}); is this a LeRobot dataset?"
        ) from error
    except ValueError as error:
        raise DatasetError(f"{path}: is not JSON ({error}); record the dataset again") from error
    if not isinstance(content, dict):
        raise DatasetError(f"{path}: holds a {type(content).__name__}, not an object; record it again")
    return content


def _read_table(path: Path, names: list[str] | None, episodes: list[int] | None = None) -> pa.Table:
    """The named columns of a parquet file, restricted to some episodes where `episodes` is given."""
    if not path.is_file():
        raise DatasetError(f"{path}: is missing; the dataset is half-copied or half-written")
    filters = None if episodes is None else [("episode_index", "in", episodes)]
    try:
        schema = pq.read_schema(path)
        missing = sorted(set(names or []) - set(schema.names))
        if missing:
            raise DatasetError(f"{path}: has no column {', '.join(missing)} that meta/info.json names")
        return pq.read_table(path, columns=names, filters=filters, partitioning=None)
    except (OSError, pa.ArrowException) as error:
        reason = str(error).splitlines()[0]
        raise DatasetError(f"{path}: half-written or damaged ({reason}); record the dataset again") from error


def _read_episodes(root: Path) -> list[dict[str, Any]]:
    """All rows of `meta/episodes` by episode_index, without their statistics."""
    rows: list[dict[str, Any]] = []
    for path in sorted((root / "meta/episodes").glob("**/*.parquet")):
        table = _read_table(path, None)
        rows += table.select(
            [name for name in table.column_names if not name.startswith("stats/")]
        ).to_pylist()
    if not rows:
        raise DatasetError(f"dataset {root}: meta/episodes lists no episode; record it again")
    return sorted(rows, key=lambda row: row["episode_index"])


def _to_numpy(column: pa.ChunkedArray) -> np.ndarray:
    """A parquet column as [rows], [rows, size] or, for an image struct, [rows] of buffers."""
    if pa.types.is_struct(column.type):
        values = np.empty(len(column), object)
        # Views into the table: copies would be thousands of small objects whose memory is never given back.
        values[:] = [content.as_buffer() for content in pc.struct_field(column, "bytes")]
        return values
    if pa.types.is_fixed_size_list(column.type) or pa.types.is_list(column.type):
        return pc.list_flatten(column).to_numpy().reshape(len(column), -1)
    return column.to_numpy()
