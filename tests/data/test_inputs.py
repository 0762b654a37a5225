"""What any dataset's features become: actions as classes or vectors, cameras, states, tasks, truth, sizes."""

import json

import cv2
import numpy as np
import pytest
from lerobot_files import (
    CAMERA,
    LENGTHS,
    build,
    edit_info,
    edit_rows,
    edit_table,
    grey,
    levels,
    png,
    vector,
    write_rows,
)

from dpmacro.data.demonstrations import DatasetError, Demonstrations
from dpmacro.data.images import ImageTransform, natural_size

N = sum(LENGTHS)
FRAMES = list(range(N))
STATE = "observation.state"


def add(root, name, values, feature):
    edit_table(root, **{name: values})
    features = json.loads((root / "meta/info.json").read_text())["features"]
    edit_info(root, features={**features, name: feature})


@pytest.fixture
def root(tmp_path):
    return build(tmp_path / "d")


def test_a_dataset_as_users_have_it(root):
    loaded = Demonstrations.load(root)
    assert loaded.vector and loaded.action_names == ("x", "y", "z")
    assert list(loaded.observations) == [CAMERA, STATE] and loaded.cameras == (CAMERA,)
    assert loaded.images.shape == (N, 48, 64, 3) and loaded.observations[STATE].dtype == np.float32
    assert loaded.state_names == {STATE: ("shoulder", "elbow")}
    assert (loaded.tasks, loaded.fps, loaded.truth, loaded.world) == (("stack",), 10.0, None, {})
    assert loaded.notes == (f"inputs: {CAMERA} (64x48), {STATE} (2)",)


@pytest.mark.parametrize(("images", "state"), [(True, False), (False, True)])
def test_a_dataset_may_lack_cameras_or_state(tmp_path, images, state):
    loaded = Demonstrations.load(build(tmp_path / "d", images=images, state=state))
    assert list(loaded.observations) == [CAMERA if images else STATE]
    if not images:
        with pytest.raises(ValueError, match=r"has no camera: it has observation\.state"):
            loaded.images  # noqa: B018
        assert loaded.stored_shape is None and loaded.cameras == ()


def test_a_dataset_of_neither_is_refused(tmp_path):
    with pytest.raises(DatasetError, match=r"has no image feature and, beside .*: --dataset\.inputs="):
        Demonstrations.load(build(tmp_path / "d", images=False, state=False))


@pytest.mark.parametrize("fps", [29.97, 0.5, 30.0062, 10])
def test_frames_per_second_are_as_stored(tmp_path, fps):
    loaded = Demonstrations.load(build(tmp_path / "d", fps=fps, video={}))
    assert loaded.fps == fps and levels(loaded.images).tolist() == FRAMES


SCALARS = {f"action.{joint}": (np.arange(N) * scale, vector(1)) for joint, scale in (("a", 0.5), ("b", 2.5))}
ONE_HOT = np.eye(3, dtype=np.float32)[np.arange(N) % 3]
ACTIONS = {
    "float16": ({"action": (np.linspace(0, 1, 2 * N).reshape(N, 2).astype(np.float16), vector(2))}, (N, 2)),
    "float64 scalar": ({"action": (np.linspace(0, 1, N), vector(1, "float64"))}, (N, 1)),
    "fractions beyond 255": ({"action": (np.arange(N) * 100.0, vector(1))}, (N, 1)),
    "a list of one": ({"action": (np.linspace(0, 1, N)[:, None], vector(1))}, (N, 1)),
    "rows of rows": (
        {"action": (np.linspace(0, 1, 6 * N).reshape(N, 2, 3), {"dtype": "float32", "shape": [2, 3]})},
        (N, 6),
    ),
    "integers": ({"action": (np.arange(2 * N).reshape(N, 2), vector(2, "int64"))}, (N, 2)),
    "0 and 1, not one-hot": ({"action": (np.ones((N, 2)), vector(2))}, (N, 2)),
    "one-hot but for a frame": ({"action": (np.vstack([ONE_HOT[1:], np.zeros((1, 3))]), vector(3))}, (N, 3)),
    "called actions": (
        {"action": None, "actions": (np.linspace(0, 1, 2 * N).reshape(N, 2), vector(2))},
        (N, 2),
    ),
    "scalars": ({"action": None, **SCALARS}, (N, 2)),
    "one-hot": ({"action": (ONE_HOT, vector(3))}, (N,)),
    "an integer": ({"action": (np.arange(N) % 3, vector(1, "int32"))}, (N,)),
    "discrete beside": ({"discrete_action": (np.arange(N) % 3, vector(1, "int64"))}, (N,)),
}


def stored(root, case):
    changes, shape = ACTIONS[case]
    return build(
        root,
        columns={name: change and change[0] for name, change in changes.items()},
        features={name: change and change[1] for name, change in changes.items()},
    ), shape


@pytest.mark.parametrize("case", ACTIONS)
def test_actions_are_read_however_they_are_stored(tmp_path, case):
    root, shape = stored(tmp_path / "d", case)
    loaded = Demonstrations.load(root)
    assert loaded.actions.shape == shape and loaded.vector is (len(shape) == 2)
    assert loaded.actions.dtype == (np.float32 if loaded.vector else np.int64)
    assert len(loaded.action_names) == (shape[1] if loaded.vector else 3)
    if not loaded.vector:
        assert np.array_equal(loaded.actions, np.arange(N) % 3)
    assert loaded.select([1]).actions.shape == (LENGTHS[1], *shape[1:])


def test_scalars_are_a_vector_in_the_order_asked_for(tmp_path):
    root, _ = stored(tmp_path / "d", "scalars")
    loaded = Demonstrations.load(root)
    assert loaded.action_names == ("a", "b") and loaded.actions[2].tolist() == [1.0, 5.0]
    loaded = Demonstrations.load(root, action=["action.b", "action.a"])
    assert loaded.action_names == ("b", "a") and loaded.actions[2].tolist() == [5.0, 1.0]
    assert Demonstrations.load(root, action="action.b").actions.shape == (N, 1)
    loaded = Demonstrations.load(root, action=["action.b", STATE])
    assert loaded.action_names == ("b", f"{STATE}.shoulder", f"{STATE}.elbow")
    assert list(loaded.observations) == [CAMERA]


NAMES = {
    "a list": (["a", "b", "c"], ("a", "b", "c")),
    "a dict of a list": ({"motors": ["a", "b", "c"]}, ("a", "b", "c")),
    "a dict of lists": ({"arm": ["a", "b"], "hand": ["c"]}, ("a", "b", "c")),
    "a dict of places": ({"c": 2, "a": 0, "b": 1}, ("a", "b", "c")),
    "a dict within": ({"axes": {"b": 1, "a": 0, "c": 2}}, ("a", "b", "c")),
    "lists in a list": ([["a", "b"], ["c"]], ("a", "b", "c")),
    "too few": (["a"], ("0", "1", "2")),
    "null": (None, ("0", "1", "2")),
    "numbers": ([0, 1, 2], ("0", "1", "2")),
}


@pytest.mark.parametrize("case", NAMES)
def test_names_are_read_however_they_are_stored(tmp_path, case):
    names, expected = NAMES[case]
    root = build(tmp_path / "d", features={"action": vector(3, names=names)})
    assert Demonstrations.load(root).action_names == expected


def test_inputs_are_those_asked_for(root):
    add(root, "observation.force", np.ones((N, 4), np.float32), vector(4))
    add(root, "effort", np.ones(N, np.float32), vector(1))
    assert list(Demonstrations.load(root).observations) == [CAMERA, STATE, "observation.force"]
    loaded = Demonstrations.load(root, inputs=["effort", CAMERA])
    assert {name: values.shape for name, values in loaded.observations.items()} == {
        CAMERA: (N, 48, 64, 3),
        "effort": (N, 1),
    }
    assert list(Demonstrations.load(root, camera=CAMERA).observations) == [CAMERA]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"inputs": ["front"]}, rf"no input 'front'; it has {CAMERA}, "),
        ({"inputs": ["timestamp"]}, r"no input 'timestamp'; it has"),
        ({"inputs": ["action"]}, r"action is the action or the truth, so it is no input"),
        ({"inputs": []}, r"inputs are none; name at least one"),
        ({"inputs": [STATE], "camera": CAMERA}, rf"camera={CAMERA} and inputs=\['{STATE}'\]; give one"),
        ({"action": "move"}, r"has no feature 'move' to be the action; it has episode_index, "),
        ({"action": CAMERA}, rf"{CAMERA}: holds values of type struct.*dpmacro reads numbers"),
        ({"task": "fly"}, r"no episode of task 'fly' among those chosen; there are 'stack'"),
        ({"truth": "action"}, r"no integer column 'action' to be the truth"),
        ({"truth": "frame_index"}, r"no integer column 'frame_index' to be the truth"),
    ],
)
def test_what_is_not_there_is_told(root, options, message):
    with pytest.raises(DatasetError, match=message):
        Demonstrations.load(root, **options)


def test_state_and_image_may_have_their_old_names(tmp_path):
    columns = {CAMERA: None, "image": [{"bytes": png(grey(k)), "path": None} for k in FRAMES]}
    columns["state"] = np.ones((N, 2), np.float32)
    features = {CAMERA: None, "image": {"dtype": "image", "shape": [48, 64, 3]}, "state": vector(2)}
    root = build(tmp_path / "d", columns, features, state=False)
    assert list(Demonstrations.load(root).observations) == ["image", "state"]


def test_large_vectors_are_inputs_only_where_asked_for(root):
    add(root, "observation.cloud", np.ones((N, 400, 3), np.float32), {"dtype": "float32", "shape": [400, 3]})
    loaded = Demonstrations.load(root)
    assert "observation.cloud" not in loaded.observations
    assert "observation.cloud is left out: 1200 numbers a frame" in loaded.notes
    assert (
        Demonstrations.load(root, inputs=["observation.cloud"]).observations["observation.cloud"].shape[1]
        == 1200
    )


def of_two_tasks(root):
    write_rows(
        root / "meta/tasks.parquet", [{"task_index": 1, "task": "pour"}, {"task_index": 0, "task": "stack"}]
    )
    edit_table(root, task_index=np.repeat([0, 1], LENGTHS))
    edit_rows(root, lambda rows: rows[1].update(tasks=["pour"]))


@pytest.mark.parametrize("listed", [True, False])
def test_several_tasks_are_seen_or_chosen(root, listed):
    of_two_tasks(root)
    if not listed:
        edit_rows(root, lambda rows: [row.pop("tasks") for row in rows])
    loaded = Demonstrations.load(root)
    assert loaded.tasks == ("stack", "pour")
    assert loaded.observations["task_index"].tolist() == [0] * LENGTHS[0] + [1] * LENGTHS[1]
    assert "2 tasks, given to the policy as task_index: stack, pour" in loaded.notes
    for task in ("pour", 1, "1"):
        chosen = Demonstrations.load(root, task=task)
        assert (
            levels(chosen.images).tolist() == FRAMES[LENGTHS[0] :] and "task_index" not in chosen.observations
        )


def test_truth_may_be_text_or_large_numbers(root):
    words = ["reach", "lift", "reach", "put"] * 3
    add(root, "stage", words[:N], vector(1, "string"))
    add(root, "step", np.array([10**15, 7, 10**15] * 4)[:N], vector(1, "int64"))
    loaded = Demonstrations.load(root, truth="stage")
    assert loaded.truth_classes == ("lift", "put", "reach")
    assert [loaded.truth_classes[label] for label in loaded.truth] == words[:N]
    loaded = Demonstrations.load(root, truth="step")
    assert loaded.truth_classes == ("7", "1000000000000000") and loaded.truth[:3].tolist() == [1, 0, 1]


def test_a_truth_of_many_labels_is_no_truth(tmp_path):
    root = build(tmp_path / "d", images=False, lengths=(600, 600))
    add(root, "phase", np.arange(1200) * 10**14, vector(1, "int64"))
    with pytest.raises(
        DatasetError, match=r"phase has 1200 different labels, from 0 to .*; name another column"
    ):
        Demonstrations.load(root)
    assert Demonstrations.load(root, truth="none").truth is None


SIZES = {
    (64, 48): (64, 48),
    (128, 96): (128, 96),
    (640, 480): (64, 48),
    (1280, 720): (74, 42),
    (480, 640): (48, 64),
}


@pytest.mark.parametrize("size", SIZES)
def test_large_images_are_shrunk_to_about_as_many_pixels(size):
    assert natural_size(*size) == SIZES[size]


def large(root, **more):
    """A dataset with a second camera of 160x120 noise."""
    rng = np.random.default_rng(0)
    images = rng.integers(0, 256, (N, 120, 160, 3), np.uint8)
    encoded = [cv2.imencode(".png", image[..., ::-1])[1].tobytes() for image in images]
    add(root, "observation.images.side", encoded, {"dtype": "image", "shape": [120, 160, 3]})
    return images


def test_every_camera_has_its_size(root):
    images = large(root)
    side = "observation.images.side"
    loaded = Demonstrations.load(root)
    assert loaded.stored_shapes == {CAMERA: None, side: (120, 160)} and loaded.stored_shape is None
    wanted = [cv2.resize(image, (64, 48), interpolation=cv2.INTER_AREA) for image in images]
    assert np.array_equal(loaded.observations[side], wanted)
    assert f"{side} (160x120 shrunk to 64x48)" in loaded.notes[0]
    loaded = Demonstrations.load(root, transform=ImageTransform({side: (160, 120)}))
    assert np.array_equal(loaded.observations[side], images) and loaded.images.shape == (N, 48, 64, 3)
    loaded = Demonstrations.load(root, transform=ImageTransform((16, 12)))
    assert {values.shape[1:3] for values in loaded.observations.values() if values.ndim == 4} == {(12, 16)}


def test_all_cameras_share_the_memory(root):
    large(root)
    room = 2.5 * N * 48 * 64 * 3 / 2**30
    assert Demonstrations.load(root, transform=ImageTransform(memory=room)).cameras[1:]
    with pytest.raises(DatasetError, match=r"images of 64x48 and of 1 cameras more take .* GiB"):
        Demonstrations.load(root, transform=ImageTransform(memory=room * 0.7))


def test_joined_and_selected_keep_all_that_is_seen(root):
    of_two_tasks(root)
    loaded = Demonstrations.load(root)
    both = loaded.select([1]).joined(loaded.select([0]))
    order = FRAMES[LENGTHS[0] :] + FRAMES[: LENGTHS[0]]
    for name, values in loaded.observations.items():
        assert np.array_equal(both.observations[name], values[order])
    assert np.array_equal(both.actions, loaded.actions[order])
    with pytest.raises(
        ValueError, match=rf"has {CAMERA}, {STATE}, task_index and .* {STATE}: join like with like"
    ):
        loaded.joined(Demonstrations.load(root, inputs=[STATE], task="pour"))


def test_demonstrations_of_images_are_made_by_hand(root):
    loaded = Demonstrations.load(root)
    made = Demonstrations.of_images(
        loaded.images, loaded.actions, loaded.lengths, ("x", "y", "z"), 10, None, {}, root
    )
    assert made.cameras == ("observation.image",) and np.array_equal(made.images, loaded.images)
    assert Demonstrations.of_images(loaded.images, *made_parts(loaded), camera=CAMERA).cameras == (CAMERA,)


def made_parts(loaded):
    return loaded.actions, loaded.lengths, loaded.action_names, loaded.fps, None, {}, loaded.root


def test_a_video_is_read_in_runs_and_from_the_middle(tmp_path):
    """More frames than a thread decodes at a time; a few episodes are read without those between."""
    lengths = (450, 450, 450)
    shown = [(7 * k) % 12 for k in range(sum(lengths))]
    for options in ({"g": "2"}, {"g": "30", "bf": "3"}, {"g": "1000"}):
        name = "-".join(options.values())
        root = build(tmp_path / name, video={"shown": shown, "options": options}, lengths=lengths)
        assert levels(Demonstrations.load(root).images).tolist() == shown
        some = Demonstrations.load(root, episodes=[2, 0])
        assert levels(some.images).tolist() == shown[900:] + shown[:450]
