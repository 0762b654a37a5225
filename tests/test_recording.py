import json
import os
import signal
import subprocess
import sys
import warnings
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext

import numpy as np
import pyarrow.parquet as pq
import pytest
from noise import ACTIONS, LENGTHS, WORLD, random_episodes

from dpmacro.demonstrations import DatasetError, Demonstrations
from dpmacro.recording import AVATAR, VIEW, DemonstrationWriter, _embed_images


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
    with DemonstrationWriter.create(root, ACTIONS, 30, WORLD, view=True) as writer:
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
            writer.add_episode(**episode | {"truth": truth}, task=f"task {index}")
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
        "truth": {"phase": ["before blue", "after blue"]},
    }


@pytest.mark.parametrize(("error", "view"), [(KeyboardInterrupt, False), (RuntimeError, True)])
def test_an_interrupted_recording_leaves_nothing(tmp_path, monkeypatch, error, view):
    writer = DemonstrationWriter.create(tmp_path / "d", ACTIONS, 30, WORLD, view)
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
    writer = DemonstrationWriter.create(tmp_path / "d", ACTIONS, 30, WORLD, view=False)
    handler = signal.getsignal(signal.SIGINT)
    with pytest.raises(KeyboardInterrupt), writer:
        for episode in random_episodes():
            writer.add_episode(**episode)
    assert len(calls) >= call and list(tmp_path.iterdir()) == []
    assert signal.getsignal(signal.SIGINT) is handler


def test_episodes_may_be_added_in_any_thread(tmp_path):
    root = tmp_path / "d"
    writer = DemonstrationWriter.create(root, ACTIONS, 30, WORLD, view=False)
    with writer, ThreadPoolExecutor(1) as pool:
        pool.submit(writer.add_episode, **next(random_episodes())).result()
    assert len(Demonstrations.load(root).actions) == LENGTHS[0]


def test_a_recording_without_episodes_leaves_nothing(tmp_path):
    writer = DemonstrationWriter.create(tmp_path / "d", ACTIONS, 30, WORLD, False)
    with pytest.raises(ValueError, match="no episode was added"), writer:
        pass
    assert list(tmp_path.iterdir()) == []


def test_what_exists_is_never_overwritten(tmp_path):
    root = tmp_path / "mine"
    root.mkdir()
    with pytest.raises(DatasetError, match="mine: exists already; remove it"):
        DemonstrationWriter.create(root, ACTIONS, 30, WORLD, False)
    root.rmdir()
    writer = DemonstrationWriter.create(root, ACTIONS, 30, WORLD, False)
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
    writer = DemonstrationWriter.create(tmp_path / "d", ACTIONS, 30, WORLD, False)
    with pytest.raises(ValueError, match=message), writer:
        writer.add_episode(**(next(random_episodes()) | changes))
    assert list(tmp_path.iterdir()) == []


def test_one_action_is_refused(tmp_path):
    with pytest.raises(ValueError, match="at least two actions"):
        DemonstrationWriter.create(tmp_path / "d", ("go",), 30, WORLD, False)


def test_writing_is_silent_and_leaves_no_state(tmp_path, capfd, monkeypatch):
    import datasets

    monkeypatch.delenv("SVT_LOG", raising=False)
    assert not datasets.are_progress_bars_disabled()
    views = np.zeros((12, 240, 320, 3), np.uint8)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("default", RuntimeWarning)
        with DemonstrationWriter.create(tmp_path / "d", ACTIONS, 30, WORLD, True) as writer:
            writer.add_episode(**next(random_episodes()), views=views)
    assert [str(warning.message) for warning in caught if warning.category is RuntimeWarning] == []
    assert capfd.readouterr() == ("", "")
    assert not datasets.are_progress_bars_disabled() and "SVT_LOG" not in os.environ


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


def test_embedding_at_once_writes_what_lerobot_writes(recorded, tmp_path, monkeypatch):
    monkeypatch.setattr("dpmacro.recording._embedding_at_once", nullcontext)
    root = tmp_path / "one_by_one"
    with DemonstrationWriter.create(root, ACTIONS, 30, WORLD, view=False) as writer:
        for episode in random_episodes():
            writer.add_episode(**episode)
    ours, theirs = (pq.ParquetFile(folder / "data/chunk-000/file-000.parquet") for folder in (recorded, root))
    assert ours.read().equals(theirs.read())
    assert ours.schema_arrow.equals(theirs.schema_arrow)
    assert ours.metadata.num_row_groups == theirs.metadata.num_row_groups


@pytest.mark.parametrize("view", [False, True])
def test_lerobot_embeds_by_the_function_that_is_replaced(recorded, tmp_path, monkeypatch, view):
    """Where a new LeRobot has it elsewhere, recording is slower, and this says so."""
    calls = []

    def noted(dataset):
        calls.append(len(dataset))
        return _embed_images(dataset)

    monkeypatch.setattr("dpmacro.recording._embed_images", noted)
    episodes = list(random_episodes((4, 3)))
    with DemonstrationWriter.create(tmp_path / "d", ACTIONS, 30, WORLD, view=view) as writer:
        for episode in episodes:
            views = np.zeros((len(episode["actions"]), 64, 96, 3), np.uint8) if view else None
            writer.add_episode(**episode, views=views)
    assert calls == [4, 3]
