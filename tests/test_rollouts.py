"""Runs of a small world without pictures, registered here: its id names this module, so workers find it."""

import os
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

from dpmacro.rollouts import Episode, PlannerSource, iter_episodes, replay, run_episodes

WORLD = "test_rollouts:Corridor-v0"


class Corridor(gym.Env):
    """Reach the end of a corridor of random length; halfway the phase changes."""

    metadata = {"render_modes": ["rgb_array"], "render_fps": 30}  # noqa: RUF012
    observation_space = gym.spaces.Dict({"pixels": gym.spaces.Box(0, 255, (4, 4, 3), np.uint8)})
    action_space = gym.spaces.Discrete(3)

    def __init__(self, render_mode=None, ending="success", max_steps=50, raise_at=None, pause=0.0):
        self.render_mode, self.ending, self.max_steps = render_mode, ending, max_steps
        self.raise_at, self.pause = raise_at, pause

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.length = int(self.np_random.integers(6, 20))
        self.position = self.steps = 0
        return self._see()

    def step(self, action):
        time.sleep(self.pause)
        self.steps += 1
        if self.steps == self.raise_at:
            raise RuntimeError(f"the corridor collapsed at step {self.steps}")
        self.position += int(action == 0)
        ended = self.position >= self.length and self.ending != "never"
        observation, info = self._see()
        info["is_success"] = ended and self.ending == "success"
        info["failure"] = "red_first" if ended and self.ending == "red_first" else ""
        return observation, float(info["is_success"]), ended, self.steps >= self.max_steps, info

    def render(self):
        return np.full((12, 16, 3), self.position, np.uint8)

    def _see(self):
        pixels = np.full((4, 4, 3), self.position, np.uint8)
        return {"pixels": pixels}, {"phase": int(self.position >= self.length // 2), "is_success": False}


class Stroller:
    """Walks, turning every third step; macro-action 1 beyond position 3."""

    def reset(self, env):
        assert isinstance(env, gym.Env)
        self.seen, self.macro = 0, 0

    def act(self, observation, info):
        self.seen += 1
        self.macro = int(observation["pixels"][0, 0, 0] > 3)
        return 0 if self.seen % 3 else 2


@dataclass(frozen=True)
class Strolling(PlannerSource):
    def planner(self):
        if self.path is not None:
            raise ValueError(f"{self.path} holds no planner")
        return Stroller()


gym.register("Corridor-v0", Corridor, disable_env_checker=True)


def same(first: Episode, second: Episode) -> bool:
    return all(
        np.array_equal(getattr(first, name), getattr(second, name)) for name in Episode.__dataclass_fields__
    )


def test_an_episode_holds_what_the_planner_saw_and_chose():
    (episode,) = run_episodes(Strolling("teacher"), {"id": WORLD}, [5])
    assert (episode.seed, episode.outcome, episode.success, episode.reward) == (5, "success", True, 1.0)
    assert episode.actions[:6].tolist() == [0, 0, 2, 0, 0, 2]
    positions = np.cumsum(episode.actions == 0) - (episode.actions == 0)
    length = int(positions[-1]) + 1
    assert episode.phases.tolist() == (positions >= length // 2).astype(int).tolist()
    assert episode.macros.tolist() == (positions > 3).astype(int).tolist()
    assert len(episode.phases) == len(episode.macros) == len(episode.rewards) == episode.steps


@pytest.mark.parametrize(
    ("options", "outcome"),
    [
        ({}, "success"),
        ({"ending": "red_first"}, "red_first"),
        ({"max_steps": 2}, "blue_never_reached"),
        ({"ending": "never"}, "red_never_reached"),
    ],
)
def test_outcomes(options, outcome):
    assert [
        episode.outcome for episode in run_episodes(Strolling("teacher"), {"id": WORLD, **options}, [0])
    ] == [outcome]


def test_results_do_not_depend_on_the_number_of_workers():
    seeds = [9, 3, 3, 12, 0]
    alone = run_episodes(Strolling("teacher"), {"id": WORLD}, seeds, workers=1)
    together = run_episodes(Strolling("teacher"), {"id": WORLD}, seeds, workers=2)
    assert [episode.seed for episode in together] == seeds
    assert all(map(same, alone, together))
    assert len({episode.steps for episode in alone}) > 1


def test_a_replay_is_the_same_run_with_pictures():
    (episode,) = run_episodes(Strolling("teacher"), {"id": WORLD}, [7])
    moments = list(replay(Strolling("teacher"), {"id": WORLD}, 7))
    for name in ("action", "phase", "macro", "reward"):
        assert [getattr(moment, name) for moment in moments] == getattr(episode, name + "s").tolist()
    assert [moment.outcome for moment in moments] == [""] * (episode.steps - 1) + ["success"]
    assert [int(moment.view[0, 0, 0]) for moment in moments[:4]] == [0, 1, 2, 2]
    thinned = list(replay(Strolling("teacher"), {"id": WORLD}, 7, every=2))
    assert [moment.view is not None for moment in thinned[:4]] == [True, False, True, False]
    assert [moment.action for moment in thinned] == episode.actions.tolist()


@pytest.mark.parametrize("workers", [1, 2])
def test_what_a_run_raises_keeps_its_message(workers):
    with pytest.raises(RuntimeError, match="the corridor collapsed at step 4"):
        run_episodes(Strolling("teacher"), {"id": WORLD, "raise_at": 4}, [0, 1, 2], workers)
    with pytest.raises(ValueError, match="nowhere holds no planner"):
        run_episodes(Strolling("policy", Path("nowhere")), {"id": WORLD}, [0], workers)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: iter_episodes(Strolling("teacher"), {"id": WORLD}, [0], workers=0), "workers is 0"),
        (lambda: PlannerSource("wizard"), "'wizard' is unknown"),
        (lambda: PlannerSource("policy"), "needs a path"),
        (lambda: PlannerSource("teacher", Path("x")), "a teacher has none"),
    ],
)
def test_bad_arguments(make, message):
    with pytest.raises(ValueError, match=message):
        make()


ENDLESS = """
import test_rollouts as here
from dpmacro.rollouts import iter_episodes
if __name__ == "__main__":
    world = {"id": here.WORLD, "ending": "never", "max_steps": 10**9, "pause": 0.01}
    print("ready", flush=True)
    list(iter_episodes(here.Strolling("teacher"), world, range(4), workers=2))
"""


def children(process: int) -> list[int]:
    """Processes below `process`, by their entry in /proc."""
    found = []
    for status in Path("/proc").glob("[0-9]*/stat"):
        try:
            parent = int(status.read_text().rsplit(")", 1)[1].split()[1])
        except (OSError, IndexError):
            continue
        if parent == process:
            found.append(int(status.parent.name))
    return found


def alive(process: int) -> bool:
    try:
        return Path(f"/proc/{process}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except OSError:
        return False


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="looks for processes in /proc")
@pytest.mark.parametrize("ending", [signal.SIGINT, signal.SIGKILL])
def test_no_worker_outlives_the_run(ending, tmp_path):
    script = tmp_path / "endless.py"
    script.write_text(ENDLESS)
    paths = os.pathsep.join([str(Path(__file__).parent), str(Path(__file__).parents[1])])
    with subprocess.Popen(
        [sys.executable, str(script)],
        env={**os.environ, "PYTHONPATH": paths},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as run:
        run.stdout.readline()
        deadline = time.monotonic() + 30
        while len(children(run.pid)) < 3 and time.monotonic() < deadline:  # two workers, a resource tracker
            time.sleep(0.05)
        time.sleep(1.5)  # let them walk
        workers = children(run.pid)
        run.send_signal(ending)
        _, errors = run.communicate(timeout=20)
    while any(map(alive, workers)) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert len(workers) >= 3, errors
    assert not any(map(alive, workers))
    if ending == signal.SIGINT:
        assert errors.strip().endswith("KeyboardInterrupt")
