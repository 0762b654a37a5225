"""Datasets of runs: LeRobot's own tools read them, and they are whole or not there at all."""

import json
import os
import pkgutil
import signal
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from noise import ACTIONS, AVATAR, LENGTHS, WORLD, as_run, random_episodes, told, write

from dpmacro.data.demonstrations import DatasetError, Demonstrations
from dpmacro.data.lerobot.reader import StoredDataset
from dpmacro.evaluation.run_writer import VIEW, writing_runs


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
    episode = next(random_episodes((6,), shape=(24, 32, 3)))
    root = write(tmp_path / "viewed", [episode | {"views": np.full((6, 240, 320, 3), 90, np.uint8)}])
    view = open_with_lerobot(root)[3][VIEW]
    assert view.shape == (3, 240, 320) and abs(float(view.mean()) - 90 / 255) < 0.03


def test_columns_of_truth_and_tasks_are_as_told(tmp_path):
    classes = {"subgoal": ("a", "b"), "purpose": ("c", "d", "e")}
    episodes = list(random_episodes((4, 3)))
    for index, episode in enumerate(episodes):
        n = len(episode["actions"])
        episode["truth"] = {"subgoal": np.arange(n) % 2, "purpose": np.full(n, 2 - index)}
        episode["task"] = f"task {index}"
    root = write(tmp_path / "d", episodes, {}, fps=10, truth=classes)
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


def test_runs_that_failed_are_told_apart(tmp_path):
    episodes = [episode | {"success": index == 1} for index, episode in enumerate(random_episodes((4, 3)))]
    store = StoredDataset.open(write(tmp_path / "d", episodes))
    columns = store.columns(["next.done", "next.success"], store.episodes)
    assert np.flatnonzero(columns["next.done"]).tolist() == [3, 6]
    assert np.flatnonzero(columns["next.success"]).tolist() == [6]


@pytest.mark.parametrize(("error", "view"), [(KeyboardInterrupt, False), (RuntimeError, True)])
def test_an_interrupted_recording_leaves_nothing(tmp_path, monkeypatch, error, view):
    views = np.zeros((12, 240, 320, 3), np.uint8) if view else None
    closed = []
    with pytest.raises(error), writing_runs(tmp_path / "d", WORLD, told()) as writer:
        writer.add(as_run(**next(random_episodes()), views=views))
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
    handler = signal.getsignal(signal.SIGINT)
    with pytest.raises(KeyboardInterrupt):
        write(tmp_path / "d", random_episodes())
    assert len(calls) >= call and list(tmp_path.iterdir()) == []
    assert signal.getsignal(signal.SIGINT) is handler


@pytest.mark.parametrize("place", ["shutil.rmtree", "pathlib.Path.rename", "pathlib.Path.write_text"])
def test_an_interrupt_at_the_end_leaves_nothing_or_the_whole(tmp_path, monkeypatch, place):
    function = pkgutil.resolve_name(place)

    def interrupted(*args, **options):
        monkeypatch.undo()
        os.kill(os.getpid(), signal.SIGINT)
        return function(*args, **options)

    root = tmp_path / "d"
    with pytest.raises(KeyboardInterrupt), writing_runs(root, WORLD, told()) as writer:
        writer.add(as_run(**next(random_episodes())))
        monkeypatch.setattr(place, interrupted)
    assert list(tmp_path.iterdir()) in ([], [root])
    if root.exists():
        assert Demonstrations.load(root).lengths.tolist() == [LENGTHS[0]]


def test_runs_may_be_added_in_any_thread(tmp_path):
    root = tmp_path / "d"
    with writing_runs(root, WORLD, told()) as writer, ThreadPoolExecutor(1) as pool:
        pool.submit(writer.add, as_run(**next(random_episodes()))).result()
    assert len(Demonstrations.load(root).actions) == LENGTHS[0]


def test_a_recording_without_runs_leaves_nothing(tmp_path):
    with pytest.raises(ValueError, match="no run was added, so there is nothing to write"):
        write(tmp_path / "d", [])
    assert list(tmp_path.iterdir()) == []


def test_what_exists_is_never_overwritten(tmp_path):
    root = tmp_path / "mine"
    root.mkdir()
    with pytest.raises(DatasetError, match="mine: exists already; remove it"):
        write(root, random_episodes())
    root.rmdir()
    with (
        pytest.raises(DatasetError, match="exists already"),
        writing_runs(root, WORLD, told()) as writer,
    ):
        writer.add(as_run(**next(random_episodes())))
        root.mkdir()
        (root / "kept").touch()
    assert [path.relative_to(tmp_path).as_posix() for path in tmp_path.rglob("*")] == ["mine", "mine/kept"]


def shortened(episode):
    """The episode's first frame."""
    first = {name: episode[name][:1] for name in ("images", "actions", "rewards")}
    return first | {"truth": {"phase": np.zeros(1, np.int64)}}


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"actions": np.full(12, 3)}, r"actions from 3 to 3; there are 3, forward"),
        ({"actions": np.full(12, -1)}, r"actions from -1 to -1"),
        ({"truth": {"phase": np.full(12, 2)}}, r"phase from 2 to 2; there are 2, before blue, after blue"),
        (shortened(next(random_episodes())), r"a run of 1 frame"),
        (
            {"images": np.zeros((12, 24, 32, 3), np.uint8)},
            r"avatar has shape \(24, 32, 3\), and had",
        ),
        ({"views": np.zeros((12, 24, 32, 3), np.uint8)}, r"view has shape \(24, 32, 3\), and had None"),
        ({"actions": np.zeros((12, 3), np.float32)}, r"discrete_action has shape None, and had \(1,\)"),
    ],
)
def test_what_is_no_run_or_unlike_the_first_is_refused(tmp_path, changes, message):
    episode = next(random_episodes())
    with pytest.raises(ValueError, match=message) as raised:
        write(tmp_path / "d", [episode, episode | changes])
    assert list(tmp_path.iterdir()) == [] and "\n" not in str(raised.value)


def test_views_must_not_be_missing_later(tmp_path):
    episode = next(random_episodes((12,)))
    views = np.zeros((12, 64, 96, 3), np.uint8)
    with pytest.raises(ValueError, match=r"view has shape None, and had \(64, 96, 3\) in the first run"):
        write(tmp_path / "d", [episode | {"views": views}, episode])
    assert list(tmp_path.iterdir()) == []


def test_one_action_is_refused(tmp_path):
    episode = next(random_episodes()) | {"actions": np.zeros(12, np.int64)}
    with pytest.raises(ValueError, match="the only action is 'go': LeRobot's tools need two"):
        write(tmp_path / "d", [episode], actions=("go",))


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
