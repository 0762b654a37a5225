"""Recording the bot's runs, as a user does: a process, a folder, a line."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from dpmacro.data.demonstrations import Demonstrations
from dpmacro.data.lerobot.writer import AVATAR
from dpmacro.worlds.babyai import ACTIONS, SUBGOALS, run_bot

SCRIPT = Path(__file__).resolve().parents[2] / "datasets/record_babyai.py"
LEVEL = "BabyAI-SynthS5R2-v0"
SEEDS = range(18, 23)  # the bot fails at seed 18 and needs one frame at 20; found by trying


def start(*options):
    return subprocess.Popen(
        [sys.executable, SCRIPT, *options], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    """Three episodes of a level, and what the script said of them."""
    root = tmp_path_factory.mktemp("babyai") / "synth"
    run = start(f"--root={root}", f"--level={LEVEL}", "--episodes=3", f"--seed={SEEDS[0]}")
    out, error = run.communicate(timeout=200)
    assert run.returncode == 0, error
    return root, out, error


@pytest.fixture(scope="module")
def runs():
    """The runs that are to be kept."""
    tried = [run_bot(LEVEL, seed) for seed in SEEDS]
    assert tried[0] is None and len(tried[2].actions) == 1
    return [tried[1], *tried[3:]]


@pytest.mark.parametrize("truth", ["subgoal", "purpose"])
def test_successful_runs_of_two_frames_or_more_are_recorded(dataset, runs, truth):
    root, out, error = dataset
    loaded = Demonstrations.load(root, truth=truth)
    assert np.array_equal(loaded.images, np.concatenate([run.images for run in runs]))
    assert np.array_equal(loaded.actions, np.concatenate([run.actions for run in runs]))
    assert np.array_equal(loaded.truth, np.concatenate([getattr(run, f"{truth}s") for run in runs]))
    assert loaded.lengths.tolist() == [len(run.actions) for run in runs]
    assert (loaded.action_names, loaded.truth_classes, loaded.truth_name) == (ACTIONS, SUBGOALS, truth)
    assert loaded.world == {"id": LEVEL}
    assert out.startswith(f"kept 3 of 5 runs, 1 failed, {len(loaded.actions)} frames")
    assert out.count("\n") == 1 and "episode" in error


def test_the_subgoal_is_the_truth_by_default(dataset):
    assert Demonstrations.load(dataset[0]).truth_name == "subgoal"


def test_lerobot_reads_it_with_the_missions_as_tasks(dataset, runs):
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    stored = LeRobotDataset("local/synth", root=dataset[0])
    assert (stored.num_episodes, stored.num_frames) == (3, sum(len(run.actions) for run in runs))
    n = 0
    for run in runs:
        item = stored[n]
        assert item["task"] == run.mission
        assert (item["subgoal"], item["purpose"]) == (run.subgoals[0], run.purposes[0])
        assert np.array_equal(np.rint(item[AVATAR].numpy() * 255).transpose(1, 2, 0), run.images[0])
        n += len(run.actions)
    assert stored[n - 1]["next.done"] and stored[n - 1]["next.reward"] > 0


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--episodes=0"], "episodes is 0: give 1 or more"),
        (["--seed=-1"], "seed is -1: give 0 or more"),
        (["--level=BabyAI-Fly-v0"], "level is 'BabyAI-Fly-v0': give the id of a BabyAI level"),
    ],
)
def test_mistakes_are_refused_in_one_line_and_leave_nothing(tmp_path, options, message):
    run = start(f"--root={tmp_path / 'd'}", *options)
    _, error = run.communicate(timeout=100)
    assert run.returncode == 2 and error.count("\n") == 1 and message in error
    assert list(tmp_path.iterdir()) == []


def test_a_hopeless_level_is_given_up(tmp_path):
    """The bot opens the box that holds the key, and knows no further."""
    run = start(f"--root={tmp_path / 'd'}", "--level=BabyAI-KeyInBox-v0", "--episodes=1")
    _, error = run.communicate(timeout=100)
    assert run.returncode == 2 and "Traceback" not in error
    assert "error: only 0 of 10 runs succeeded, 1 are wanted" in error.splitlines()[-1]
    assert list(tmp_path.iterdir()) == []


def test_what_exists_is_refused(tmp_path):
    (tmp_path / "kept").touch()
    run = start(f"--root={tmp_path}")
    _, error = run.communicate(timeout=100)
    assert run.returncode == 2 and error.count("\n") == 1 and "exists already" in error
    assert [path.name for path in tmp_path.iterdir()] == ["kept"]


def test_an_interrupt_leaves_nothing_behind(tmp_path):
    run = start(f"--root={tmp_path / 'd'}", "--episodes=1000")
    while not list(tmp_path.glob(".d.*.partial/dataset/data/*/*.parquet")):
        assert run.poll() is None, run.communicate()
        time.sleep(0.1)
    os.kill(run.pid, signal.SIGINT)
    _, error = run.communicate(timeout=60)
    assert run.returncode == 130 and "Traceback" not in error
    assert list(tmp_path.iterdir()) == []
