"""Datasets as users have them: each oddity gives the right frames, or one line that names it and a remedy."""

from pathlib import Path

import numpy as np
import pytest
from lerobot_files import (
    CAMERA,
    LENGTHS,
    VIDEO,
    build,
    edit_feature,
    edit_info,
    edit_rows,
    edit_table,
    film,
    grey,
    levels,
    png,
    write_rows,
)
from odd_cases import FILMS, TABLES
from odd_changes import FRAMES, N, starts, stray_rows
from odd_refused import FILMS_REFUSED, TABLES_REFUSED

from dpmacro.data.demonstrations import DatasetError, Demonstrations


@pytest.mark.parametrize("name", ["plain", "a:b", "with space %d"])
@pytest.mark.parametrize("video", [None, {}], ids=["images", "video"])
def test_a_path_may_be_of_any_letters(tmp_path, monkeypatch, name, video):
    build(tmp_path / name, video=video)
    monkeypatch.chdir(tmp_path)
    for root in (tmp_path / name, Path(name)):
        assert levels(Demonstrations.load(root).images).tolist() == FRAMES


RATE = "; the timestamps say 10 frames a second, which is taken"
TOLD = {
    "tasks under the name that LeRobot 0.4 gives them": "3 tasks, given to the policy as task_index: task 3,",
    "total_frames too large": "info.json says 2 episodes and 1000 frames, meta/episodes lists 2 and 11: ",
    "fps null": f"info.json: fps is null{RATE}",
    "fps 0": f"info.json: fps is 0{RATE}",
    "fps as text": f'info.json: fps is "10"{RATE}',
    "an episode listed twice, with two lengths": "meta/episodes lists episode 0 twice, differently: ",
    "metadata of an episode that has no rows": "episodes 2 are left out: they have less than two frames",
    "metadata of an episode of one frame": "episodes 2 are left out: they have less than two frames",
    "no frame_index at a frame": "frame_index repeats in episodes 0, 1: their frames are taken in the order",
    "frame_index 0 at all frames": "frame_index repeats in episodes 0, 1: their frames are taken in the",
    "frame_index that leaves numbers out": "frame_index leaves numbers out in episodes 0, 1: the frames",
}


@pytest.mark.parametrize("case", TABLES)
def test_odd_datasets_come_back_right(tmp_path, case):
    root = TABLES[case].build(tmp_path / "d")
    loaded = Demonstrations.load(root)
    assert loaded.lengths.tolist() == list(LENGTHS)
    assert levels(loaded.images).tolist() == FRAMES
    assert loaded.actions.shape == (N, 3) and loaded.actions.dtype == np.float32
    assert loaded.observations["observation.state"].shape == (N, 2)
    told = [note for note in loaded.notes if not note.startswith("inputs: ")]
    assert len(told) == (case in TOLD) and all(note.startswith(TOLD[case]) for note in told)
    second = Demonstrations.load(root, episodes=[1, 0])
    assert levels(second.images).tolist() == FRAMES[LENGTHS[0] :] + FRAMES[: LENGTHS[0]]
    assert np.array_equal(second.actions[: LENGTHS[1]], loaded.actions[LENGTHS[0] :])


def test_short_episodes_are_refused_where_they_are_asked_for(tmp_path):
    root = TABLES["metadata of an episode of one frame"].build(tmp_path / "d")
    with pytest.raises(DatasetError, match=r"episode 2 has 1 frame; dpmacro needs at least two frames"):
        Demonstrations.load(root, episodes=[0, 2])
    root = build(tmp_path / "short", lengths=(1, 1))
    with pytest.raises(DatasetError, match=r"episode 0 has 1 frame; dpmacro needs at least two frames"):
        Demonstrations.load(root)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"action": []}, "action names no feature; name one, or leave it out"),
        ({"action": ["timestamp"]}, "timestamp numbers frames, so it is no action; name another feature"),
        ({"inputs": ["state"]}, r"no input 'state'; it has observation\.images\.top, observation\.state$"),
    ],
)
def test_features_that_make_no_sense_are_refused(tmp_path, options, message):
    with pytest.raises(DatasetError, match=message):
        Demonstrations.load(build(tmp_path / "d"), **options)


@pytest.mark.parametrize("fps", [None, 0, "10", True, -3])
def test_without_a_rate_the_timestamps_give_it(tmp_path, fps):
    root = build(tmp_path / "d")
    edit_info(root, fps=fps)
    assert Demonstrations.load(root).fps == 10


def test_the_words_of_a_task_are_in_the_column_that_lerobot_names(tmp_path):
    root = build(tmp_path / "d", columns={"task_index": [2] * N})
    rows = [{"kind": "a", "task_index": k, "task": f"task {3 - k}"} for k in range(3)]
    write_rows(root / "meta/tasks.parquet", rows)
    assert Demonstrations.load(root).tasks == ("task 3", "task 2", "task 1")


def test_rows_of_no_listed_episode_are_left_out(tmp_path):
    root = build(tmp_path / "d")
    stray_rows(root)
    assert levels(Demonstrations.load(root).images).tolist() == FRAMES[: LENGTHS[0]]


@pytest.mark.parametrize("case", FILMS)
def test_images_of_videos_are_those_of_their_recorded_times(tmp_path, case):
    root = FILMS[case].build(tmp_path / "d")
    loaded = Demonstrations.load(root)
    assert levels(loaded.images).tolist() == list(FILMS[case].shown)
    first, last = loaded.lengths[:-1].sum(), len(loaded.lengths) - 1
    one = Demonstrations.load(root, episodes=[last])
    assert levels(one.images).tolist() == list(FILMS[case].shown[first:])


def test_a_wider_tolerance_takes_the_nearest_frame(tmp_path):
    root = build(tmp_path / "d", video={})
    starts(0.02, 0.46)(root)
    with pytest.raises(DatasetError, match="tolerance_s"):
        Demonstrations.load(root)
    assert levels(Demonstrations.load(root, tolerance_s=0.05).images).tolist() == FRAMES


REFUSED = {
    f"{kind}: {name}": odd
    for kind, cases in (("images", TABLES_REFUSED), ("video", FILMS_REFUSED))
    for name, odd in cases.items()
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_cannot_be_read_is_told_in_one_line(tmp_path, case):
    root = REFUSED[case].build(tmp_path / "d")
    with pytest.raises(DatasetError, match=REFUSED[case].line) as caught:
        Demonstrations.load(root)
    assert "\n" not in str(caught.value) and str(root) in str(caught.value)


def depths(root, **said):
    """A second camera of 16-bit images, declared as depth by what is `said`."""
    name = "observation.images.depth"
    edit_table(root, **{name: [png(900 + k, np.uint16, (8, 8)) for k in FRAMES]})
    edit_feature(root, name, dtype="image", shape=[8, 8, 1], names=None, **said)
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
    edit_feature(root, name, dtype="video", shape=[48, 64, 1], names=None, **said)
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
        edit_feature(root, "observation.images.side", dtype="image", shape=[48, 64, 3])
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
    "images": TABLES["nothing odd"],
    "rows in another file": TABLES["an episode's rows in a file that no metadata names"],
    "video": FILMS["nothing odd"],
    "video, B-frames": FILMS["B-frames"],
    "video at twice the rate": FILMS["a video at twice the data's rate"],
    "video that starts late": FILMS["a video that starts late, and metadata that says so"],
    "video, AV1": FILMS["AV1"],
}


@pytest.mark.parametrize("case", AS_LEROBOT)
def test_frames_are_those_that_lerobot_reads(tmp_path, case):
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    root = AS_LEROBOT[case].build(tmp_path / "d")
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
