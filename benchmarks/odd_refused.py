"""Datasets that nothing can be done about, and the line that refuses each."""

import shutil
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from lerobot_files import (
    CAMERA,
    DATA,
    VIDEO,
    as_v2,
    png,
)
from odd_changes import (
    FRAMES,
    Change,
    N,
    Odd,
    both,
    by_path,
    drop_meta,
    info_of,
    kept,
    set_meta,
    starts,
    table_of,
)

__all__ = ["FILMS_REFUSED", "TABLES_REFUSED"]

ACTION = [1.0, 2.0, 3.0]
RAGGED = pa.array([ACTION] * 7 + [[1.0]] + [ACTION] * 3)


def _table(change: Change, line: str, excuse: str = "") -> Odd:
    return Odd(change, {}, (), line, excuse)


def _film(change: Change, line: str, **of_film: Any) -> Odd:
    return Odd(change, {"video": of_film}, (), line)


def _of(part: str) -> str:
    return f"videos/{CAMERA}/{part}"


TABLES_REFUSED = {
    "fps null, and no timestamp": _table(
        both(info_of(fps=None), table_of(timestamp=np.zeros(N, np.float32))),
        r"info\.json: fps is null; write how many frames a second has",
        "changes of the state are taken over half a second",
    ),
    "a template that cannot be filled in, and no usual file": _table(
        both(
            info_of(data_path="data/{chunk_index:03q}"),
            lambda root: (root / DATA).rename(root / "data/frames.parquet"),
        ),
        r"info\.json: data_path is 'data/\{chunk_index:03q\}' \(.*\); write data/chunk",
    ),
    "total_episodes too large": _table(
        info_of(total_episodes=3),
        r"half-written, info\.json says 3 episodes and 11 frames, meta/episodes lists 2 and 11; record",
    ),
    "features a list": _table(info_of(features=[]), r"info\.json: features is \[\]; give"),
    "a feature that is null": _table(
        info_of(features={"action": None}),
        r"info\.json: features is .*; give each name its dtype",
    ),
    "no action at a frame": _table(
        table_of(action=[ACTION] * 7 + [None] + [ACTION] * 3),
        r"file-000\.parquet: action: has no value at frame 7 \(1 missing in all\); fill them in",
    ),
    "no value of one number of an action": _table(
        table_of(action=[ACTION] * 7 + [[1.0, None, 2.0]] + [ACTION] * 3),
        r"file-000\.parquet: action: has no value at frame 7",
    ),
    "no state at a frame": _table(
        table_of(**{"observation.state": [[1.0, 2.0]] * 10 + [None]}),
        r"observation\.state: has no value at frame 10",
    ),
    "states of two sizes": _table(
        table_of(**{"observation.state": [[1.0, 2.0]] * 10 + [[1.0]]}),
        r"observation\.state: has 1 numbers at frame 10 and 2 at frame 0; store as many",
    ),
    "actions of two sizes": _table(
        table_of(action=RAGGED),
        r"action: has 1 numbers at frame 7 and 3 at frame 0; store",
    ),
    "an action not finite": _table(
        table_of(action=np.array([ACTION] * 7 + [[1.0, 2.0, np.inf]] * 4)),
        r"action is inf at frame 7, number 2; correct it, or leave out the episode",
    ),
    "a state not finite": _table(
        table_of(**{"observation.state": np.array([[1.0, 2.0]] * 4 + [[np.nan, 2.0]] * 7)}),
        r"observation\.state is nan at frame 4, number 0; correct it",
    ),
    "an action too large for 32 bits": _table(
        table_of(action=np.array([ACTION] * 10 + [[1e300, 0.0, 0.0]])),
        r"action is 1e\+300 at frame 10, number 0",
    ),
    "no episode_index at a frame": _table(
        table_of(episode_index=[0] * 5 + [1] * 5 + [None]),
        r"file-000\.parquet: episode_index: has no value at frame 10",
    ),
    "task numbers up to a million million": _table(
        table_of(task_index=[0] * 10 + [10**12]),
        r"task_index goes up to 1000000000000; number tasks from 0",
    ),
    "an image file missing": _table(
        both(by_path, lambda root: (root / "images/frame-6.png").unlink()),
        r"top: the image of frame 6 is damaged or missing \(no file images/frame-6\.png\); record",
    ),
    "no image at a frame": _table(
        table_of(**{CAMERA: [*([png(9)] * 4), None, *([png(9)] * 6)]}),
        r"top: the image of frame 4 is damaged; record",
    ),
    "images as flat lists of numbers": _table(
        table_of(**{CAMERA: np.zeros((N, 16), np.int64)}),
        r"file-000\.parquet: observation\.images\.top holds images as list.*; dpmacro reads PNG and JPEG",
        "neither height nor width is known",
    ),
    "images as lists, one ragged": _table(
        table_of(**{CAMERA: [[[9] * 8] * 8] * 3 + [[[9] * 8] * 7 + [[9]]] + [[[9] * 8] * 8] * 7}),
        r"top: the image of frame 3 is damaged; record",
    ),
    "images of several sizes": _table(
        table_of(**{CAMERA: [png(9, shape=(8 + k % 2, 8, 3)) for k in FRAMES]}),
        r"top: frame \d+ is \(\d, 8, 3\), others \(\d, 8, 3\); resize it",
    ),
    "fewer rows than the metadata says": _table(
        lambda root: pq.write_table(pq.read_table(root / DATA).slice(0, 8), root / DATA),
        r"half-written, episode 1 has 6 frames by meta/episodes and 3 in file-000\.parquet; record",
    ),
    "layout v2.1, lines that are no JSON": _table(
        both(as_v2, lambda root: (root / "meta/episodes.jsonl").write_text("{")),
        r"episodes\.jsonl: is not JSON",
    ),
    "layout v2.1, lines that are no objects": _table(
        both(as_v2, lambda root: (root / "meta/episodes.jsonl").write_text("3\n")),
        r"episodes\.jsonl: object 0 is a int; record",
    ),
    "layout v2.1, half-copied": _table(
        both(as_v2, lambda root: (root / "meta/episodes.jsonl").unlink()),
        r"episodes\.jsonl: is missing",
    ),
    "format v1.6": _table(
        both(lambda root: shutil.rmtree(root / "meta/episodes"), info_of(codebase_version="v1.6")),
        r"LeRobot format v1\.6, dpmacro reads v2\.0, v2\.1 and v3\.x; convert it",
    ),
    "no column of actions": _table(
        table_of(action=None),
        r"file-000\.parquet: has no column action that meta/info",
    ),
}

FILMS_REFUSED = {
    "an episode that starts half a frame late": _film(
        starts(0.0, 0.55),
        r"file-000\.mp4: frame 0 of episode 1 is wanted at 0\.55 s, the nearest is at 0\.[56] s "
        r"\(6 frames are 0\.05 s off or less, LeRobot's FrameTimestampError\): correct timestamp or "
        "from_timestamp, or allow more by tolerance_s",
    ),
    "a video that starts late": _film(
        kept,
        r"file-000\.mp4: frame 0 of episode 0 is wanted at 0 s, the nearest is at 0\.3 s",
        first=3,
    ),
    "a video of another rate": _film(
        kept,
        r"file-000\.mp4: frame 1 of episode 0 is wanted at 0\.1 s, the nearest is at 0\.(0666667|133333) s",
        count=30,
        shown=[0] * 30,
        options={},
        fps=15,
    ),
    "a video too short": _film(
        kept,
        r"file-000\.mp4: frame 3 of episode 1 is wanted at 0\.8 s, the nearest is at 0\.7 s",
        count=8,
    ),
    "timestamps as they were measured": _film(
        table_of(timestamp=np.arange(N) * 0.13),
        r"frame 1 of episode 0 is wanted at 0\.13 s, the nearest is at 0\.1 s \(10 frames",
    ),
    "no timestamps": _film(
        table_of(timestamp=[None] * N),
        r"file-000\.parquet: timestamp: has no value at frame 0",
    ),
    "no start of an episode in its video": _film(
        set_meta(_of("from_timestamp"), None),
        r"file-000\.parquet: episode 1 has no videos/observation\.images\.top/from_timestamp; record",
    ),
    "metadata that names no video file": _film(
        drop_meta(_of("file_index")),
        r"episode 0 has no videos/observation\.images\.top/file_index; record",
    ),
    "a video file missing": _film(
        lambda root: (root / VIDEO).unlink(),
        r"file-000\.mp4: is missing; the dataset",
    ),
    "a video file cut short": _film(
        lambda root: (root / VIDEO).write_bytes((root / VIDEO).read_bytes()[:600]),
        r"file-000\.mp4: cannot be decoded \(.*\); record",
    ),
    "an empty video file": _film(
        lambda root: (root / VIDEO).write_bytes(b""),
        r"file-000\.mp4: cannot be decoded \(.*\); record",
    ),
}
