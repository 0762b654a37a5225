"""The benchmark of weak learners, end to end on a small dataset."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from noise import write

ROOT = Path(__file__).parents[2]
FAST = ["--switch_stumps=3", "--switch_convnets=1"]


@pytest.fixture(scope="module")
def five(tmp_path_factory) -> Path:
    """Five demonstrations of 12 frames, of which the second half is phase 1."""
    root, generator = tmp_path_factory.mktemp("five") / "data", np.random.default_rng(0)
    episode = {
        "actions": np.arange(12) % 3,
        "truth": {"phase": (np.arange(12) > 5).astype(np.int64)},
        "rewards": np.zeros(12, np.float32),
        "success": True,
        "task": "go",
    }
    images = (generator.integers(0, 256, (12, 8, 8, 3), np.uint8) for _ in range(5))
    return write(root, ({"images": one, **episode} for one in images), {"id": "TwoFlags-v0"})


def call(*options):
    command = [sys.executable, "benchmarks/convnet.py", *options]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)


@pytest.mark.benchmark
def test_every_learner_boosts_for_as_long_as_asked(five):
    done = call(f"--dataset={five}", "--seconds=[0.1,0.4]", *FAST)
    assert done.returncode == 0, done.stderr
    _, _, *rows = done.stdout.splitlines()
    assert [row.split("  ")[0] for row in rows[:4]] == ["stumps", "convnets"] * 2
    for row, least in zip(rows[:4], [0.1] * 2 + [0.4] * 2, strict=True):
        seconds, rounds, learned, left_out = row[14:].split()[:4]
        assert float(seconds) >= least and int(rounds) >= 1
        assert float(learned) > 1 / 3 and float(left_out) < 0.8  # of noise, with three actions alike
    assert "3 stumps" in rows[-2] and "1 convnets" in rows[-1] and "0 to 1:" in rows[-1]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--demonstrations=[0,1,2]"], "gives 3 demonstrations: give 4 or more"),
        (["--seconds=[]"], "seconds is []"),
        (["--seconds=[0]"], "seconds is [0.0]"),
        (["--switch_stumps=0"], "switch_stumps is 0"),
    ],
)
def test_a_mistake_gets_one_line(five, options, message):
    done = call(f"--dataset={five}", *options)
    assert done.returncode == 2 and message in done.stderr and done.stderr.count("\n") == 1
