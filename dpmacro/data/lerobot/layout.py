"""In which files a dataset's episodes lie: layout v3 (many episodes a file) or v2 (one a file)."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from dpmacro.data.images import DatasetError
from dpmacro.data.lerobot.tables import read_json_lines, read_rows

__all__ = ["StoredEpisode", "Video", "read_episodes", "read_tasks"]

DATA_V3 = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
VIDEO_V3 = "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4"
DATA_V2 = "data/chunk-{episode_chunk:03d}/episode_{episode_index:06d}.parquet"
VIDEO_V2 = "videos/chunk-{episode_chunk:03d}/{video_key}/episode_{episode_index:06d}.mp4"
CHUNK = 1000  # episodes a folder in v2, where info.json does not say


@dataclass(frozen=True)
class Video:
    """Where an episode's video lies: the file, and the seconds in it at which the episode starts."""

    path: Path
    start: float


@dataclass(frozen=True)
class StoredEpisode:
    """An episode as the metadata has it.

    Attributes:
        index: its `episode_index`.
        length: frames; None where the metadata does not say.
        data: the parquet file that should hold its rows.
        videos: what is known of the file of each camera.
        tasks: what was to be done, in words.
    """

    index: int
    length: int | None
    data: Path | None
    videos: Mapping[str, Video | str] = field(default_factory=dict)
    tasks: tuple[str, ...] = ()


def read_episodes(root: Path, info: Mapping[str, Any], cameras: list[str]) -> list[StoredEpisode]:
    """All episodes by their index.

    The layout is that of the files there are, whatever version `info.json` claims. `cameras` are the features
    stored as video. Raises DatasetError where no episode is listed, or a row says too little.
    """
    tables, lines = sorted((root / "meta/episodes").glob("**/*.parquet")), root / "meta/episodes.jsonl"
    if tables and not (lines.is_file() and any((root / "data").glob("*/episode_*.parquet"))):
        found = [_of_v3(root, info, cameras, path, row) for path in tables for row in read_rows(path)]
    elif lines.is_file():
        found = [_of_v2(root, info, cameras, lines, row) for row in read_json_lines(lines)]
    else:
        raise _no_layout(root, info)
    episodes: dict[int, StoredEpisode] = {}
    for episode in found:
        if episodes.setdefault(episode.index, episode) != episode:
            raise DatasetError(
                f"dataset {root}: meta/episodes lists episode {episode.index} twice, differently; keep "
                "one row"
            )
    if not episodes:
        raise DatasetError(f"dataset {root}: meta/episodes lists no episode; record it again")
    return [episodes[index] for index in sorted(episodes)]


def read_tasks(root: Path) -> dict[int, str]:
    """What there is to do, in words, by `task_index`; {} where no file says."""
    table, lines = root / "meta/tasks.parquet", root / "meta/tasks.jsonl"
    if table.is_file():
        rows, path = read_rows(table), table
    elif lines.is_file():
        rows, path = read_json_lines(lines), lines
    else:
        return {}
    tasks = {}
    for row in rows:
        words = [value for key, value in row.items() if key != "task_index" and isinstance(value, str)]
        index = row.get("task_index")
        if not isinstance(index, int) or index < 0 or not words:
            raise DatasetError(f"{path}: a task is {row}; give each a task_index from 0 on and its words")
        tasks[index] = words[0]
    return tasks


def _of_v3(
    root: Path, info: Mapping[str, Any], cameras: list[str], path: Path, row: dict[str, Any]
) -> StoredEpisode:
    index = _index(path, row)
    place = {key: row.get(f"data/{key}") for key in ("chunk_index", "file_index")}
    data = _file(root, info, "data_path", DATA_V3, place) if None not in place.values() else None
    videos: dict[str, Video | str] = {}
    for camera in cameras:
        of_video = {key: row.get(f"videos/{camera}/{key}") for key in (*place, "from_timestamp")}
        missing = next((key for key, value in of_video.items() if value is None), None)
        if missing is not None:
            videos[camera] = f"{path}: episode {index} has no videos/{camera}/{missing}; record it again"
            continue
        start = float(of_video.pop("from_timestamp"))  # type: ignore[arg-type]
        file = _file(root, info, "video_path", VIDEO_V3, {"video_key": camera, **of_video})
        videos[camera] = Video(file, start)
    return StoredEpisode(index, _length(path, index, row), data, videos, _words(row))


def _of_v2(
    root: Path, info: Mapping[str, Any], cameras: list[str], path: Path, row: dict[str, Any]
) -> StoredEpisode:
    index = _index(path, row)
    size = info.get("chunks_size")
    place = {
        "episode_index": index,
        "episode_chunk": index // (size if isinstance(size, int) and size else CHUNK),
    }
    videos: dict[str, Video | str] = {
        camera: Video(_file(root, info, "video_path", VIDEO_V2, {"video_key": camera, **place}), 0.0)
        for camera in cameras
    }
    data = _file(root, info, "data_path", DATA_V2, place)
    return StoredEpisode(index, _length(path, index, row), data, videos, _words(row))


def _file(root: Path, info: Mapping[str, Any], key: str, usual: str, place: Mapping[str, Any]) -> Path:
    """The file by the dataset's own template or, where that is of another layout, by the usual one."""
    template = info.get(key)
    fields = set(re.findall(r"{(\w+)", template)) if isinstance(template, str) else set()
    own = template if fields and fields <= place.keys() else usual
    try:
        path = root / str(own).format(**place)
    except (ValueError, IndexError) as error:
        raise DatasetError(
            f"{root / 'meta/info.json'}: {key} is {template!r} ({error}); write {usual}"
        ) from error
    usual_path = root / usual.format(**place)
    return usual_path if usual_path.is_file() and not path.is_file() else path


def _index(path: Path, row: Mapping[str, Any]) -> int:
    index = row.get("episode_index")
    if not isinstance(index, int):
        raise DatasetError(f"{path}: a row has episode_index {index}; give each episode its number")
    return index


def _length(path: Path, index: int, row: Mapping[str, Any]) -> int | None:
    length = row.get("length")
    if length is not None and not (isinstance(length, int) and length >= 0):
        raise DatasetError(f"{path}: episode {index} has length {length!r}; give its number of frames")
    return length


def _words(row: Mapping[str, Any]) -> tuple[str, ...]:
    tasks = row.get("tasks")
    tasks = [tasks] if isinstance(tasks, str) else tasks or []
    return tuple(str(task) for task in tasks if task is not None)


def _no_layout(root: Path, info: Mapping[str, Any]) -> DatasetError:
    version = str(info.get("codebase_version"))
    if version.startswith("v2"):
        return DatasetError(
            f"{root / 'meta/episodes.jsonl'}: is missing; {root} is half-copied, copy it again"
        )
    if version.startswith("v3"):
        return DatasetError(f"dataset {root}: meta/episodes lists no episode; record it again")
    return DatasetError(
        f"dataset {root}: LeRobot format {version}, dpmacro reads v2.0, v2.1 and v3.x; convert it with "
        "LeRobot"
    )
