import json
import os
import pkgutil
import shutil
import signal
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest
from noise import ACTIONS, LENGTHS, PHASES, WORLD, random_episodes

from dpmacro.data.demonstrations import DatasetError, Demonstrations
from dpmacro.data.lerobot.writer import AVATAR, VIEW, DemonstrationWriter


def open_with_lerobot(root):
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    return LeRobotDataset(f"local/{root.name}", root=root, video_backend="pyav")


def test_lerobot_opens_and_indexes_what_was_written(recorded):
    dataset = open_with_lerobot(recorded)
    assert (dataset.num_episodes, dataset.num_frames, dataset.fps) == (len(LENGTHS), sum(LENGTHS), 30)
    assert dataset.meta.features["action"]["names"] == list(ACTIONS)
    first = next(random_episodes())
    last = LENGTHS[0] - 1
    item = dataset[last]
    assert np.array_equal(np.rint(item[AVATAR].numpy() * 255).transpose(1, 2, 0), first["images"][last])
    assert item["action"].argmax() == item["discrete_action"] == first["actions"][last]
    assert item["phase"] == first["truth"]["phase"][last]
    assert item["next.reward"] == first["rewards"][last]
    assert item["next.done"] and item["next.success"]
    assert not dataset[last - 1]["next.done"] and not dataset[last - 1]["next.success"]


def test_lerobot_reads_the_view(tmp_path):
    root = tmp_path / "viewed"
    episode = next(random_episodes((6,), shape=(24, 32, 3)))
    views = np.full((6, 240, 320, 3), 90, np.uint8)
    with DemonstrationWriter.create(root, ACTIONS, 30, WORLD, view=True, classes=PHASES) as writer:
        writer.add_episode(**episode, views=views)
    view = open_with_lerobot(root)[3][VIEW]
    assert view.shape == (3, 240, 320) and abs(float(view.mean()) - 90 / 255) < 0.03


def test_columns_of_truth_and_tasks_are_as_told(tmp_path):
    root = tmp_path / "d"
    classes = {"subgoal": ("a", "b"), "purpose": ("c", "d", "e")}
    with DemonstrationWriter.create(root, ACTIONS, 10, {}, view=False, classes=classes) as writer:
        for index, episode in enumerate(random_episodes((4, 3))):
            n = len(episode["actions"])
            truth = {"subgoal": np.arange(n) % 2, "purpose": np.full(n, 2 - index)}
            writer.add_episode(**episode | {"truth": truth, "task": f"task {index}"})
    stored = open_with_lerobot(root)
    assert [stored[t]["task"] for t in (0, 3, 4, 6)] == ["task 0", "task 0", "task 1", "task 1"]
    assert [int(stored[t]["subgoal"]) for t in range(7)] == [0, 1, 0, 1, 0, 1, 0]
    assert [int(stored[t]["purpose"]) for t in range(7)] == [2, 2, 2, 2, 1, 1, 1]
    assert "phase" not in stored.meta.features
    loaded = Demonstrations.load(root)
    assert (loaded.truth_name, loaded.truth_classes) == ("subgoal", ("a", "b"))
    assert Demonstrations.load(root, truth="purpose").truth_classes == ("c", "d", "e")


def test_nothing_but_the_dataset_is_left(recorded):
    assert [path.name for path in recorded.parent.iterdir()] == [recorded.name]
    assert sorted(path.name for path in recorded.iterdir()) == ["data", "meta"]
    assert json.loads((recorded / "meta/dpmacro.json").read_text()) == {
        "world": WORLD,
        "symmetric": False,
        "truth": {"phase": ["before blue", "after blue"]},
    }


@pytest.mark.parametrize(("error", "view"), [(KeyboardInterrupt, False), (RuntimeError, True)])
def test_an_interrupted_recording_leaves_nothing(tmp_path, monkeypatch, error, view):
    writer = DemonstrationWriter.create(tmp_path / "d", ACTIONS, 30, WORLD, view, classes=PHASES)
    views = {"views": np.zeros((12, 240, 320, 3), np.uint8)} if view else {}
    closed = []
    with pytest.raises(error), writer:
        writer.add_episode(**next(random_episodes()), **views)
        assert [path.name for path in tmp_path.iterdir()] != ["d"]
        # Open parquet files abort the interpreter at its end, and encoder threads wait for more.
        finalize = writer._dataset.finalize
        monkeypatch.setattr(writer._dataset, "finalize", lambda: closed.append(finalize()))
        raise error
    assert closed == [None]
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("call", [19, 20, 21, 22, 24, 44, 46])
def test_an_interrupt_is_never_swallowed(tmp_path, monkeypatch, call):
    """`datasets` hashes what it does, and takes any exception there for something that has no hash."""
    from datasets.fingerprint import Hasher

    calls = []
    update = Hasher.update

    def interrupted(hasher, value):
        calls.append(value)
        if len(calls) == call:
            os.kill(os.getpid(), signal.SIGINT)
        update(hasher, value)

    monkeypatch.setattr(Hasher, "update", interrupted)
    writer = DemonstrationWriter.create(tmp_path / "d", ACTIONS, 30, WORLD, view=False, classes=PHASES)
    handler = signal.getsignal(signal.SIGINT)
    with pytest.raises(KeyboardInterrupt), writer:
        for episode in random_episodes():
            writer.add_episode(**episode)
    assert len(calls) >= call and list(tmp_path.iterdir()) == []
    assert signal.getsignal(signal.SIGINT) is handler


def test_episodes_may_be_added_in_any_thread(tmp_path):
    root = tmp_path / "d"
    writer = DemonstrationWriter.create(root, ACTIONS, 30, WORLD, view=False, classes=PHASES)
    with writer, ThreadPoolExecutor(1) as pool:
        pool.submit(writer.add_episode, **next(random_episodes())).result()
    assert len(Demonstrations.load(root).actions) == LENGTHS[0]


def test_a_recording_without_episodes_leaves_nothing(tmp_path):
    writer = DemonstrationWriter.create(tmp_path / "d", ACTIONS, 30, WORLD, False, classes=PHASES)
    with pytest.raises(ValueError, match="no episode was added"), writer:
        pass
    assert list(tmp_path.iterdir()) == []


def test_what_exists_is_never_overwritten(tmp_path):
    root = tmp_path / "mine"
    root.mkdir()
    with pytest.raises(DatasetError, match="mine: exists already; remove it"):
        DemonstrationWriter.create(root, ACTIONS, 30, WORLD, False, classes=PHASES)
    root.rmdir()
    writer = DemonstrationWriter.create(root, ACTIONS, 30, WORLD, False, classes=PHASES)
    with pytest.raises(DatasetError, match="exists already"), writer:
        writer.add_episode(**next(random_episodes()))
        root.mkdir()
        (root / "kept").touch()
    assert [path.relative_to(tmp_path).as_posix() for path in tmp_path.rglob("*")] == ["mine", "mine/kept"]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"actions": np.full(12, 3)}, r"actions from 3 to 3; there are 3, forward"),
        ({"actions": np.full(12, -1)}, r"actions from -1 to -1"),
        ({"truth": {"phase": np.full(12, 2)}}, r"phase from 2 to 2; there are 2, before blue, after blue"),
        ({"views": np.zeros((12, 240, 320, 3), np.uint8)}, r"views given: True"),
        (
            {name: next(random_episodes())[name][:1] for name in ("images", "actions", "rewards")}
            | {"truth": {"phase": np.zeros(1, np.int64)}},
            r"1 frame",
        ),
    ],
)
def test_what_is_no_episode_is_refused(tmp_path, changes, message):
    writer = DemonstrationWriter.create(tmp_path / "d", ACTIONS, 30, WORLD, False, classes=PHASES)
    with pytest.raises(ValueError, match=message), writer:
        writer.add_episode(**(next(random_episodes()) | changes))
    assert list(tmp_path.iterdir()) == []


def test_one_action_is_refused(tmp_path):
    with pytest.raises(ValueError, match="at least two actions"):
        DemonstrationWriter.create(tmp_path / "d", ("go",), 30, WORLD, False, classes=PHASES)


def contents(folder):
    return {path.relative_to(folder): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def caches():
    return contents(Path(os.environ["HF_HOME"]))


@pytest.fixture
def old(recorded, tmp_path):
    """A dataset to extend, alone in its folder."""
    return Path(shutil.copytree(recorded, tmp_path / "alone/d"))


@pytest.mark.parametrize("view", [False, True])
def test_extended_twice_is_as_recorded_in_one_go(tmp_path, view):
    episodes = [
        episode
        | {"task": f"task {min(index, 2)}"}
        | ({"views": np.full((len(episode["actions"]), 64, 96, 3), 60 * index, np.uint8)} if view else {})
        for index, episode in enumerate(random_episodes())
    ]
    at_once, root = tmp_path / "at_once", tmp_path / "extended/d"
    with DemonstrationWriter.create(at_once, ACTIONS, 30, WORLD, view, classes=PHASES) as writer:
        for episode in episodes:
            writer.add_episode(**episode)
    with DemonstrationWriter.create(root, ACTIONS, 30, WORLD, view, classes=PHASES) as writer:
        writer.add_episode(**episodes[0])
    before = caches()
    for more in (episodes[1:2], episodes[2:]):
        with DemonstrationWriter.extend(root) as writer:
            for episode in more:
                writer.add_episode(**episode)
    assert caches() == before
    assert list(root.parent.iterdir()) == [root]
    assert {path.name for path in root.iterdir()} == {path.name for path in at_once.iterdir()}
    assert (root / "meta/dpmacro.json").read_text() == (at_once / "meta/dpmacro.json").read_text()

    ours, theirs = Demonstrations.load(root, camera=AVATAR), Demonstrations.load(at_once, camera=AVATAR)
    for field in fields(Demonstrations):
        if field.name == "observations":
            assert ours.observations.keys() == theirs.observations.keys()
            assert all(
                np.array_equal(ours.observations[name], theirs.observations[name])
                for name in ours.observations
            )
        elif field.name != "root":
            assert np.array_equal(getattr(ours, field.name), getattr(theirs, field.name)), field.name
    stored, expected = open_with_lerobot(root), open_with_lerobot(at_once)
    assert stored.num_episodes == len(LENGTHS) and len(stored) == sum(LENGTHS)
    assert stored.meta.tasks["task_index"].to_dict() == {"task 0": 0, "task 1": 1, "task 2": 2}
    assert stored.meta.total_tasks == 3
    for index in range(sum(LENGTHS)):
        item = expected[index]
        assert stored[index].keys() == item.keys()
        for name, value in stored[index].items():
            if name == VIEW:  # a video's pictures depend a little on those before
                assert float((value - item[name]).abs().max()) < 0.05
            else:
                assert np.array_equal(value, item[name]), (index, name)
    for name, statistics in stored.meta.stats.items():
        assert statistics.keys() == expected.meta.stats[name].keys()
        for what, value in statistics.items():
            error = 0.05 if name == VIEW else 1e-6
            assert np.allclose(value, expected.meta.stats[name][what], error, error), (name, what)


@pytest.mark.parametrize("error", [KeyboardInterrupt, RuntimeError])
def test_an_interrupted_extension_leaves_the_old(old, error):
    before = contents(old)
    with pytest.raises(error), DemonstrationWriter.extend(old) as writer:
        writer.add_episode(**next(random_episodes()))
        raise error
    assert contents(old.parent) == {Path("d") / name: content for name, content in before.items()}


@pytest.mark.parametrize(
    ("place", "call"),
    [
        ("shutil.copyfile", 3),
        ("shutil.rmtree", 1),
        ("os.fsync", 2),
        ("pathlib.Path.rename", 1),
        ("json.dump", 1),
    ],
)
def test_an_interrupt_anywhere_leaves_the_old_or_the_new(old, monkeypatch, place, call):
    before, calls = contents(old), []
    function = pkgutil.resolve_name(place)

    def interrupted(*args, **options):
        calls.append(args)
        if len(calls) == call:
            os.kill(os.getpid(), signal.SIGINT)
        return function(*args, **options)

    monkeypatch.setattr(place, interrupted)
    with pytest.raises(KeyboardInterrupt), DemonstrationWriter.extend(old) as writer:
        writer.add_episode(**next(random_episodes()))
    assert list(old.parent.iterdir()) == [old]
    if place == "pathlib.Path.rename":
        assert Demonstrations.load(old).lengths.tolist() == [*LENGTHS, LENGTHS[0]]
    else:
        assert contents(old) == before


def test_an_extension_without_episodes_leaves_the_old(old):
    before = contents(old)
    with pytest.raises(ValueError, match="no episode was added"), DemonstrationWriter.extend(old):
        pass
    assert contents(old) == before and list(old.parent.iterdir()) == [old]


@pytest.mark.parametrize("others_come", ["first", "last"])
def test_what_others_added_meanwhile_is_not_lost(old, others_come):
    ours, theirs = random_episodes((4, 5))
    with pytest.raises(DatasetError, match="changed while"), DemonstrationWriter.extend(old) as writer:
        if others_come == "last":
            writer.add_episode(**ours)
        with DemonstrationWriter.extend(old) as other:
            other.add_episode(**theirs)
        writer.add_episode(**ours)
    assert Demonstrations.load(old).lengths.tolist() == [*LENGTHS, 5]
    assert list(old.parent.iterdir()) == [old]


def test_a_link_goes_on_pointing_at_the_dataset(old, tmp_path):
    link = tmp_path / "link"
    link.symlink_to(old)
    with DemonstrationWriter.extend(link) as writer:
        writer.add_episode(**next(random_episodes()))
    assert link.is_symlink() and len(Demonstrations.load(old).lengths) == len(LENGTHS) + 1


def test_an_extension_knows_what_the_dataset_is(tmp_path):
    root = tmp_path / "d"
    classes = {"subgoal": ("a", "b"), "purpose": ("c", "d", "e")}
    episode = next(random_episodes((4,), shape=(24, 32, 3)))
    episode["truth"] = {"subgoal": np.arange(4) % 2, "purpose": np.full(4, 2)}
    about = WORLD, False, classes, True
    with DemonstrationWriter.create(root, ACTIONS, 10, *about) as writer:
        writer.add_episode(**episode)
    with DemonstrationWriter.extend(root) as writer:
        assert (writer.action_names, writer.fps) == (ACTIONS, 10)
        assert (writer.world, writer.view, writer.classes, writer.symmetric) == about
        writer.add_episode(**episode)
        for changes, message in (
            ({"images": np.zeros((4, 48, 64, 3), np.uint8)}, "avatar of 48x64: dataset .*d has 24x32, give"),
            ({"views": np.zeros((4, 48, 64, 3), np.uint8)}, "views given: True"),
            ({"actions": np.full(4, 3)}, "actions from 3 to 3"),
            ({"truth": episode["truth"] | {"purpose": np.full(4, 3)}}, "purpose from 3 to 3"),
        ):
            with pytest.raises(ValueError, match=message) as raised:
                writer.add_episode(**episode | changes)
            assert "\n" not in str(raised.value)
    extended = Demonstrations.load(root, truth="purpose")
    assert extended.lengths.tolist() == [4, 4] and extended.symmetric


def forget(root, name):
    (root / name).unlink()


def add_column(root):
    info = json.loads((root / "meta/info.json").read_text())
    info["features"]["macro_action"] = info["features"]["phase"]
    (root / "meta/info.json").write_text(json.dumps(info))


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (shutil.rmtree, "no such folder; record one with datasets/record.py"),
        (lambda root: shutil.rmtree(root / "meta"), "is this a LeRobot dataset"),
        (
            lambda root: forget(root, "meta/dpmacro.json"),
            "has no meta/dpmacro.json, so dpmacro did not record",
        ),
        (add_column, "lacks or adds macro_action"),
        (lambda root: forget(root, "meta/tasks.parquet"), "meta/tasks.parquet is missing"),
        (lambda root: forget(root, "meta/stats.json"), "meta/stats.json is missing"),
        (lambda root: forget(root, "data/chunk-000/file-000.parquet"), "is missing; the dataset is half-"),
    ],
)
def test_what_was_not_recorded_cannot_be_extended(old, damage, message):
    damage(old)
    with pytest.raises(DatasetError, match=message) as raised:
        DemonstrationWriter.extend(old)
    assert "\n" not in str(raised.value)
    assert [path for path in old.parent.iterdir() if path != old] == []


EDITS = """
import sys
from lerobot.scripts.lerobot_edit_dataset import main
operations = {
    "info": ["--repo_id=local/demo"],
    "split": ["--repo_id=local/demo", "--operation.splits={'train': [0, 3], 'val': [1, 2]}"],
    # 0.4.4 names the result by repo_id, 0.6.1 by new_repo_id.
    "merge": [
        "--repo_id=local/merged",
        "--new_repo_id=local/merged",
        "--operation.repo_ids=['local/demo_val', 'local/demo_train']",
    ],
    "delete_episodes": [
        "--repo_id=local/demo",
        "--new_repo_id=local/deleted",
        "--operation.episode_indices=[1]",
    ],
}
for operation, options in operations.items():
    sys.argv = ["lerobot-edit-dataset", f"--operation.type={operation}", *options]
    main()
"""


def test_lerobots_editing_tools_work_on_it(recorded, tmp_path):
    """Under $HF_LEROBOT_HOME and without --root, where both supported versions agree what goes where."""
    home = tmp_path / "home"
    (home / "local").mkdir(parents=True)
    (home / "local/demo").symlink_to(recorded)
    done = subprocess.run(
        [sys.executable, "-c", EDITS],
        env=os.environ | {"HF_LEROBOT_HOME": str(home)},
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    assert "local/demo" in done.stdout + done.stderr
    episodes = [episode["images"] for episode in random_episodes()]
    for name, order in {
        "demo_train": (0, 3),
        "demo_val": (1, 2),
        "merged": (1, 2, 0, 3),
        "deleted": (0, 2, 3),
    }.items():
        loaded = Demonstrations.load(home / "local" / name)
        assert np.array_equal(loaded.images, np.concatenate([episodes[index] for index in order])), name
        assert loaded.action_names == ACTIONS
        reverse = list(range(len(order)))[::-1]
        assert loaded.select(reverse).lengths.tolist() == [LENGTHS[order[index]] for index in reverse]
        part = Demonstrations.load(home / "local" / name, episodes=[1])
        assert np.array_equal(part.images, episodes[order[1]])
