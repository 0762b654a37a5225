"""In which files a dataset's episodes lie: layout v3 (many episodes a file) or v2 (one a file)."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from dpmacro.data.images import DatasetError
from dpmacro.data.lerobot.schema import check_episode, check_task, filled, is_whole
from dpmacro.data.lerobot.tables import is_file, read_json_lines, read_rows
from dpmacro.utils.checks import in_a_line, shown

__all__ = ["StoredEpisode", "Video", "read_episodes", "read_tasks"]

DATA_V3 = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
VIDEO_V3 = "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4"
DATA_V2 = "data/chunk-{episode_chunk:03d}/episode_{episode_index:06d}.parquet"
VIDEO_V2 = "videos/chunk-{episode_chunk:03d}/{video_key}/episode_{episode_index:06d}.mp4"
WORDS = ("task", "__index_level_0__")  # columns of a task's words as LeRobot names them
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


def read_episodes(
    root: Path, info: Mapping[str, Any], cameras: list[str]
) -> tuple[list[StoredEpisode], list[str]]:
    """All episodes by their index, and what a user should know of how they are listed, a line each.

    The layout is that of the files there are, whatever version `info.json` claims. `cameras` are the features
    stored as video. An episode without a number has its place among the rows as number, which is how LeRobot
    looks episodes up; where one is listed twice, the first row counts. Raises DatasetError where no episode
    is listed, or a row says too little.
    """
    tables, lines = sorted((root / "meta/episodes").glob("**/*.parquet")), root / "meta/episodes.jsonl"
    if tables and not (lines.is_file() and any((root / "data").glob("*/episode_*.parquet"))):
        of_tables = [(path, row) for path in tables for row in read_rows(path)]
        found = [
            _of_v3(root, info, cameras, path, {"episode_index": place} | _there(row))
            for place, (path, row) in enumerate(of_tables)
        ]
    elif lines.is_file():
        found = [_of_v2(root, info, cameras, lines, row) for row in read_json_lines(lines)]
    else:
        raise _no_layout(root, info)
    episodes: dict[int, StoredEpisode] = {}
    twice = [one.index for one in found if episodes.setdefault(one.index, one) != one]
    notes = [f"meta/episodes lists episode {index} twice, differently: the first counts" for index in twice]
    if not episodes:
        raise DatasetError(f"dataset {root}: meta/episodes lists no episode; record it again")
    return [episodes[index] for index in sorted(episodes)], notes


def read_tasks(root: Path) -> dict[int, str]:
    """What there is to do, in words, by `task_index`, or by its place where it has none; {} without a file.

    The words are in a column of WORDS or, where there is none of them, in the first of text.
    """
    table, lines = root / "meta/tasks.parquet", root / "meta/tasks.jsonl"
    if table.is_file():
        rows, path = read_rows(table), table
    elif lines.is_file():
        rows, path = read_json_lines(lines), lines
    else:
        return {}
    tasks = {}
    for place, row in enumerate(rows):
        named = [row.get(key) for key in WORDS if isinstance(row.get(key), str)]
        words = named or [value for key, value in row.items() if isinstance(value, str)]
        index = {"task_index": place, **_there(row)}["task_index"]
        check_task(path, row, index, words)
        tasks[index] = str(words[0])
    return tasks


def _of_v3(
    root: Path, info: Mapping[str, Any], cameras: list[str], path: Path, row: dict[str, Any]
) -> StoredEpisode:
    index = _index(path, row)
    place = {key: row.get(f"data/{key}") for key in ("chunk_index", "file_index")}
    data = _file(root, info, "data_path", DATA_V3, place) if None not in place.values() else None
    videos: dict[str, Video | str] = {}
    for camera in cameras:
        of_video: dict[str, Any] = {
            key: row.get(f"videos/{camera}/{key}") for key in (*place, "from_timestamp")
        }
        missing = next((key for key, value in of_video.items() if value is None), None)
        if missing is not None:
            videos[camera] = f"{path}: episode {index} has no videos/{camera}/{missing}; record it again"
            continue
        start = float(of_video.pop("from_timestamp"))
        file = _file(root, info, "video_path", VIDEO_V3, {"video_key": camera, **of_video})
        videos[camera] = Video(file, start)
    return StoredEpisode(index, _length(row), data, videos, _words(row))


def _of_v2(
    root: Path, info: Mapping[str, Any], cameras: list[str], path: Path, row: dict[str, Any]
) -> StoredEpisode:
    index = _index(path, row)
    size: Any = info.get("chunks_size")
    place = {
        "episode_index": index,
        "episode_chunk": index // (size if is_whole(size) and size > 0 else CHUNK),
    }
    videos: dict[str, Video | str] = {
        camera: Video(_file(root, info, "video_path", VIDEO_V2, {"video_key": camera, **place}), 0.0)
        for camera in cameras
    }
    data = _file(root, info, "data_path", DATA_V2, place)
    return StoredEpisode(index, _length(row), data, videos, _words(row))


def _file(root: Path, info: Mapping[str, Any], key: str, usual: str, place: Mapping[str, Any]) -> Path:
    """The file by the dataset's own template or, where that is of another layout, by the usual one."""
    template = info.get(key)
    usual_path = root / usual.format(**place)
    try:
        own = filled(template, place)
    except (ValueError, IndexError) as error:
        if is_file(usual_path):
            return usual_path
        raise DatasetError(
            f"{root / 'meta/info.json'}: {key} is {shown(template)} ({in_a_line(error)}); write {usual}"
        ) from error
    path = usual_path if own is None else root / own
    return usual_path if is_file(usual_path) and not is_file(path) else path


def _there(row: Mapping[str, Any]) -> dict[str, Any]:
    """What a row says, without what it leaves open."""
    return {key: value for key, value in row.items() if value is not None}


def _index(path: Path, row: Mapping[str, Any]) -> int:
    check_episode(path, row)
    return row["episode_index"]


def _length(row: Mapping[str, Any]) -> int | None:
    """The number of frames, None where that is no number; a fraction may stand for a whole one."""
    length = row.get("length")
    whole = isinstance(length, int | float) and not isinstance(length, bool) and length == length // 1 >= 0
    return int(length) if whole else None  # type: ignore[arg-type]


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
