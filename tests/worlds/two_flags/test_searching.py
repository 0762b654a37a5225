"""The searching teacher: what the paper's one fails at, and that it knows only what it has seen."""

import math

import gymnasium as gym
import numpy as np
import pytest

import dpmacro.worlds  # noqa: F401
from dpmacro.evaluation.recording import run_expert
from dpmacro.evaluation.rollouts import PlannerSource, run_episodes
from dpmacro.worlds.base import Expert
from dpmacro.worlds.two_flags.env import FORWARD, TURN_LEFT, TURN_RIGHT, TwoFlagsEnv
from dpmacro.worlds.two_flags.experts import FlagsExpert
from dpmacro.worlds.two_flags.scene import Layout
from dpmacro.worlds.two_flags.searching import SearchingTeacher
from dpmacro.worlds.two_flags.teacher import Teacher

HIDDEN = Layout(12.0, (3.7, 0.0), (0.0, 0.0)), (-1.0, 0.0, 0.0)
IN_THE_WAY = Layout(12.0, (3.0, 0.0), (0.0, 0.45)), (-3.0, 0.0, 0.0)
CORNER = Layout(9.0, (2.0, 2.0), (-2.0, -2.0)), (-3.9, -3.9, 0.8)
CLOSE = Layout(12.0, (3.0, 0.0), (0.0, 0.2)), (-0.9, 0.0, 0.0)
SMALL = {"render_size": (64, 48)}


class Dark(TwoFlagsEnv):
    """Teachers look at no picture, and drawing one takes longest."""

    def view(self, width, height):
        return np.zeros((height, width, 3), np.uint8)


@pytest.fixture(scope="module")
def env():
    env = Dark(**SMALL)
    yield env
    env.close()


def run(env, layout, start, seed=0, teacher=None, astray=0.0):
    """Actions of a run, and its last info; a share `astray` of the actions done is drawn at random."""
    teacher = teacher or SearchingTeacher()
    rng = np.random.default_rng(seed)
    observation, info = env.reset(seed=seed, options={"layout": layout, "start": start})
    teacher.reset(env)
    ended, actions = False, []
    while not ended:
        actions.append(teacher.act(observation, info))
        done = rng.integers(3) if rng.random() < astray else actions[-1]
        observation, _, terminated, truncated, info = env.step(done)
        ended = terminated or truncated
    return actions, info


@pytest.mark.parametrize("world", [HIDDEN, IN_THE_WAY, CORNER, CLOSE])
def test_it_reaches_what_the_papers_teacher_does_not(env, world):
    assert not run(env, *world, teacher=Teacher())[1]["is_success"]
    for seed in range(3):
        assert run(env, *world, seed=seed)[1]["is_success"]


def test_it_walks_on_after_a_whole_turn(env):
    actions, _ = run(env, *HIDDEN)
    first = next(t for t, action in enumerate(actions) if action != TURN_LEFT)
    assert 580 <= actions.index(FORWARD) <= 1200 and first >= 580


def test_where_nothing_hides_it_does_as_the_papers_teacher(env):
    world = Layout(10.0, (2.5, 2.0), (-2.0, -2.5)), (2.0, -2.0, 0.0)
    assert run(env, *world)[0] == run(env, *world, teacher=Teacher())[0]


@pytest.mark.parametrize("world", [HIDDEN, IN_THE_WAY])
def test_others_may_act_in_between(env, world):
    """As in DAgger, where the planner acts and the teacher only says what it would do."""
    assert run(env, *world, seed=1, astray=0.3)[1]["is_success"]


@pytest.mark.parametrize("driver", [TURN_LEFT, TURN_RIGHT])
def test_while_another_spins_it_knows_that_it_has_looked_round(env, driver):
    teacher = SearchingTeacher()
    observation, info = env.reset(seed=0, options={"layout": HIDDEN[0], "start": HIDDEN[1]})
    teacher.reset(env)
    said = []
    for _ in range(1300):
        said.append(teacher.act(observation, info))
        observation, *_, info = env.step(driver)
    assert set(said[:570]) == {TURN_LEFT} and FORWARD in said[600:]


def test_it_knows_no_flag_that_it_has_not_seen(env):
    """Red is beside it, and blue straight ahead: it walks, and runs into red."""
    world = Layout(12.0, (4.0, 0.0), (0.5, 0.65)), (0.0, 0.0, 0.0)
    _, info = run(env, *world)
    assert info["failure"] == "red_first"


def test_memory_is_that_of_what_comes_next(env):
    teacher = SearchingTeacher()
    observation, info = env.reset(seed=0, options={"layout": HIDDEN[0], "start": HIDDEN[1]})
    teacher.reset(env)
    fresh = teacher.memory
    memories = set()
    for _ in range(300):
        memories.add(teacher.memory)
        observation, *_, info = env.step(teacher.act(observation, info))
    assert len(memories) > 20
    teacher.reset(env)
    assert teacher.memory == fresh and hash(fresh)


def test_the_worlds_option_chooses_the_teacher():
    expert, kinds = FlagsExpert(), []
    assert isinstance(expert, Expert)
    for name in ("searching", "paper"):
        env = gym.make("TwoFlags-v0", teacher=name, **SMALL)
        env.reset(seed=0)
        expert.reset(env)
        kinds.append(expert.memory)
        env.close()
    assert kinds[0] and kinds[1] == ()
    with gym.make("CartPole-v1") as other, pytest.raises(ValueError, match="CartPoleEnv: it teaches"):
        expert.reset(other)


def test_recordings_and_evaluations_have_that_teacher():
    world = {"id": "TwoFlags-v0", "teacher": "searching", **SMALL}
    seed = 1  # red is in the way to blue; found by trying
    assert run_expert({**world, "teacher": "paper"}, seed) is None
    recorded = run_expert(world, seed)
    (episode,) = run_episodes(PlannerSource("teacher"), world, [seed])
    assert recorded is not None and recorded.success and episode.success
    assert np.array_equal(recorded.actions, episode.actions)
    assert np.array_equal(recorded.truth["phase"], episode.phases)


def test_its_turns_are_the_shorter_ones_where_it_walks(env):
    teacher = SearchingTeacher()
    observation, info = env.reset(seed=0, options={"layout": CLOSE[0], "start": CLOSE[1]})
    teacher.reset(env)
    action = teacher.act(observation, info)
    assert action in (TURN_LEFT, TURN_RIGHT) and math.isfinite(hash(teacher.memory))
