"""The teacher reaches what it can walk straight at, and nothing else."""

import math

import gymnasium as gym
import pytest

import dpmacro.worlds  # noqa: F401
from dpmacro.worlds.two_flags.env import FORWARD, TURN_LEFT, TURN_RIGHT
from dpmacro.worlds.two_flags.scene import Layout
from dpmacro.worlds.two_flags.teacher import TOLERANCE, Teacher


@pytest.fixture(scope="module")
def env():
    env = gym.make("TwoFlags-v0", render_size=(64, 48), max_steps=1500)
    yield env
    env.close()


def run(env, layout, start, seed=0):
    teacher = Teacher()
    observation, info = env.reset(seed=seed, options={"layout": layout, "start": start})
    teacher.reset(env)
    ended, actions = False, []
    while not ended:
        actions.append(teacher.act(observation, info))
        observation, _, terminated, truncated, info = env.step(actions[-1])
        ended = terminated or truncated
    return actions, info


def test_it_reaches_blue_then_red(env):
    _, info = run(env, Layout(10.0, (2.5, 2.0), (-2.0, -2.5)), (2.0, -2.0, 0.0))
    assert info["is_success"]


def test_it_glances_off_blue_towards_a_red_flag_beyond(env):
    _, info = run(env, Layout(10.0, (0.0, 0.0), (1.5, 3.0)), (0.0, -2.5, math.pi / 2))
    assert info["is_success"]


def test_it_turns_for_ever_when_red_hides_blue(env):
    actions, info = run(env, Layout(12.0, (5 - 1.3, 0.0), (0.0, 0.0)), (-1.0, 0.0, 0.0))
    assert set(actions) == {TURN_LEFT}
    assert info["phase"] == 0 and not info["is_success"] and info["failure"] == ""


def test_it_runs_into_a_red_flag_that_blocks_the_way(env):
    _, info = run(env, Layout(12.0, (3.0, 0.0), (0.0, 0.45)), (-3.0, 0.0, 0.0))
    assert info["failure"] == "red_first"


@pytest.mark.parametrize(
    "degrees, action",
    [
        (0.0, FORWARD),
        (2.9, FORWARD),
        (-2.9, FORWARD),
        (3.1, TURN_RIGHT),
        (-3.1, TURN_LEFT),
        (40.0, TURN_LEFT),
    ],
)
def test_it_centres_within_the_tolerance(env, degrees, action):
    start = (-3.0, 0.0, math.radians(degrees))
    observation, info = env.reset(options={"layout": Layout(12.0, (3.0, 0.0), (0.0, -4.0)), "start": start})
    teacher = Teacher()
    teacher.reset(env)
    assert math.degrees(TOLERANCE) == pytest.approx(3)
    assert teacher.act(observation, info) == action


def test_it_refuses_another_world():
    with gym.make("CartPole-v1") as other, pytest.raises(ValueError, match="CartPoleEnv"):
        Teacher().reset(other)
