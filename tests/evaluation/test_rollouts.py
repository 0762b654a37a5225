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

from dpmacro.evaluation.rollouts import PlannerSource, iter_episodes, replay, run_episodes
from dpmacro.worlds import DIAGNOSES
from dpmacro.worlds.base import Episode, WorldError
from dpmacro.worlds.two_flags.env import FORWARD, TURN_LEFT, TURN_RIGHT

WORLD = "tests.evaluation.test_rollouts:Corridor-v0"
MAZE = "tests.evaluation.test_rollouts:Maze-v0"


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
    def planner(self, world):
        if self.path is not None:
            raise ValueError(f"{self.path} holds no planner")
        return Stroller()


class Maze(gym.Env):
    """Random ways between rooms, of which several look alike; one room changes the phase, others end it."""

    metadata = {"render_modes": ["rgb_array"], "render_fps": 30}  # noqa: RUF012
    observation_space = gym.spaces.Dict({"pixels": gym.spaces.Box(0, 255, (1,), np.uint8)})
    action_space = gym.spaces.Discrete(3)

    def __init__(self, render_mode=None, rooms=12, looks=4, ends=1, max_steps=300, tells=True):
        self.render_mode, self.rooms, self.looks, self.ends = render_mode, rooms, looks, ends
        self.max_steps, self.tells = max_steps, tells

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.ways = self.np_random.integers(self.rooms, size=(self.rooms, 3))
        self.steps = self.phase = self.room = 0
        return self._see()

    def step(self, action):
        self.steps += 1
        self.room = int(self.ways[self.room, action])
        self.phase |= self.room == self.rooms - 1
        ended = 0 < self.room <= self.ends
        observation, info = self._see()
        info["is_success"] = bool(ended and self.phase)
        info["failure"] = "red_first" if ended and not self.phase else ""
        return observation, 0.0, ended, not ended and self.steps >= self.max_steps, info

    def render(self):
        return np.full((12, 16, 3), self.room, np.uint8)

    def _see(self):
        info = {"phase": int(self.phase), "is_success": False, "failure": ""}
        if self.tells:
            info["state"] = self.room, self.phase
        return {"pixels": np.full(1, self.room % self.looks, np.uint8)}, info


class Rambler:
    """Acts by chance tables of what it sees, what it saw before, and a number that it keeps in mind."""

    def __init__(self, memory):
        self.tells = memory

    def reset(self, env):
        tables = np.random.default_rng(int(env.unwrapped.ways.sum()))
        self.actions = tables.integers(3, size=(4, 5, 3))
        self.minds = tables.integers(3, size=(4, 5, 3))
        self.before = 4
        self._remember(0)

    def act(self, observation, info):
        now = int(observation["pixels"][0])
        situation = now, self.before, self.mind
        self.before = now
        self._remember(int(self.minds[situation]))
        return int(self.actions[situation])

    def _remember(self, mind):
        self.mind = mind
        if self.tells:
            self.memory = mind


@dataclass(frozen=True)
class Rambling(PlannerSource):
    memory: bool = True

    def planner(self, world):
        return Rambler(self.memory)


class Script:
    """An action in each of a row of moments, the last few over and over; its memory is the moment."""

    def __init__(self, begin, cycle, memory):
        self.begin, self.cycle, self.tells = begin, cycle, memory

    def reset(self, env):
        self.moment = 0

    @property
    def memory(self):
        return self.moment if self.tells else None

    def act(self, observation, info):
        actions = self.begin + self.cycle
        action = actions[self.moment]
        self.moment += 1
        if self.moment == len(actions):
            self.moment = len(self.begin)
        return action


@dataclass(frozen=True)
class Scripted(PlannerSource):
    begin: tuple[int, ...] = ()
    cycle: tuple[int, ...] = (TURN_LEFT,)
    memory: bool = True

    def planner(self, world):
        return Script(self.begin, self.cycle, self.memory)


gym.register("Corridor-v0", Corridor, disable_env_checker=True)
gym.register("Maze-v0", Maze, disable_env_checker=True, order_enforce=False)
DIAGNOSES[WORLD] = DIAGNOSES[MAZE] = DIAGNOSES["TwoFlags-v0"]  # they tell phase and failure as it does


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


def test_a_run_cut_short_ends_as_it_would_have():
    loops = []
    for seed in range(300):
        (cut,) = run_episodes(Rambling("teacher"), {"id": MAZE}, [seed])
        (whole,) = run_episodes(Rambling("teacher", memory=False), {"id": MAZE}, [seed])
        assert (cut.outcome, cut.seed) == (whole.outcome, whole.seed)
        assert cut.actions.tolist() == whole.actions[: cut.steps].tolist()
        assert cut.phases.tolist() == whole.phases[: cut.steps].tolist()
        assert whole.loop == 0 and (cut.loop > 0) == (whole.steps == 300)
        if cut.loop:
            repeated = np.resize(whole.actions[cut.steps - cut.loop : cut.steps], 300 - cut.steps)
            assert whole.actions[cut.steps :].tolist() == repeated.tolist()
            loops.append((cut.loop, cut.outcome))
    lengths, outcomes = zip(*loops, strict=True)
    assert 50 < len(loops) < 250 and len(set(lengths)) > 5
    assert set(outcomes) == {"blue_never_reached", "red_never_reached"}


def test_a_loop_is_closed_on_the_first_repetition():
    for seed in range(100):
        moments = list(replay(Rambling("teacher"), {"id": MAZE}, seed))
        planner, env = Rambler(True), Maze()
        observation, info = env.reset(seed=seed)
        planner.reset(env)
        situations, previous = [], None
        for moment in moments:
            situations.append((previous, info["state"], planner.memory))
            previous = info["state"]
            assert planner.act(observation, info) == moment.action
            observation, _, _, _, info = env.step(moment.action)
        assert len(set(situations)) == len(situations) == len(moments)
        last = previous, info["state"], planner.memory
        assert moments[-1].loop == (len(moments) - situations.index(last) if moments[-1].loop else 0)
        assert all(moment.loop == 0 and not moment.outcome for moment in moments[:-1])


def test_a_world_that_does_not_tell_its_state_runs_to_its_end():
    (episode,) = run_episodes(Rambling("teacher"), {"id": MAZE, "ends": 0, "tells": False}, [0])
    assert (episode.steps, episode.loop, episode.positions) == (300, 0, None)


@pytest.mark.parametrize(
    ("begin", "cycle", "noise", "loop"),
    [
        ((), (TURN_LEFT,), 0.5, 600),
        ((), (TURN_RIGHT,), 0.5, 600),
        ((TURN_LEFT, FORWARD), (TURN_LEFT, TURN_RIGHT), 0.5, 2),
        ((FORWARD,) * 5, (TURN_LEFT, TURN_LEFT, TURN_RIGHT, TURN_RIGHT), 0.5, 4),
        ((), (FORWARD, TURN_LEFT, TURN_RIGHT), 0.5, 0),
        ((), (FORWARD,), 0.5, 0),
        ((), (FORWARD,), 0.0, 1),
        ((), (FORWARD, TURN_LEFT, TURN_RIGHT), 0.0, 3),
    ],
)
def test_loops_among_flags(begin, cycle, noise, loop):
    world = {"id": "TwoFlags-v0", "render_size": (64, 48), "yaw_noise": noise, "max_steps": 640}
    seed = 165  # the avatar's start is four steps away from the wall ahead
    (cut,) = run_episodes(Scripted("teacher", None, begin=begin, cycle=cycle), world, [seed])
    (whole,) = run_episodes(Scripted("teacher", None, begin=begin, cycle=cycle, memory=False), world, [seed])
    assert cut.outcome == whole.outcome == "blue_never_reached"
    assert (cut.loop, whole.loop, whole.steps) == (loop, 0, 640)
    assert (cut.steps < whole.steps) == (loop > 0)
    assert np.array_equal(cut.positions, whole.positions[: cut.steps])
    if loop:
        assert cut.steps - loop < max(1, len(begin)) + 5 * len(cycle)
        begun = slice(cut.steps - loop, cut.steps)
        assert np.array_equal(whole.actions[begun.stop :], np.resize(whole.actions[begun], 640 - begun.stop))
        assert np.ptp(whole.positions[begun.start :], axis=0).max() == 0


def test_a_teacher_whose_flag_is_hidden_turns_once():
    seed = 53  # red stands right before blue, seen from the start
    world = {"id": "TwoFlags-v0", "render_size": (64, 48), "max_steps": 1300}
    (cut,) = run_episodes(PlannerSource("teacher"), world, [seed])
    (whole,) = run_episodes(Scripted("teacher", memory=False), world, [seed])
    assert (cut.steps, cut.loop, cut.outcome) == (601, 600, whole.outcome)
    assert set(cut.actions.tolist()) == {TURN_LEFT}
    moments = list(replay(PlannerSource("teacher"), world, seed, every=600))
    assert [moment.outcome for moment in moments] == [""] * 600 + ["blue_never_reached"]
    assert moments[-1].loop == 600
    assert np.array_equal(moments[0].view, moments[-1].view)


@pytest.mark.parametrize("workers", [1, 2])
def test_what_a_run_raises_keeps_its_message(workers):
    with pytest.raises(WorldError, match="RuntimeError: the corridor collapsed at step 4, at step 3 of"):
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
import tests.evaluation.test_rollouts as here
from dpmacro.evaluation.rollouts import iter_episodes
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
    paths = os.pathsep.join([str(Path(__file__).parents[2]), str(Path(__file__).parents[1] / "helpers")])
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
