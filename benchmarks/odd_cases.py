"""Datasets as users have them, each with one oddity, and which frames it holds: a case a line.

The oddities that nothing can be done about are in `odd_refused`.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pyarrow as pa
from lerobot_files import CAMERA, LENGTHS, as_v2, edit_feature, edit_rows, grey, png, vector, write_rows
from odd_changes import (
    FRAMES,
    Change,
    N,
    Odd,
    both,
    by_path,
    drop_meta,
    extension_type,
    in_another_file,
    info_of,
    kept,
    one_frame_more,
    path_as_text,
    rows_shuffled,
    rows_shuffled_within,
    set_meta,
    starts,
    table_of,
    tasks_by_number,
    templates_of_v3,
    thin_info,
    two_files,
    with_marks,
    without,
)

__all__ = ["FILMS", "TABLES"]

EVERY_OTHER = [0, 2, 4, 6]

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
        "images as lists of levels": table_of(
            **{CAMERA: np.stack([np.full((48, 64, 3), grey(k), np.uint8) for k in FRAMES])}
        ),
        "images as lists of grey levels": table_of(
            **{CAMERA: np.stack([np.full((48, 64), grey(k), np.int64) for k in FRAMES])}
        ),
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
        "metadata of an episode that has no rows": lambda root: edit_rows(
            root, lambda rows: rows.append({"episode_index": 2})
        ),
        "metadata of an episode of one frame": one_frame_more,
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
