"""Generated demonstrations: what LeRobot and we read of them, and that they are made once."""

from dataclasses import replace

import numpy as np
import pytest
from generated import DIMS, Contents, generate

from dpmacro.data.demonstrations import Demonstrations

SMALL = Contents(frames=70, cameras=2, width=64, height=48, codec="h264", length=10)


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    return generate(tmp_path_factory.mktemp("generated") / "small", replace(SMALL, length=2 * 2))


def test_lengths_add_up():
    assert SMALL.lengths == [10] * 7
    assert Contents(frames=1000).lengths == [333, 334, 333]
    assert Contents(frames=5, length=300).lengths == [5]


def test_demonstrations_move_and_pictures_with_them(tmp_path):
    root = generate(tmp_path / "g", SMALL)
    loaded = Demonstrations.load(root)
    assert loaded.lengths.tolist() == SMALL.lengths and loaded.actions.shape == (70, DIMS)
    assert loaded.cameras == ("observation.images.camera_0", "observation.images.camera_1")
    state = loaded.observations["observation.state"]
    inside = np.diff(np.repeat(np.arange(7), 10)) == 0
    assert np.allclose((state[1:] - state[:-1])[inside], loaded.actions[:-1][inside], atol=1e-5)
    for camera in loaded.cameras:
        moved = np.abs(np.diff(loaded.observations[camera].astype(int), axis=0)).mean(axis=(1, 2, 3))
        assert np.median(moved) > 1
    first, second = (loaded.observations[camera] for camera in loaded.cameras)
    assert np.abs(first.astype(int) - second).mean() > 5


def test_a_video_file_holds_several_episodes(small):
    """Each starts where its file's frames begin: 17 episodes, in one file; lengths of 4 or 5."""
    loaded = Demonstrations.load(small, episodes=[16, 3])
    whole = Demonstrations.load(small)
    part = whole.select([16, 3])
    for camera in loaded.cameras:
        assert np.array_equal(loaded.observations[camera], part.observations[camera])


def test_lerobot_reads_it(small):
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    theirs, ours = LeRobotDataset("local/g", root=small, video_backend="pyav"), Demonstrations.load(small)
    for place in (0, 33, 69):
        item = theirs[place]
        for camera in ours.cameras:
            image = np.rint(item[camera].numpy() * 255).transpose(1, 2, 0)
            assert np.abs(image - ours.observations[camera][place]).max() <= 1
        assert np.array_equal(item["action"], ours.actions[place])


def test_it_is_made_once(small, tmp_path):
    before = {path: path.stat().st_mtime_ns for path in small.rglob("*")}
    generate(small, replace(SMALL, length=4))
    assert before == {path: path.stat().st_mtime_ns for path in small.rglob("*")}
    with pytest.raises(ValueError, match=r"small holds \{'frames': 70.*asked for is .*: give a new folder"):
        generate(small, SMALL)
    (tmp_path / "other").mkdir()
    with pytest.raises(ValueError, match="other holds another dataset, or none"):
        generate(tmp_path / "other", SMALL)


def test_a_stopped_generation_leaves_nothing(tmp_path, monkeypatch):
    monkeypatch.setattr("generated._texture", lambda contents, camera: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        generate(tmp_path / "g", SMALL)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"frames": 3}, "frames is 3: give 4 or more"),
        ({"width": 65}, "pictures are 65x48: give even"),
        ({"codec": "gif"}, "codec is 'gif': choose from libsvtav1, h264"),
    ],
)
def test_contents_that_cannot_be_made_are_refused(changes, message):
    with pytest.raises(ValueError, match=message):
        replace(SMALL, **changes)
