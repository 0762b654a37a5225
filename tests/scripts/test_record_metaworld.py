"""Recording the experts' runs, as a user does: a process, a folder, a line."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from dpmacro.data.lerobot.reader import StoredDataset
from dpmacro.worlds.metaworld import STATE, TASKS, run_expert

ROOT = Path(__file__).resolve().parents[2]
SCRIPT = ROOT / "datasets/record_metaworld.py"
TASK = "coffee-push-v3"


def start(*options, **environment):
    return subprocess.Popen(
        [sys.executable, SCRIPT, *options],
        env=os.environ | environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    """Three episodes of a task, and what the script said of them."""
    pytest.importorskip("metaworld")
    root = tmp_path_factory.mktemp("metaworld") / "push"
    run = start(f"--root={root}", f"--task={TASK}", "--episodes=3", "--noise=0.2", "--seed=4")
    out, error = run.communicate(timeout=200)
    assert run.returncode == 0, error
    return root, out, error


@pytest.fixture(scope="module")
def runs():
    return [run_expert(TASK, seed, 0.2) for seed in (4, 5, 6)]


def test_what_is_recorded_is_what_the_expert_did(dataset, runs):
    root, out, error = dataset
    store = StoredDataset.open(root)
    columns = store.columns([STATE, "action", "stage", "next.reward", "next.success"], store.episodes)
    for name, attribute in ((STATE, "states"), ("action", "actions"), ("stage", "stages")):
        expected = np.concatenate([getattr(run, attribute) for run in runs])
        assert np.array_equal(columns[name], expected) and columns[name].dtype == expected.dtype, name
    assert np.array_equal(columns["next.reward"], np.concatenate([run.rewards for run in runs]))
    assert [row.length for row in store.episodes] == [len(run.actions) for run in runs]
    assert columns["next.success"].sum() == 3
    assert (
        out.startswith(f"kept 3 of 3 runs, 0 failed, {len(columns['stage'])} frames") and "episode" in error
    )
    assert out.count("\n") == 1
    assert [path.name for path in root.parent.iterdir()] == [root.name]


def test_the_stage_is_declared_as_the_truth_with_its_names(dataset):
    store = StoredDataset.open(dataset[0])
    assert store.truth == {"stage": list(TASKS[TASK])}
    assert store.world == {"id": f"Meta-World/{TASK}", "noise": 0.2} and not store.symmetric
    assert json.loads((dataset[0] / "meta/info.json").read_text())["fps"] == 80


def test_lerobot_reads_it(dataset, runs):
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    stored = LeRobotDataset("local/push", root=dataset[0])
    assert (stored.num_episodes, stored.num_frames) == (3, sum(len(run.actions) for run in runs))
    item = stored[1]
    assert item["task"] == TASK and item["stage"] == runs[0].stages[1]
    assert np.array_equal(item["action"].numpy(), runs[0].actions[1])
    assert item[STATE].shape == (39,)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--episodes=0"], "episodes is 0: give 1 or more"),
        (["--seed=-1"], "seed is -1: give 0 or more"),
        (["--noise=-0.5"], "noise is -0.5: give 0 or more"),
        (["--noise=.nan"], "noise is nan: give 0 or more"),
        (["--task=fly-v3"], "task is 'fly-v3': choose from pick-place-v3"),
    ],
)
def test_mistakes_are_refused_in_one_line_and_leave_nothing(tmp_path, options, message):
    run = start(f"--root={tmp_path / 'd'}", *options)
    _, error = run.communicate(timeout=100)
    assert run.returncode == 2 and error.count("\n") == 1 and message in error
    assert list(tmp_path.iterdir()) == []


def test_without_metaworld_there_is_one_clear_line(tmp_path):
    (tmp_path / "no").mkdir()
    (tmp_path / "no/metaworld.py").write_text("raise ModuleNotFoundError('no', name='metaworld')")
    run = start(f"--root={tmp_path / 'd'}", PYTHONPATH=os.pathsep.join([str(tmp_path / "no"), str(ROOT)]))
    _, error = run.communicate(timeout=100)
    needed = "error: Meta-World needs the packages metaworld and mujoco: pip install -e '.[metaworld]'\n"
    assert run.returncode == 2 and error == needed
    assert not (tmp_path / "d").exists()


def test_what_exists_is_refused(tmp_path):
    pytest.importorskip("metaworld")
    (tmp_path / "kept").touch()
    run = start(f"--root={tmp_path}")
    _, error = run.communicate(timeout=100)
    assert run.returncode == 2 and error.count("\n") == 1 and "exists already" in error
    assert [path.name for path in tmp_path.iterdir()] == ["kept"]


def test_hopeless_noise_is_given_up(tmp_path):
    pytest.importorskip("metaworld")
    run = start(f"--root={tmp_path / 'd'}", "--episodes=1", "--noise=50")
    _, error = run.communicate(timeout=100)
    assert run.returncode == 2 and "Traceback" not in error
    assert "error: only 0 of 10 runs succeeded, 1 are wanted" in error.splitlines()[-1]
    assert list(tmp_path.iterdir()) == []


def test_an_interrupt_leaves_nothing_behind(tmp_path):
    pytest.importorskip("metaworld")
    run = start(f"--root={tmp_path / 'd'}", "--episodes=1000")
    while not list(tmp_path.glob(".d.*.partial/dataset/data/*/*.parquet")):
        assert run.poll() is None, run.communicate()
        time.sleep(0.1)
    os.kill(run.pid, signal.SIGINT)
    _, error = run.communicate(timeout=60)
    assert run.returncode == 130 and "Traceback" not in error
    assert list(tmp_path.iterdir()) == []
