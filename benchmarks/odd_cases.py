"""Datasets as users have them, each with one oddity, and which frames it holds: a case a line.

The oddities that nothing can be done about are in `odd_refused`.
"""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from lerobot_files import (
    CAMERA,
    DATA,
    LENGTHS,
    VIDEO,
    as_v2,
    build,
    edit_feature,
    edit_info,
    edit_rows,
    edit_table,
    film,
    grey,
    png,
    vector,
    write_rows,
)

__all__ = [
    "FILMS",
    "FRAMES",
    "TABLES",
    "Change",
    "N",
    "Odd",
    "both",
    "by_path",
    "drop_meta",
    "in_another_file",
    "info_of",
    "kept",
    "set_meta",
    "starts",
    "stray_rows",
    "table_of",
]

N = sum(LENGTHS)
FRAMES = list(range(N))
EVERY_OTHER = [0, 2, 4, 6]

Change = Callable[[Path], Any]


@dataclass(frozen=True)
class Odd:
    """A dataset of `lerobot_files.build` with an oddity.

    Attributes:
        change: what is done to the folder.
        made: arguments of `build`.
        shown: the numbers of the frames that its images show; () where it is refused.
        line: a regular expression of the line that refuses it; None where it is read.
    """

    change: Change
    made: Mapping[str, Any]
    shown: Sequence[int] = tuple(FRAMES)
    line: str | None = None

    def build(self, root: Path) -> Path:
        """The dataset, in a new folder."""
        build(root, **self.made)
        self.change(root)
        return root


def kept(root: Path) -> None:
    """As built."""


def both(*changes: Change) -> Change:
    """One change after another."""
    return lambda root: [change(root) for change in changes]


def table_of(**columns: Any) -> Change:
    """Columns of the data in place of its own."""
    return lambda root: edit_table(root, **columns)


def drop_meta(column: str) -> Change:
    """The metadata of episodes without a column."""
    return lambda root: edit_rows(root, lambda rows: [row.pop(column) for row in rows])


def set_meta(column: str, value: Any, row: int = 1) -> Change:
    """Another value in the metadata of an episode."""
    return lambda root: edit_rows(root, lambda rows: rows[row].update({column: value}))


def starts(*seconds: float) -> Change:
    """Where the episodes start in their video."""
    key = f"videos/{CAMERA}/from_timestamp"
    return lambda root: edit_rows(
        root, lambda rows: [r.update({key: s}) for r, s in zip(rows, seconds, strict=True)]
    )


def info_of(**changes: Any) -> Change:
    """Other values in info.json."""
    return lambda root: edit_info(root, **changes)


def without(key: str, *names: str) -> Change:
    """Features of which info.json does not give a key."""
    dropped: dict[str, Any] = {key: "drop"}
    return both(*(partial(edit_feature, name=name, **dropped) for name in names))


def rows_shuffled(root: Path) -> None:
    """Rows of all episodes in any order."""
    table = pq.read_table(root / DATA)
    pq.write_table(table.take(np.random.default_rng(1).permutation(N)), root / DATA)


def rows_shuffled_within(root: Path) -> None:
    """Rows of an episode in any order, the episodes one after another."""
    table, rng = pq.read_table(root / DATA), np.random.default_rng(1)
    order = [rng.permutation(LENGTHS[0]), LENGTHS[0] + rng.permutation(LENGTHS[1])]
    pq.write_table(table.take(np.concatenate(order)), root / DATA)


def in_another_file(root: Path) -> None:
    """The second episode lies in a file that no row of the metadata names."""
    table = pq.read_table(root / DATA)
    pq.write_table(table.slice(0, LENGTHS[0]), root / DATA)
    pq.write_table(table.slice(LENGTHS[0]), root / "data/chunk-000/file-001.parquet")


def stray_rows(root: Path) -> None:
    """Rows of an episode that the metadata does not list."""
    edit_info(root, total_episodes=1, total_frames=LENGTHS[0])
    edit_rows(root, lambda rows: rows.pop())


def by_path(root: Path) -> None:
    """Images in files of their own, which the table names."""
    (root / "images").mkdir()
    for k in FRAMES:
        (root / f"images/frame-{k}.png").write_bytes(png(grey(k)))
    table_of(**{CAMERA: [{"bytes": None, "path": f"images/frame-{k}.png"} for k in FRAMES]})(root)


def path_as_text(root: Path) -> None:
    """Likewise, named by a column of text."""
    by_path(root)
    table_of(**{CAMERA: [f"images/frame-{k}.png" for k in FRAMES]})(root)


def with_marks(root: Path) -> None:
    """Byte order marks, with which editors on Windows begin files."""
    for path in (root / "meta").glob("*.json"):
        path.write_bytes(b"\xef\xbb\xbf" + path.read_bytes())


def thin_info(root: Path) -> None:
    """An info.json of the rate and the features."""
    path = root / "meta/info.json"
    info = json.loads(path.read_text())
    path.write_text(json.dumps({"fps": info["fps"], "features": info["features"]}))


def extension_type(root: Path) -> None:
    """Vectors of the types that Hugging Face's `datasets` registers with Arrow."""
    from datasets.features.features import Array2DExtensionType

    storage = pa.array(np.arange(2.0 * N).reshape(N, 1, 2).tolist(), pa.list_(pa.list_(pa.float64())))
    kind = Array2DExtensionType((1, 2), "float64")
    edit_table(root, **{"observation.state": pa.ExtensionArray.from_storage(kind, storage)})


def two_files(root: Path) -> None:
    """A video an episode, the second of another rate and later in its file."""
    edit_rows(
        root,
        lambda rows: rows[1].update(
            {f"videos/{CAMERA}/file_index": 1, f"videos/{CAMERA}/from_timestamp": 0.3}
        ),
    )
    path = root / VIDEO.replace("file-000", "file-001")
    film(path, LENGTHS[1], 10, step=2, first=6, shown=[k for k in FRAMES[LENGTHS[0] :] for _ in range(2)])


def tasks_by_number(root: Path) -> None:
    """Tasks in a table whose words are named as LeRobot 0.4 names an index, of several tasks."""
    words = [{"task_index": k, "__index_level_0__": f"task {3 - k}"} for k in range(3)]
    write_rows(root / "meta/tasks.parquet", words)


def templates_of_v3(root: Path) -> None:
    """Layout v2.1, templates of v3.0."""
    as_v2(root)
    edit_info(root, data_path="data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet")


TABLES = {
    name: Odd(change, {})
    for name, change in {
        "nothing odd": kept,
        "rows of all episodes in any order": rows_shuffled,
        "rows of an episode in any order": rows_shuffled_within,
        "an episode's rows in a file that no metadata names": in_another_file,
        "metadata that names no data file": drop_meta("data/file_index"),
        "metadata that names a data file that is not there": set_meta("data/file_index", 7, row=0),
        "images by path": by_path,
        "images by path, a column of text": path_as_text,
        "images as bytes without a path": table_of(**{CAMERA: [png(grey(k)) for k in FRAMES]}),
        "a byte order mark before JSON": with_marks,
        "info.json of fps and features alone": thin_info,
        "no length of episodes": drop_meta("length"),
        "no length of one episode": set_meta("length", None),
        "no tasks": both(drop_meta("tasks"), lambda root: (root / "meta/tasks.parquet").unlink()),
        "tasks under the name that LeRobot 0.4 gives them": tasks_by_number,
        "features without a shape": without("shape", "action", CAMERA),
        "features without a type": without("dtype", "action", "observation.state", CAMERA),
        "unknown keys in info.json": info_of(robot={"a": None}, splits=None, chunks_size=None),
        "format v9.9": info_of(codebase_version="v9.9"),
        "layout v3.0 that says v2.1": info_of(codebase_version="v2.1"),
        "totals null": info_of(total_episodes=None, total_frames=None),
        "totals too small": info_of(total_episodes=1, total_frames=3),
        "total_frames too large": info_of(total_frames=1000),
        "fps null": info_of(fps=None),
        "fps 0": info_of(fps=0),
        "fps as text": info_of(fps="10"),
        "templates null": info_of(data_path=None, video_path=None),
        "layout v3.0 with templates of v2.1": info_of(
            data_path="data/chunk-000/episode_{episode_index:06d}.parquet"
        ),
        "a template that cannot be filled in": info_of(data_path="data/{chunk_index:03q}"),
        "no frame_index": table_of(frame_index=None),
        "no frame_index at a frame": table_of(frame_index=[None, *range(1, N)]),
        "frame_index that leaves numbers out": table_of(
            frame_index=np.concatenate([3 * np.arange(n) for n in LENGTHS])
        ),
        "frame_index 0 at all frames": table_of(frame_index=np.zeros(N, np.int64)),
        "no stats.json": lambda root: (root / "meta/stats.json").unlink(),
        "an episode listed twice, alike": lambda root: edit_rows(root, lambda rows: rows.append({**rows[0]})),
        "an episode listed twice, with two lengths": lambda root: edit_rows(
            root, lambda rows: rows.append({**rows[0], "length": 4})
        ),
        "metadata of an episode without its number": set_meta("episode_index", None),
        "a length that is no number": lambda root: edit_rows(
            root, lambda rows: [row.update(length="long") for row in rows]
        ),
        "a length that is a fraction": lambda root: edit_rows(
            root, lambda rows: [row.update(length=float(row["length"])) for row in rows]
        ),
        "a task without its number": lambda root: write_rows(
            root / "meta/tasks.parquet", [{"task_index": None, "task": "a"}]
        ),
        "nulls in a column that is not needed": both(
            table_of(note=[None] * N), lambda root: edit_feature(root, "note", **vector(1))
        ),
        "vectors of the extension types of Hugging Face": extension_type,
        "layout v2.1": as_v2,
        "layout v2.0": lambda root: as_v2(root, "v2.0"),
        "layout v2.1 that says v3.0": lambda root: as_v2(root, "v3.0"),
        "layout v2.1 with templates of v3.0": templates_of_v3,
        "actions of 64 bits, lists of a fixed size": table_of(
            action=pa.FixedSizeListArray.from_arrays(pa.array(np.arange(3.0 * N)), 3)
        ),
    }.items()
}


def _film(
    change: Change = kept, frames: Sequence[int] = tuple(FRAMES), more: Any = None, **of_film: Any
) -> Odd:
    return Odd(change, {"video": of_film, **(more or {})}, frames)


FILMS = {
    "nothing odd": _film(),
    "B-frames": _film(options={"bf": "3", "g": "6"}),
    "one key frame": _film(options={"g": "250"}),
    "AV1": _film(codec="libsvtav1"),
    "a video at twice the data's rate": _film(step=2),
    "a video at three times the data's rate, B-frames": _film(step=3, options={"bf": "2"}),
    "a video that starts late, and metadata that says so": _film(starts(0.4, 0.9), first=4),
    "a video longer than the data": _film(count=40, shown=[k % N for k in range(40)]),
    "rows of all episodes in any order": _film(rows_shuffled),
    "a video file an episode, one of another rate": _film(two_files),
    "timestamps of 64 bits": _film(table_of(timestamp=np.concatenate([np.arange(n) / 10 for n in LENGTHS]))),
    "starts off by less than LeRobot's tolerance": _film(starts(0.00009, 0.50009)),
    "no template of videos": _film(info_of(video_path=None)),
    "layout v2.1": _film(as_v2),
    "layout v2.1 that says v3.0": _film(lambda root: as_v2(root, "v3.0")),
    "data at half the video's rate": _film(
        table_of(timestamp=(np.arange(4) / 5).astype(np.float32)), EVERY_OTHER, {"lengths": (4,)}, count=12
    ),
}
