"""Datasets as users have them: each oddity gives the right frames, or one line that names it and a remedy."""

import json
import shutil
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
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
    levels,
    png,
    vector,
    write_rows,
)

from dpmacro.data.demonstrations import DatasetError, Demonstrations

N = sum(LENGTHS)
FRAMES = list(range(N))
INFO = "meta/info.json"


def kept(root):
    """As built."""


def rows_shuffled(root):
    table = pq.read_table(root / DATA)
    pq.write_table(table.take(np.random.default_rng(1).permutation(N)), root / DATA)


def in_another_file(root):
    """The second episode lies in a file that no row of the metadata names."""
    table = pq.read_table(root / DATA)
    pq.write_table(table.slice(0, LENGTHS[0]), root / DATA)
    pq.write_table(table.slice(LENGTHS[0]), root / "data/chunk-000/file-001.parquet")


def stray_rows(root):
    edit_info(root, total_episodes=1, total_frames=LENGTHS[0])
    edit_rows(root, lambda rows: rows.pop())


def by_path(root):
    (root / "images").mkdir()
    for k in FRAMES:
        (root / f"images/frame-{k}.png").write_bytes(png(grey(k)))
    edit_table(root, **{CAMERA: [{"bytes": None, "path": f"images/frame-{k}.png"} for k in FRAMES]})


def path_as_text(root):
    by_path(root)
    edit_table(root, **{CAMERA: [f"images/frame-{k}.png" for k in FRAMES]})


def with_bom(root):
    for path in (root / "meta").glob("*.json"):
        path.write_bytes(b"\xef\xbb\xbf" + path.read_bytes())


def thin_info(root):
    info = json.loads((root / INFO).read_text())
    (root / INFO).write_text(json.dumps({"fps": info["fps"], "features": info["features"]}))


def drop_meta(column):
    return lambda root: edit_rows(root, lambda rows: [row.pop(column) for row in rows])


def set_meta(column, value, row=1):
    return lambda root: edit_rows(root, lambda rows: rows[row].update({column: value}))


def table_of(**columns):
    return lambda root: edit_table(root, **columns)


def both(*changes):
    return lambda root: [change(root) for change in changes]


def extension_type(root):
    """Vectors of the types that Hugging Face's `datasets` registers with Arrow."""
    from datasets.features.features import Array2DExtensionType

    storage = pa.array(np.arange(2.0 * N).reshape(N, 1, 2).tolist(), pa.list_(pa.list_(pa.float64())))
    kind = Array2DExtensionType((1, 2), "float64")
    edit_table(root, **{"observation.state": pa.ExtensionArray.from_storage(kind, storage)})


RIGHT = {
    "as built": kept,
    "rows out of order": rows_shuffled,
    "rows in another file": in_another_file,
    "no file named": drop_meta("data/file_index"),
    "a file that is not there": set_meta("data/file_index", 7, row=0),
    "images by path": by_path,
    "paths as text": path_as_text,
    "bytes alone": table_of(**{CAMERA: [png(grey(k)) for k in FRAMES]}),
    "byte order marks": with_bom,
    "thin info": thin_info,
    "no lengths": drop_meta("length"),
    "a length missing": set_meta("length", None),
    "no tasks": both(drop_meta("tasks"), lambda root: (root / "meta/tasks.parquet").unlink()),
    "shape missing": lambda root: [edit_feature(root, name, shape="drop") for name in ("action", CAMERA)],
    "type missing": lambda root: [
        edit_feature(root, name, dtype="drop") for name in ("action", "observation.state", CAMERA)
    ],
    "unknown keys": lambda root: edit_info(root, robot={"a": None}, splits=None, chunks_size=None),
    "unknown version": lambda root: edit_info(root, codebase_version="v9.9"),
    "another version": lambda root: edit_info(root, codebase_version="v2.1"),
    "totals null": lambda root: edit_info(root, total_episodes=None, total_frames=None),
    "totals stale": lambda root: edit_info(root, total_episodes=1, total_frames=3),
    "null templates": lambda root: edit_info(root, data_path=None, video_path=None),
    "templates of v2": lambda root: edit_info(
        root, data_path="data/chunk-000/episode_{episode_index:06d}.parquet"
    ),
    "no frame_index": table_of(frame_index=None),
    "frame_index all 0": table_of(frame_index=np.zeros(N, np.int64)),
    "no stats": lambda root: (root / "meta/stats.json").unlink(),
    "an episode listed twice": lambda root: edit_rows(root, lambda rows: rows.append(dict(rows[0]))),
    "nulls in a column unread": both(
        table_of(note=[None] * N), lambda root: edit_info_feature(root, "note", vector(1, "float32"))
    ),
    "extension types": extension_type,
    "v2.1": as_v2,
    "v2.0": lambda root: as_v2(root, "v2.0"),
    "v2.1 that says v3.0": lambda root: as_v2(root, "v3.0"),
    "v2.1 with templates of v3": lambda root: [
        as_v2(root),
        edit_info(root, data_path="data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"),
    ],
    "float64, fixed lists": table_of(
        action=pa.FixedSizeListArray.from_arrays(pa.array(np.arange(3.0 * N)), 3),
    ),
}


def edit_info_feature(root, name, feature):
    features = json.loads((root / INFO).read_text())["features"]
    edit_info(root, features={**features, name: feature})


@pytest.mark.parametrize("name", ["plain", "a:b", "with space %d"])
@pytest.mark.parametrize("video", [None, {}], ids=["images", "video"])
def test_a_path_may_be_of_any_letters(tmp_path, monkeypatch, name, video):
    build(tmp_path / name, video=video)
    monkeypatch.chdir(tmp_path)
    for root in (tmp_path / name, Path(name)):
        assert levels(Demonstrations.load(root).images).tolist() == FRAMES


@pytest.mark.parametrize("case", RIGHT)
def test_odd_datasets_come_back_right(tmp_path, case):
    root = build(tmp_path / "d")
    RIGHT[case](root)
    loaded = Demonstrations.load(root)
    assert loaded.lengths.tolist() == list(LENGTHS)
    assert levels(loaded.images).tolist() == FRAMES
    assert loaded.actions.shape == (N, 3) and loaded.actions.dtype == np.float32
    assert loaded.observations["observation.state"].shape == (N, 2)
    second = Demonstrations.load(root, episodes=[1, 0])
    assert levels(second.images).tolist() == FRAMES[LENGTHS[0] :] + FRAMES[: LENGTHS[0]]
    assert np.array_equal(second.actions[: LENGTHS[1]], loaded.actions[LENGTHS[0] :])


def test_rows_of_no_listed_episode_are_left_out(tmp_path):
    root = build(tmp_path / "d")
    stray_rows(root)
    assert levels(Demonstrations.load(root).images).tolist() == FRAMES[: LENGTHS[0]]


def rate(step, **more):
    return {"step": step, **more}


def starts(*seconds):
    """Where the episodes start in their video."""
    key = f"videos/{CAMERA}/from_timestamp"
    return lambda root: edit_rows(
        root, lambda rows: [r.update({key: s}) for r, s in zip(rows, seconds, strict=True)]
    )


def two_files(root):
    """A video an episode, the second of another rate and later in its file."""
    edit_rows(
        root,
        lambda rows: rows[1].update(
            {f"videos/{CAMERA}/file_index": 1, f"videos/{CAMERA}/from_timestamp": 0.3}
        ),
    )
    path = root / VIDEO.replace("file-000", "file-001")
    film(path, LENGTHS[1], 10, step=2, first=6, shown=[k for k in FRAMES[LENGTHS[0] :] for _ in range(2)])


FILMS = {
    "as built": ({}, kept),
    "B-frames": ({"options": {"bf": "3", "g": "6"}}, kept),
    "one key frame": ({"options": {"g": "250"}}, kept),
    "AV1": ({"codec": "libsvtav1"}, kept),
    "twice the rate": (rate(2), kept),
    "three times the rate, B-frames": (rate(3, options={"bf": "2"}), kept),
    "late, and told so": ({"first": 4}, starts(0.4, 0.9)),
    "longer than the data": ({"count": 40, "shown": [k % N for k in range(40)]}, kept),
    "rows out of order": ({}, rows_shuffled),
    "a file an episode": ({}, two_files),
    "float64 timestamps": ({}, table_of(timestamp=np.concatenate([np.arange(n) / 10 for n in LENGTHS]))),
    "a drift within the tolerance": ({}, starts(0.00009, 0.50009)),
    "no template": ({}, lambda root: edit_info(root, video_path=None)),
    "v2.1": ({}, as_v2),
    "v2.1 that says v3.0": ({}, lambda root: as_v2(root, "v3.0")),
}


@pytest.mark.parametrize("case", FILMS)
def test_images_of_videos_are_those_of_their_recorded_times(tmp_path, case):
    made, change = FILMS[case]
    root = build(tmp_path / "d", video=made)
    change(root)
    assert levels(Demonstrations.load(root).images).tolist() == FRAMES
    assert levels(Demonstrations.load(root, episodes=[1]).images).tolist() == FRAMES[LENGTHS[0] :]


def test_a_timestamp_may_skip_frames_of_the_video(tmp_path):
    """Data at half the video's rate: frame k of an episode shows the video's frame 2k."""
    root = build(tmp_path / "d", video={"count": 12}, fps=10, lengths=(4,))
    edit_table(root, timestamp=(np.arange(4) / 5).astype(np.float32))
    assert levels(Demonstrations.load(root).images).tolist() == [0, 2, 4, 6]


def test_a_wider_tolerance_takes_the_nearest_frame(tmp_path):
    root = build(tmp_path / "d", video={})
    starts(0.02, 0.46)(root)
    with pytest.raises(DatasetError, match="tolerance_s"):
        Demonstrations.load(root)
    assert levels(Demonstrations.load(root, tolerance_s=0.05).images).tolist() == FRAMES


def key_of(part):
    return f"videos/{CAMERA}/{part}"


def of_video(change):
    """Built with a video, then changed."""
    return lambda root: [shutil.rmtree(root), build(root, video={}), change(root)]


def videos_of(**made):
    return lambda root: [shutil.rmtree(root), build(root, video=made)]


RAGGED = pa.array([[1.0, 2.0, 3.0]] * 7 + [[1.0]] + [[1.0, 2.0, 3.0]] * 3)
WRONG = {
    "fps null": (lambda root: edit_info(root, fps=None), r"info\.json: fps is null; write how many frames"),
    "fps 0": (lambda root: edit_info(root, fps=0), r"info\.json: fps is 0; write"),
    "fps as text": (lambda root: edit_info(root, fps="10"), r'info\.json: fps is "10"; write'),
    "features a list": (lambda root: edit_info(root, features=[]), r"info\.json: features is \[\]; give"),
    "a feature null": (
        lambda root: edit_info_feature(root, "action", None),
        r"info\.json: features is .*; give each name its dtype",
    ),
    "a template of another kind": (
        lambda root: edit_info(root, data_path="data/{chunk_index:03q}"),
        r"info\.json: data_path is 'data/\{chunk_index:03q\}' \(.*\); write data/chunk",
    ),
    "an action missing": (
        table_of(action=[[1.0, 2.0, 3.0]] * 7 + [None] + [[1.0, 2.0, 3.0]] * 3),
        r"file-000\.parquet: action: has no value at frame 7 \(1 missing in all\); fill them in",
    ),
    "a number of an action missing": (
        table_of(action=[[1.0, 2.0, 3.0]] * 7 + [[1.0, None, 2.0]] + [[1.0, 2.0, 3.0]] * 3),
        r"file-000\.parquet: action: has no value at frame 7",
    ),
    "a state missing": (
        table_of(**{"observation.state": [[1.0, 2.0]] * 10 + [None]}),
        r"observation\.state: has no value at frame 10",
    ),
    "a state ragged": (
        table_of(**{"observation.state": [[1.0, 2.0]] * 10 + [[1.0]]}),
        r"observation\.state: has 1 numbers at frame 10 and 2 at frame 0; store as many",
    ),
    "an action ragged": (
        table_of(action=RAGGED),
        r"action: has 1 numbers at frame 7 and 3 at frame 0; store",
    ),
    "an action not finite": (
        table_of(action=np.array([[1.0, 2.0, 3.0]] * 7 + [[1.0, 2.0, np.inf]] * 4)),
        r"action is inf at frame 7, number 2; correct it, or leave out the episode",
    ),
    "a state not finite": (
        table_of(**{"observation.state": np.array([[1.0, 2.0]] * 4 + [[np.nan, 2.0]] * 7)}),
        r"observation\.state is nan at frame 4, number 0; correct it",
    ),
    "too large for float32": (
        table_of(action=np.array([[1.0, 2.0, 3.0]] * 10 + [[1e300, 0.0, 0.0]])),
        r"action is 1e\+300 at frame 10, number 0",
    ),
    "an episode's number missing": (
        table_of(episode_index=[0] * 5 + [1] * 5 + [None]),
        r"file-000\.parquet: episode_index: has no value at frame 10",
    ),
    "a frame's number missing": (
        table_of(frame_index=[None, *range(10)]),
        r"file-000\.parquet: frame_index: has no value at frame 0",
    ),
    "a row without its number": (
        set_meta("episode_index", None),
        r"file-000\.parquet: a row has episode_index None",
    ),
    "a length of another kind": (
        lambda root: edit_rows(root, lambda rows: [row.update(length="long") for row in rows]),
        r"file-000\.parquet: episode 0 has length 'long'; give its number of frames",
    ),
    "an episode listed twice, differently": (
        lambda root: edit_rows(root, lambda rows: rows.append({**rows[0], "length": 4})),
        r"meta/episodes lists episode 0 twice, differently; keep one row",
    ),
    "a task missing": (
        lambda root: write_rows(root / "meta/tasks.parquet", [{"task_index": None, "task": "a"}]),
        r"tasks\.parquet: a task is .*; give each a task_index",
    ),
    "task numbers of something else": (
        table_of(task_index=[0] * 10 + [10**12]),
        r"task_index goes up to 1000000000000; number tasks from 0",
    ),
    "an image file gone": (
        lambda root: [by_path(root), (root / "images/frame-6.png").unlink()],
        r"top: the image of frame 6 is damaged or missing \(no file images/frame-6\.png\); record",
    ),
    "an image missing": (
        lambda root: edit_table(root, **{CAMERA: [*([png(9)] * 4), None, *([png(9)] * 6)]}),
        r"top: the image of frame 4 is damaged; record",
    ),
    "images as lists": (
        table_of(**{CAMERA: np.zeros((N, 4, 4), np.uint8)}),
        r"file-000\.parquet: observation\.images\.top holds images as list.*; dpmacro reads PNG and JPEG",
    ),
    "images of several sizes": (
        table_of(**{CAMERA: [png(9, shape=(8 + k % 2, 8, 3)) for k in FRAMES]}),
        r"top: frame \d+ is \(\d, 8, 3\), others \(\d, 8, 3\); resize it",
    ),
    "rows fewer than told": (
        lambda root: pq.write_table(pq.read_table(root / DATA).slice(0, 8), root / DATA),
        r"half-written, episode 1 has 6 frames by meta/episodes and 3 in file-000\.parquet; record",
    ),
    "lines that are no JSON": (
        lambda root: [as_v2(root), (root / "meta/episodes.jsonl").write_text("{")],
        r"episodes\.jsonl: is not JSON",
    ),
    "lines that are no objects": (
        lambda root: [as_v2(root), (root / "meta/episodes.jsonl").write_text("3\n")],
        r"episodes\.jsonl: object 0 is a int; record",
    ),
    "v2.1 half-copied": (
        lambda root: [as_v2(root), (root / "meta/episodes.jsonl").unlink()],
        r"episodes\.jsonl: is missing",
    ),
    "of no known layout": (
        lambda root: [shutil.rmtree(root / "meta/episodes"), edit_info(root, codebase_version="v1.6")],
        r"LeRobot format v1\.6, dpmacro reads v2\.0, v2\.1 and v3\.x; convert it",
    ),
    "half a frame late": (
        of_video(starts(0.0, 0.55)),
        r"file-000\.mp4: frame 0 of episode 1 is wanted at 0\.55 s, the nearest is at 0\.[56] s "
        r"\(6 frames are 0\.05 s off or less, LeRobot's FrameTimestampError\): correct timestamp or "
        "from_timestamp, or allow more by tolerance_s",
    ),
    "a video that starts late": (
        videos_of(first=3),
        r"file-000\.mp4: frame 0 of episode 0 is wanted at 0 s, the nearest is at 0\.3 s",
    ),
    "a video of another rate": (
        videos_of(count=30, shown=[0] * 30, options={}, fps=15),
        r"file-000\.mp4: frame 1 of episode 0 is wanted at 0\.1 s, the nearest is at 0\.(0666667|133333) s",
    ),
    "a video too short": (
        videos_of(count=8),
        r"file-000\.mp4: frame 3 of episode 1 is wanted at 0\.8 s, the nearest is at 0\.7 s",
    ),
    "timestamps as they came": (
        of_video(table_of(timestamp=np.arange(N) * 0.13)),
        r"frame 1 of episode 0 is wanted at 0\.13 s, the nearest is at 0\.1 s \(10 frames",
    ),
    "timestamps missing": (
        of_video(table_of(timestamp=[None] * N)),
        r"file-000\.parquet: timestamp: has no value at frame 0",
    ),
    "a start missing": (
        of_video(set_meta(key_of("from_timestamp"), None)),
        r"file-000\.parquet: episode 1 has no videos/observation\.images\.top/from_timestamp; record",
    ),
    "a video file not told": (
        of_video(drop_meta(key_of("file_index"))),
        r"episode 0 has no videos/observation\.images\.top/file_index; record",
    ),
    "a video gone": (
        of_video(lambda root: (root / VIDEO).unlink()),
        r"file-000\.mp4: is missing; the dataset",
    ),
    "a video cut": (
        of_video(lambda root: (root / VIDEO).write_bytes((root / VIDEO).read_bytes()[:600])),
        r"file-000\.mp4: cannot be decoded \(.*\); record",
    ),
    "a video that is none": (
        of_video(lambda root: (root / VIDEO).write_bytes(b"")),
        r"file-000\.mp4: cannot be decoded \(.*\); record",
    ),
    "no column of actions": (
        table_of(action=None),
        r"file-000\.parquet: has no column action that meta/info",
    ),
}


@pytest.mark.parametrize("case", WRONG)
def test_what_cannot_be_read_is_told_in_one_line(tmp_path, case):
    root = build(tmp_path / "d")
    change, message = WRONG[case]
    change(root)
    with pytest.raises(DatasetError, match=message) as caught:
        Demonstrations.load(root)
    assert "\n" not in str(caught.value) and str(root) in str(caught.value)


def depths(root, **said):
    """A second camera of 16-bit images, declared as depth by what is `said`."""
    name = "observation.images.depth"
    edit_table(root, **{name: [png(900 + k, np.uint16, (8, 8)) for k in FRAMES]})
    edit_info_feature(root, name, {"dtype": "image", "shape": [8, 8, 1], "names": None, **said})
    return name


def films_of_depths(root, **said):
    name = "observation.images.depth"
    film(
        root / VIDEO.replace(CAMERA, name),
        N,
        10,
        codec="libx265",
        pixels="gray10le",
        options={"x265-params": "log-level=none"},
    )
    edit_rows(
        root, lambda rows: [row.update({k.replace(CAMERA, name): v for k, v in row.items()}) for row in rows]
    )
    edit_info_feature(root, name, {"dtype": "video", "shape": [48, 64, 1], "names": None, **said})
    edit_feature(root, CAMERA, dtype="image")
    return name


DECLARED = [{}, {"info": {"is_depth_map": True}}, {"video_info": {"video.is_depth_map": True}}]


@pytest.mark.parametrize("said", DECLARED, ids=["by the data", "by info", "by video_info"])
@pytest.mark.parametrize("add", [depths, films_of_depths])
def test_depth_is_never_read_as_colours(tmp_path, add, said):
    root = build(tmp_path / "d")
    name = add(root, **said)
    if add is films_of_depths:  # a second image camera, lest videos are left out beside the only one
        edit_table(root, **{"observation.images.side": [png(grey(k)) for k in FRAMES]})
        edit_info_feature(root, "observation.images.side", {"dtype": "image", "shape": [48, 64, 3]})
    loaded = Demonstrations.load(root)
    assert name not in loaded.cameras and CAMERA in loaded.cameras
    assert f"{name} is left out: a depth map" in loaded.notes
    with pytest.raises(DatasetError, match=rf"{name} is a depth map, not colours; leave it out of"):
        Demonstrations.load(root, inputs=[CAMERA, name])


def test_depth_alone_is_no_camera(tmp_path):
    root = build(tmp_path / "d", images=False, state=False)
    depths(root)
    with pytest.raises(DatasetError, match="has no image feature but depth maps, and no state"):
        Demonstrations.load(root)


def test_grey_images_are_colours(tmp_path):
    root = build(tmp_path / "d", columns={CAMERA: [png(grey(k), shape=(48, 64)) for k in FRAMES]})
    assert levels(Demonstrations.load(root).images).tolist() == FRAMES


AS_LEROBOT = {
    "images": (None, kept),
    "rows in another file": (None, in_another_file),
    "video": ({}, kept),
    "video, B-frames": ({"options": {"bf": "3", "g": "6"}}, kept),
    "video at twice the rate": (rate(2), kept),
    "video that starts late": ({"first": 4}, starts(0.4, 0.9)),
    "video, AV1": ({"codec": "libsvtav1"}, kept),
}


@pytest.mark.parametrize("case", AS_LEROBOT)
def test_frames_are_those_that_lerobot_reads(tmp_path, case):
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    made, change = AS_LEROBOT[case]
    root = build(tmp_path / "d", video=made)
    change(root)
    theirs = LeRobotDataset("local/d", root=root, video_backend="pyav")
    ours = Demonstrations.load(root)
    for place in FRAMES:
        item = theirs[place]
        image = np.rint(item[CAMERA].numpy() * 255).transpose(1, 2, 0)
        assert np.abs(image - ours.images[place]).max() <= 1
        assert np.array_equal(item["action"], ours.actions[place])
        assert np.array_equal(item["observation.state"], ours.observations["observation.state"][place])


def test_what_lerobot_refuses_for_its_times_is_refused(tmp_path):
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    root = build(tmp_path / "d", video={})
    starts(0.0, 0.55)(root)
    theirs = LeRobotDataset("local/d", root=root, video_backend="pyav")
    with pytest.raises(Exception, match="violate the tolerance"):
        theirs[LENGTHS[0]]
    with pytest.raises(DatasetError, match="FrameTimestampError"):
        Demonstrations.load(root)
