"""Environment steps per second: the rows, and a bare loop that draws what the runs drew."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from dpmacro.evaluation.rollouts import PlannerSource, iter_episodes
from dpmacro.worlds.two_flags.bullet import pybullet

ROOT = Path(__file__).parents[2]
WORLD = {"id": "TwoFlags-v0", "render_size": (64, 48), "max_steps": 20}


@pytest.fixture
def steps(monkeypatch):
    monkeypatch.syspath_prepend(ROOT / "benchmarks")
    import steps

    return steps


def test_the_bare_loop_draws_the_pictures_of_the_run(steps, monkeypatch):
    draw, drawn = pybullet.getCameraImage, []

    def kept(*positional, **named):
        picture = draw(*positional, **named)
        drawn.append(np.array(picture[2]))
        return picture

    episodes = iter_episodes(PlannerSource("teacher"), WORLD, [0, 0])
    monkeypatch.setattr(pybullet, "getCameraImage", kept)
    with steps._camera_calls() as calls:
        length = next(episodes).steps
    assert len(calls) == length + 1 == len(drawn)
    for (positional, named), picture in zip(calls, drawn, strict=True):
        assert np.array_equal(draw(*positional, **named)[2], picture)
    episodes.close()


def test_speeds_of_all_processes_are_added(steps):
    found = steps.speeds(PlannerSource("teacher"), WORLD, [[0], [1]], 2)
    assert found.steps == {0: 20, 1: 20}
    assert len(found.runs) == len(found.bare) == 2
    assert min(found.runs + found.bare) > 0


def test_rows_are_medians(steps):
    row = steps._row("evaluation", [1.0, 4.0, 2.0], [4.0, 8.0, 5.0])
    assert (row["ours"], row["peer"], row["ratio"]) == (2.0, 5.0, 0.4)
    assert set(row) == {"benchmark", "case", "ours", "peer_name", "peer", "ratio", "unit"}


def test_a_mistake_is_one_line():
    done = subprocess.run(
        [sys.executable, "benchmarks/steps.py", "--repeats=0"], cwd=ROOT, capture_output=True, text=True
    )
    assert done.returncode == 2
    assert done.stderr.splitlines() == ["error: repeats is 0: give 1 or more"]
