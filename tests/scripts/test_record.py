import importlib.util
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from dpmacro.data.demonstrations import Demonstrations
from dpmacro.worlds.two_flags.env import TwoFlagsConfig

SCRIPT = Path(__file__).resolve().parents[2] / "datasets/record.py"
SHORT_SEED = 29  # its run is short; found by trying
FAST = ("--world.render_size=[64,48]", "--world.max_steps=300")
FAST_WORLD = (("id", "TwoFlags-v0"), ("render_size", (64, 48)), ("max_steps", 300))


@pytest.fixture(scope="module")
def record():
    spec = importlib.util.spec_from_file_location("record", SCRIPT)
    module = importlib.util.module_from_spec(spec)
    sys.modules["record"] = module  # dataclasses look their module up
    spec.loader.exec_module(module)
    yield module
    del sys.modules["record"]


def start(*options):
    return subprocess.Popen(
        [sys.executable, SCRIPT, *options], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )


def fake_run(record, seed):
    """Two to six frames whose pictures and first action tell the seed; every third seed fails."""
    if seed % 3 == 2:
        return None
    length = 2 + seed % 5
    return record.Run(
        images=np.full((length, 48, 64, 3), seed, np.uint8),
        actions=np.full(length, seed % 3),
        truth={"phase": np.zeros(length, np.int64)},
        rewards=np.zeros(length, np.float32),
        views=None,
    )


@pytest.fixture
def faked(record, monkeypatch):
    def runs(world, view, seed, workers):
        while True:
            yield fake_run(record, seed)
            seed += 1

    monkeypatch.setattr(record, "teacher_runs", runs)
    return record


def test_the_first_successful_runs_are_kept_in_the_order_of_their_seeds(faked, tmp_path, capsys):
    root = tmp_path / "d"
    faked.main(faked.RecordConfig(root, episodes=5, seed=1, world=TwoFlagsConfig(flags="fixed")))
    loaded = Demonstrations.load(root)
    kept = [1, 3, 4, 6, 7]
    assert [int(loaded.images[frames][0, 0, 0, 0]) for frames in loaded.trajectories] == kept
    assert loaded.lengths.tolist() == [2 + seed % 5 for seed in kept]
    assert (loaded.world["id"], loaded.world["flags"], loaded.fps) == ("TwoFlags-v0", "fixed", 30)
    out = capsys.readouterr().out
    assert out.startswith(f"kept 5 of 7 runs, {len(loaded.actions)} frames") and out.count("\n") == 1


def test_a_hopeless_teacher_is_given_up(faked, tmp_path, monkeypatch):
    def none_succeeds(*_):
        while True:
            yield None

    monkeypatch.setattr(faked, "teacher_runs", none_succeeds)
    with pytest.raises(ValueError, match=r"only 0 of 20 runs succeeded, 2 are wanted; .*--world\.max_steps"):
        faked.main(faked.RecordConfig(tmp_path / "d", episodes=2))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"episodes": 0}, "episodes is 0: give 1 or more"),
        ({"seed": -1}, "seed is -1: give 0 or more"),
        ({"workers": 0}, "workers is 0: give 1 or more"),
    ],
)
def test_options_are_checked(record, options, message):
    with pytest.raises(ValueError, match=message):
        record.RecordConfig(Path("d"), **options)


def test_frames_hold_the_observation_before_their_action(record):
    """The recorded actions, done again in the same world, show the recorded pictures."""
    import gymnasium as gym

    seed, run = next(
        (seed, run)
        for seed in range(SHORT_SEED, 200)
        if (run := record.run_teacher(FAST_WORLD, False, seed)) is not None
    )
    env = gym.make("TwoFlags-v0", **dict(FAST_WORLD[1:]))
    observation, info = env.reset(seed=seed)
    phases = run.truth["phase"]
    for image, action, phase, reward in zip(run.images, run.actions, phases, run.rewards, strict=True):
        assert np.array_equal(image, observation["pixels"]) and phase == info["phase"]
        observation, wanted, _, _, info = env.step(int(action))
        assert reward == wanted
    assert info["is_success"]
    env.close()


def test_workers_record_what_one_process_sees(record, tmp_path):
    root = tmp_path / "d"
    run = start(f"--root={root}", "--episodes=1", f"--seed={SHORT_SEED - 1}", "--workers=2", *FAST)
    out, error = run.communicate(timeout=200)
    assert run.returncode == 0, error
    assert "kept 1 of" in out and "episode" in error
    recorded = Demonstrations.load(root)
    assert set(recorded.truth) == {0, 1}
    runs = (record.run_teacher(FAST_WORLD, False, seed) for seed in range(SHORT_SEED - 1, 200))
    wanted = next(run for run in runs if run is not None)
    assert np.array_equal(recorded.images, wanted.images)
    assert np.array_equal(recorded.actions, wanted.actions)


def test_what_exists_is_refused_in_one_line(tmp_path):
    (tmp_path / "kept").touch()
    run = start(f"--root={tmp_path}")
    _, error = run.communicate(timeout=100)
    assert run.returncode == 2 and error.count("\n") == 1 and "exists already" in error
    assert [path.name for path in tmp_path.iterdir()] == ["kept"]


def test_an_interrupt_leaves_nothing_behind(tmp_path):
    run = start(f"--root={tmp_path / 'd'}", "--episodes=1000", f"--seed={SHORT_SEED}", *FAST)
    while not list(tmp_path.glob(".d.*.partial/dataset/data/*/*.parquet")):
        assert run.poll() is None, run.communicate()
        time.sleep(0.1)
    os.kill(run.pid, signal.SIGINT)
    _, error = run.communicate(timeout=60)
    assert run.returncode == 130 and "Traceback" not in error
    assert list(tmp_path.iterdir()) == []
