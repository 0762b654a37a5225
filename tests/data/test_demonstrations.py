import json
import shutil
import socket
import time
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from noise import ACTIONS, AVATAR, LENGTHS, WORLD, random_episodes, write

from dpmacro.data.demonstrations import DatasetError, Demonstrations
from dpmacro.data.images import ImageTransform
from dpmacro.evaluation.run_writer import VIEW

DATA = "data/chunk-000/file-000.parquet"
EPISODES = "meta/episodes/chunk-000/file-000.parquet"
AS_FILMED, PLAIN = ImageTransform((320, 240)), ImageTransform()


@pytest.fixture
def root(recorded, tmp_path) -> Path:
    """A copy of the recorded dataset, to spoil."""
    return Path(shutil.copytree(recorded, tmp_path / "copy"))


@pytest.fixture(scope="session")
def two_cameras(tmp_path_factory) -> Path:
    """Two episodes with the view for people, a flat colour a frame that video keeps roughly."""
    episodes = list(random_episodes((8, 6), shape=(24, 32, 3)))
    for episode in episodes:
        level = episode["actions"] * 100 + 20
        views = np.broadcast_to(level[:, None, None, None], (len(level), 240, 320, 3))
        episode["views"] = np.ascontiguousarray(views, np.uint8)
    return write(tmp_path_factory.mktemp("cameras") / "two_cameras", episodes, {})


def edit_json(path, **changes):
    content = json.loads(path.read_text())
    content.update(changes)
    path.write_text(json.dumps(content))


def edit_features(root, **changes):
    """Change features of info.json; None drops one."""
    info = json.loads((root / "meta/info.json").read_text())
    features = info["features"] | {name.replace("__", "."): value for name, value in changes.items()}
    edit_json(root / "meta/info.json", features={k: v for k, v in features.items() if v is not None})


def set_column(root, name, values, feature=None, file=DATA):
    """Replace, or add, a column of the dataset; `feature` says in info.json what it is."""
    table = pq.read_table(root / file)
    column = pa.array(values) if not isinstance(values, pa.Array) else values
    if name in table.column_names:
        table = table.set_column(table.column_names.index(name), name, column)
    else:
        table = table.append_column(name, column)
    pq.write_table(table.replace_schema_metadata(None), root / file)
    if feature is not None:
        edit_features(root, **{name: feature})


def truncate(path):
    path.write_bytes(path.read_bytes()[:-20])


def spoil_image(root, frame, content):
    images = pq.read_table(root / DATA)[AVATAR].to_pylist()
    images[frame]["bytes"] = content(images[frame]["bytes"])
    set_column(root, AVATAR, images)


def actions_as(root, values, dtype, size):
    """Store the actions as `action` alone."""
    edit_features(root, discrete_action=None)
    set_column(root, "action", values, {"dtype": dtype, "shape": [size], "names": None})


def expected():
    episodes = list(random_episodes())
    return {
        name: np.concatenate([episode[name] for episode in episodes]) for name in ("images", "actions")
    } | {"truth": np.concatenate([episode["truth"]["phase"] for episode in episodes])}


def test_what_was_recorded_comes_back_bit_for_bit(recorded):
    loaded = Demonstrations.load(str(recorded))
    wanted = expected()
    assert np.array_equal(loaded.images, wanted["images"])
    assert np.array_equal(loaded.actions, wanted["actions"])
    assert loaded.truth is not None and np.array_equal(loaded.truth, wanted["truth"])
    assert loaded.lengths.tolist() == list(LENGTHS)
    assert (loaded.action_names, loaded.fps, loaded.world, loaded.root) == (ACTIONS, 30, WORLD, recorded)
    assert [t.stop - t.start for t in loaded.trajectories] == list(LENGTHS)
    assert loaded.trajectories[0].start == 0


@pytest.mark.parametrize("indices", [[0], [3, 1], [2, 1, 0, 3]])
def test_episodes_come_in_the_order_asked_for(recorded, indices):
    episodes = list(random_episodes())
    images = np.concatenate([episodes[index]["images"] for index in indices])
    loaded = Demonstrations.load(recorded, episodes=indices)
    selected = Demonstrations.load(recorded).select(indices)
    for some in (loaded, selected):
        assert np.array_equal(some.images, images)
        assert some.lengths.tolist() == [LENGTHS[index] for index in indices]
        assert len(some.truth) == len(some.actions) == len(images)
        assert some.action_names == ACTIONS


@pytest.mark.parametrize("indices", [[], [4], [0, -1]])
def test_select_refuses_trajectories_that_are_not_there(recorded, indices):
    with pytest.raises(ValueError, match=r"choose from 0\.\.3"):
        Demonstrations.load(recorded).select(indices)


def test_loading_touches_neither_network_nor_cache(recorded, monkeypatch):
    def refuse(*_args, **_kwargs):
        raise AssertionError("network")

    monkeypatch.setattr(socket.socket, "connect", refuse)
    monkeypatch.setattr(socket, "getaddrinfo", refuse)
    monkeypatch.setenv("HF_HUB_OFFLINE", "0")
    before = sorted(path for path in recorded.rglob("*"))
    Demonstrations.load(recorded)
    assert sorted(path for path in recorded.rglob("*")) == before


def numbers(root):
    return expected()["actions"]


STORED_ACTIONS = {
    "one-hot alone": (lambda root: edit_features(root, discrete_action=None), ACTIONS),
    "one-hot of float64 in lists": (
        lambda root: actions_as(root, np.eye(3)[numbers(root)].tolist(), "float64", 3),
        ("0", "1", "2"),
    ),
    "int64": (lambda root: actions_as(root, numbers(root), "int64", 1), ("0", "1", "2")),
    "int32": (lambda root: actions_as(root, numbers(root).astype(np.int32), "int32", 1), ("0", "1", "2")),
    "whole float32": (
        lambda root: actions_as(root, numbers(root).astype(np.float32), "float32", 1),
        ("0", "1", "2"),
    ),
    "int64 in lists of one": (
        lambda root: actions_as(root, numbers(root)[:, None].tolist(), "int64", 1),
        ("0", "1", "2"),
    ),
    "discrete beside a list of one": (
        lambda root: set_column(
            root,
            "action",
            [[k % 2] for k in range(30)],
            {"dtype": "float32", "shape": [1], "names": ["gripper"]},
        ),
        ("0", "1", "2"),
    ),
    "discrete beside continuous": (
        lambda root: set_column(
            root, "action", np.full((30, 2), 0.5).tolist(), {"dtype": "float32", "shape": [2], "names": None}
        ),
        ("0", "1", "2"),
    ),
    "discrete alone": (lambda root: edit_features(root, action=None), ("0", "1", "2")),
    "names in a dict": (
        lambda root: edit_features(
            root, action={"dtype": "float32", "shape": [3], "names": {"motors": ["a", "b", "c"]}}
        ),
        ("a", "b", "c"),
    ),
}


@pytest.mark.parametrize("case", STORED_ACTIONS)
def test_discrete_actions_are_read_however_they_are_stored(root, case):
    spoil, names = STORED_ACTIONS[case]
    spoil(root)
    loaded = Demonstrations.load(root)
    assert np.array_equal(loaded.actions, expected()["actions"])
    assert loaded.action_names == names


@pytest.mark.parametrize("kind", ["bool", "int64"])
def test_actions_may_be_yes_and_no(root, kind):
    values = expected()["actions"] == 1
    actions_as(root, values if kind == "bool" else values.astype(kind)[:, None].tolist(), kind, 1)
    loaded = Demonstrations.load(root)
    assert np.array_equal(loaded.actions, expected()["actions"] == 1)
    assert loaded.action_names == ("0", "1")


def test_names_of_numbers_do_not_depend_on_the_episodes_chosen(root):
    actions = np.zeros(30, np.int64)
    actions[29] = 2
    actions_as(root, actions, "int64", 1)
    edit_json(root / "meta/stats.json", action={"max": [2]})
    assert Demonstrations.load(root, episodes=[0]).action_names == ("0", "1", "2")


def test_data_of_others_need_neither_truth_nor_world(root):
    edit_features(root, phase=None)
    (root / "meta/dpmacro.json").unlink()
    loaded = Demonstrations.load(root)
    assert loaded.truth is None and loaded.select([1]).truth is None
    assert loaded.world == {}


WHOLE = {"dtype": "int64", "shape": [1], "names": None}


def test_the_truth_is_the_recorded_column_and_has_its_names(recorded):
    loaded = Demonstrations.load(recorded)
    assert (loaded.truth_name, loaded.truth_classes) == ("phase", ("before blue", "after blue"))
    some = loaded.select([1])
    assert (some.truth_name, some.truth_classes) == ("phase", ("before blue", "after blue"))


@pytest.mark.parametrize("dtype", [np.int64, np.int32, np.uint8, "vector"])
def test_another_column_can_be_the_truth(root, dtype):
    labels = np.arange(30) % 4
    values = labels[:, None].tolist() if dtype == "vector" else labels.astype(dtype)
    kind = "int64" if dtype == "vector" else np.dtype(dtype).name
    set_column(root, "skill", values, WHOLE | {"dtype": kind})
    loaded = Demonstrations.load(root, truth="skill")
    assert loaded.truth.dtype == np.int64 and np.array_equal(loaded.truth, labels)
    assert (loaded.truth_name, loaded.truth_classes) == ("skill", ("0", "1", "2", "3"))
    assert Demonstrations.load(root).truth_name == "phase"


def test_the_columns_of_actions_can_be_the_truth(recorded):
    loaded = Demonstrations.load(recorded, truth="discrete_action")
    assert np.array_equal(loaded.truth, loaded.actions)


@pytest.mark.parametrize(
    ("there", "chosen"),
    [(("subgoal",), "subgoal"), (("subgoal", "phase"), "phase"), (("skill",), None)],
)
def test_data_of_others_may_have_a_truth_by_its_name(root, there, chosen):
    (root / "meta/dpmacro.json").unlink()
    edit_features(root, phase=None)
    for name in there:
        set_column(root, name, [0, 2] * 15, WHOLE)
    loaded = Demonstrations.load(root)
    assert loaded.truth_name == chosen
    assert loaded.truth_classes == (() if chosen is None else ("0", "1", "2"))


def test_a_column_of_no_whole_numbers_is_never_the_truth(root):
    set_column(root, "phase", [0.5] * 30, WHOLE | {"dtype": "float32"})
    assert Demonstrations.load(root).truth is None
    with pytest.raises(DatasetError, match=r"no integer column 'phase' to be the truth"):
        Demonstrations.load(root, truth="phase")


def test_classes_do_not_depend_on_the_episodes_chosen(root):
    labels = np.zeros(30, np.int64)
    labels[29] = 2
    set_column(root, "skill", labels, WHOLE)
    edit_json(root / "meta/stats.json", skill={"max": [2]})
    assert Demonstrations.load(root, episodes=[0], truth="skill").truth_classes == ("0", "1", "2")


def test_labels_beyond_the_named_classes_are_numbers(root):
    set_column(root, "phase", [0, 3] * 15)
    assert Demonstrations.load(root).truth_classes == ("before blue", "after blue", "2", "3")


def test_a_dataset_may_do_without_its_truth(root):
    set_column(root, "phase", [-1] * 30)
    loaded = Demonstrations.load(root, truth="none")
    assert (loaded.truth, loaded.truth_name, loaded.truth_classes) == (None, None, ())


def test_negative_labels_are_refused(root):
    set_column(root, "skill", [0] * 7 + [-1] * 23, WHOLE)
    with pytest.raises(
        DatasetError, match=r"skill -1 of frame 7 is negative; name another column as truth, or none"
    ):
        Demonstrations.load(root, truth="skill")


def test_the_lossless_camera_is_preferred_and_video_can_be_named(two_cameras):
    avatar = Demonstrations.load(two_cameras)
    assert avatar.images.shape == (14, 24, 32, 3)
    assert f"{VIEW} is left out: a video beside images" in avatar.notes
    video = Demonstrations.load(two_cameras, camera=VIEW, transform=AS_FILMED)
    assert video.images.shape == (14, 240, 320, 3)
    levels = video.images.mean(axis=(1, 2, 3))
    assert np.abs(levels - (video.actions * 100 + 20)).max() < 8
    later = Demonstrations.load(two_cameras, episodes=[1, 0], camera=VIEW, transform=AS_FILMED)
    assert np.array_equal(later.images[:6], video.images[8:])
    assert np.array_equal(later.images[6:], video.images[:8])


@pytest.mark.parametrize("camera", [AVATAR, VIEW])
@pytest.mark.parametrize("size", [(16, 12), (7, 24), (1, 1)])
def test_images_are_shrunk_while_they_are_read(two_cameras, camera, size):
    stored = Demonstrations.load(two_cameras, camera=camera, transform=AS_FILMED if camera == VIEW else PLAIN)
    shrunk = Demonstrations.load(two_cameras, camera=camera, transform=ImageTransform(size))
    wanted = np.stack([cv2.resize(image, size, interpolation=cv2.INTER_AREA) for image in stored.images])
    # Of a video the planes are shrunk, before colours are computed and rounded.
    off = np.abs(shrunk.images.astype(int) - wanted.reshape(shrunk.images.shape))
    assert off.max() <= (0 if camera == AVATAR else 4) and off.mean() < 1.5
    assert (stored.stored_shape, shrunk.stored_shape) == (None, stored.images.shape[1:3])
    assert shrunk.select([1]).stored_shape == stored.images.shape[1:3]


def test_a_size_that_is_the_stored_one_changes_nothing(recorded):
    same = Demonstrations.load(recorded, transform=ImageTransform((64, 48)))
    assert same.stored_shape is None and np.array_equal(same.images, expected()["images"])


@pytest.mark.parametrize("camera", [AVATAR, VIEW])
def test_images_that_cannot_be_held_as_asked_are_refused(two_cameras, camera):
    with pytest.raises(DatasetError, match=rf"{camera}: images are .*, image_size is 999x12: ask for"):
        Demonstrations.load(two_cameras, camera=camera, transform=ImageTransform((999, 12)))
    with pytest.raises(DatasetError, match=r"14 images of .* GiB, and there are 1e-06 for them"):
        Demonstrations.load(two_cameras, camera=camera, transform=ImageTransform(memory=1e-6))
    small = Demonstrations.load(two_cameras, camera=camera, transform=ImageTransform((4, 4), memory=1e-6))
    assert small.images.shape == (14, 4, 4, 3)


def test_several_files_and_chunks(root):
    table = pq.read_table(root / DATA)
    rows = pq.read_table(root / EPISODES).to_pydict()
    for episode, (chunk, file) in enumerate([(0, 0), (0, 1), (1, 0), (0, 1)]):
        rows["data/chunk_index"][episode], rows["data/file_index"][episode] = chunk, file
    for chunk, file, episodes in ((0, 0, [0]), (0, 1, [1, 3]), (1, 0, [2])):
        path = root / f"data/chunk-{chunk:03d}/file-{file:03d}.parquet"
        path.parent.mkdir(exist_ok=True)
        pq.write_table(table.filter(pa.compute.is_in(table["episode_index"], pa.array(episodes))), path)
    episodes_table = pa.table(rows)
    pq.write_table(episodes_table.slice(0, 2), root / EPISODES)
    (root / "meta/episodes/chunk-001").mkdir()
    pq.write_table(episodes_table.slice(2), root / "meta/episodes/chunk-001/file-000.parquet")
    assert np.array_equal(Demonstrations.load(root).images, expected()["images"])
    assert Demonstrations.load(root, episodes=[3, 2]).lengths.tolist() == [9, 2]


SPOILED = {
    "no folder": (shutil.rmtree, r"no such folder; record one"),
    "no info": (
        lambda root: (root / "meta/info.json").unlink(),
        r"info\.json: cannot be read \(No such file",
    ),
    "info is no JSON": (lambda root: truncate(root / "meta/info.json"), r"info\.json: is not JSON"),
    "info lacks a key": (
        lambda root: (root / "meta/info.json").write_text('{"codebase_version": "v3.0"}'),
        r"has no features",
    ),
    "more episodes promised": (
        lambda root: edit_json(root / "meta/info.json", total_episodes=5),
        r"half-written, info\.json says 5 episodes",
    ),
    "no episodes file": (lambda root: (root / EPISODES).unlink(), r"meta/episodes lists no episode"),
    "episodes file cut": (lambda root: truncate(root / EPISODES), r"half-written or damaged \(.*record"),
    "data file cut": (lambda root: truncate(root / DATA), r"file-000\.parquet: half-written or damaged"),
    "data file missing": (lambda root: (root / DATA).unlink(), r"file-000\.parquet: is missing"),
    "rows missing": (
        lambda root: pq.write_table(pq.read_table(root / DATA).slice(0, 25), root / DATA),
        r"episode 3 has 9 frames by meta/episodes and 4 in file-000\.parquet",
    ),
    "column missing": (
        lambda root: pq.write_table(pq.read_table(root / DATA).drop_columns(["phase"]), root / DATA),
        r"has no column phase",
    ),
    "no image feature": (
        lambda root: edit_features(root, observation__images__avatar=None),
        r"has no image feature",
    ),
    "one-frame episode": (
        lambda root: [
            set_column(root, "length", [12, 1, 2, 9], file=EPISODES),
            edit_json(root / "meta/info.json", total_frames=24),
        ],
        r"half-written, episode 1 has 1 frames by meta/episodes and 7 in file-000",
    ),
    "no action": (
        lambda root: edit_features(root, action=None, discrete_action=None),
        r"has no action feature",
    ),
    "action too large": (
        lambda root: set_column(root, "discrete_action", [0] * 5 + [3] + [0] * 24),
        r"discrete_action 3 of frame 5 is outside 0\.\.2",
    ),
    "action negative": (
        lambda root: actions_as(root, [0, -1] * 15, "int64", 1),
        r"action -1 of frame 1 is outside",
    ),
    "not a number": (
        lambda root: actions_as(root, [0.0] * 29 + [np.nan], "float32", 1),
        r"action is nan at frame 29, number 0; correct it",
    ),
    "ticks": (
        lambda root: actions_as(root, [0] * 29 + [10**9], "int64", 1),
        r"action goes up to 1000000000; dpmacro needs actions numbered from 0",
    ),
    "words": (
        lambda root: actions_as(root, ["go"] * 30, "string", 1),
        r"action is of type object \(first 'go'\); dpmacro needs numbers",
    ),
    "PNG cut": (lambda root: spoil_image(root, 4, lambda b: b[:200]), r"image of frame 4 is damaged"),
    "PNG flipped": (
        lambda root: spoil_image(root, 29, lambda b: b[:900] + bytes([b[900] ^ 255]) + b[901:]),
        r"image of frame 29 is damaged",
    ),
    "PNG empty": (lambda root: spoil_image(root, 0, lambda b: None), r"image of frame 0 is damaged"),
}


@pytest.mark.parametrize("case", SPOILED)
def test_what_cannot_be_read_is_refused_in_one_line(root, case):
    spoil, message = SPOILED[case]
    spoil(root)
    with pytest.raises(DatasetError, match=message) as caught:
        Demonstrations.load(root)
    assert "\n" not in str(caught.value) and str(root) in str(caught.value)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"episodes": [0, 7]}, r"no episode 7; it has 4, from 0 to 3"),
        ({"episodes": []}, r"episodes=\[\], give each wanted one once"),
        ({"episodes": [1, 1]}, r"episodes=\[1, 1\], give each"),
        ({"camera": "front"}, rf"no input 'front'; it has {AVATAR}"),
        (
            {"truth": "skill"},
            r"no integer column 'skill' to be the truth, nor one of text; it has discrete_action, phase, ",
        ),
    ],
)
def test_what_is_not_there_is_refused(recorded, options, message):
    with pytest.raises(DatasetError, match=message):
        Demonstrations.load(recorded, **options)


def test_all_cameras_of_a_kind_are_seen(root):
    images = pq.read_table(root / DATA)[AVATAR].combine_chunks()
    set_column(root, "observation.images.rear", images)
    info = json.loads((root / "meta/info.json").read_text())
    edit_features(root, observation__images__rear=info["features"][AVATAR])
    assert Demonstrations.load(root).cameras == (AVATAR, "observation.images.rear")
    assert Demonstrations.load(root, camera="observation.images.rear").cameras == ("observation.images.rear",)


@pytest.mark.parametrize(
    ("spoil", "message"),
    [(truncate, "lacks frame|cannot be decoded|ends within its part"), (Path.unlink, "is missing")],
)
def test_video_that_cannot_be_read(two_cameras, tmp_path, spoil, message):
    root = Path(shutil.copytree(two_cameras, tmp_path / "copy"))
    path = root / f"videos/{VIEW}/chunk-000/file-000.mp4"
    if spoil is truncate:
        path.write_bytes(path.read_bytes()[:600])
    else:
        spoil(path)
    with pytest.raises(DatasetError, match=message):
        Demonstrations.load(root, camera=VIEW)


def test_loading_is_fast(root):
    """Half of what one core of a busy machine reads; the point is to notice a tenfold loss."""
    table = pq.read_table(root / DATA)
    copies = 100
    count = np.arange(copies * 30)
    tables = pa.concat_tables([table] * copies)
    tables = tables.set_column(
        tables.column_names.index("episode_index"), "episode_index", pa.array(count // 30)
    )
    pq.write_table(tables, root / DATA)
    columns = ("data/chunk_index", "data/file_index")
    rows = {"episode_index": range(copies), "length": [30] * copies} | {
        name: [0] * copies for name in columns
    }
    pq.write_table(pa.table(rows), root / EPISODES)
    edit_json(root / "meta/info.json", total_frames=3000, total_episodes=copies)
    start = time.process_time()
    assert len(Demonstrations.load(root).actions) == 3000
    assert 3000 / (time.process_time() - start) > 1500


@pytest.mark.parametrize(("declared", "symmetric"), [({}, False), ({"symmetric": True}, True)])
def test_a_world_is_symmetric_where_the_dataset_declares_it(root, declared, symmetric):
    path = root / "meta/dpmacro.json"
    path.write_text(json.dumps({"world": WORLD, **declared}))
    loaded = Demonstrations.load(root)
    assert loaded.symmetric is symmetric and loaded.select([1]).symmetric is symmetric


@pytest.mark.parametrize("value", [1, "true", None])
def test_a_symmetry_that_is_neither_true_nor_false_is_refused(root, value):
    edit_json(root / "meta/dpmacro.json", symmetric=value)
    with pytest.raises(
        DatasetError, match=rf"dpmacro\.json: symmetric is {json.dumps(value)}; write true or false"
    ):
        Demonstrations.load(root)


def test_joined_demonstrations_follow_one_another(recorded):
    first, second = (Demonstrations.load(recorded, episodes) for episodes in ([0, 1], [2]))
    both = first.joined(second)
    assert np.array_equal(both.images, np.concatenate([first.images, second.images]))
    assert np.array_equal(both.actions, np.concatenate([first.actions, second.actions]))
    assert np.array_equal(both.truth, np.concatenate([first.truth, second.truth]))
    assert both.lengths.tolist() == list(LENGTHS[:3])
    assert (both.truth_name, both.truth_classes) == ("phase", ("before blue", "after blue"))


@pytest.mark.parametrize("truth", ["none", "discrete_action"])
def test_what_is_joined_with_another_truth_has_none(recorded, truth):
    phases, others = Demonstrations.load(recorded), Demonstrations.load(recorded, truth=truth)
    for both in (phases.joined(others), others.joined(phases)):
        assert (both.truth, both.truth_name, both.truth_classes) == (None, None, ())


def test_the_names_of_joined_labels_cover_all_of_them(recorded):
    first = Demonstrations.load(recorded, [0])
    more = replace(first, truth=first.truth + 1, truth_classes=("before blue", "after blue", "2"))
    assert first.joined(more).truth_classes == more.joined(first).truth_classes == more.truth_classes


def test_only_like_is_joined_with_like(recorded):
    first = Demonstrations.load(recorded)
    with pytest.raises(ValueError, match=r"has the actions .*forward.* and .*: join like with like"):
        first.joined(replace(first, action_names=("a", "b", "c")))
    with pytest.raises(ValueError, match=r"has images of \(48, 64\) and .* \(24, 64\): join like with like"):
        first.joined(replace(first, observations={AVATAR: first.images[:, ::2]}))
    with pytest.raises(
        ValueError, match=r"has observation.images.avatar and .* observation.image: join like"
    ):
        first.joined(replace(first, observations={"observation.image": first.images}))
