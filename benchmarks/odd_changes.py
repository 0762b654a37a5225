"""What is odd about datasets as users have them: each change is made to the files of a usual one."""

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
    write_rows,
)

__all__ = [
    "FRAMES",
    "Change",
    "N",
    "Odd",
    "both",
    "by_path",
    "drop_meta",
    "extension_type",
    "in_another_file",
    "info_of",
    "kept",
    "one_frame_more",
    "path_as_text",
    "rows_shuffled",
    "rows_shuffled_within",
    "set_meta",
    "starts",
    "stray_rows",
    "table_of",
    "tasks_by_number",
    "templates_of_v3",
    "thin_info",
    "two_files",
    "with_marks",
    "without",
]

N = sum(LENGTHS)
FRAMES = list(range(N))

Change = Callable[[Path], Any]


@dataclass(frozen=True)
class Odd:
    """A dataset of `lerobot_files.build` with an oddity.

    Attributes:
        change: what is done to the folder.
        made: arguments of `build`.
        shown: the numbers of the frames that its images show; () where it is refused.
        line: a regular expression of the line that refuses it; None where it is read.
        excuse: why it is refused even where LeRobot reads it; "" where there is no such reason.
    """

    change: Change
    made: Mapping[str, Any]
    shown: Sequence[int] = tuple(FRAMES)
    line: str | None = None
    excuse: str = ""

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


def one_frame_more(root: Path) -> None:
    """A third episode, of a single frame."""
    table = pq.read_table(root / DATA)
    more = table.slice(0, 1).set_column(0, "episode_index", pa.array([2]))
    more = more.set_column(more.column_names.index("index"), "index", pa.array([N]))
    pq.write_table(pa.concat_tables([table, more]), root / DATA)
    edit_rows(
        root,
        lambda rows: rows.append(
            {**rows[0], "episode_index": 2, "length": 1, "dataset_from_index": N, "dataset_to_index": N + 1}
        ),
    )
    edit_info(root, total_episodes=3, total_frames=N + 1)


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
