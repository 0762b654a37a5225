"""Rooms with more flags than two: the same scene and rules, whatever their number."""

import math
import warnings
from dataclasses import dataclass
from itertools import combinations
from typing import ClassVar

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from dpmacro.evaluation.rollouts import PlannerSource, run_episodes
from dpmacro.worlds import diagnosis_of, expert_of, recording_of
from dpmacro.worlds.two_flags.env import FORWARD, TwoFlagsConfig, TwoFlagsEnv, draw_layout, draw_start
from dpmacro.worlds.two_flags.places import clear_ways
from dpmacro.worlds.two_flags.scene import AVATAR_RADIUS, FLAG_RADIUS, FLAGS, Layout

SHORT_SEED = 8  # the teacher's run is short; found by trying
FOUR = Layout(14.0, (3.0, 3.0), (-3.0, 3.0), ((-3.0, -3.0), (3.0, -3.0)))


@dataclass(frozen=True)
class ThreeFlagsConfig(TwoFlagsConfig):
    world: ClassVar[str] = "ThreeFlags"
    count: ClassVar[int] = 3


class ThreeFlagsEnv(TwoFlagsEnv):
    options_type = ThreeFlagsConfig


@pytest.fixture(scope="module")
def four():
    env = gym.make("FourFlags-v0", render_size=(64, 48), yaw_noise=0.0)
    yield env
    env.close()


def walked_to(env, flag):
    """Put the avatar before a flag and walk into it; what the step that touches it returns."""
    x, y = env.unwrapped.layout.flags[FLAGS.index(flag)]
    env.unwrapped.scene.put_avatar(np.array([x - 0.72, y]), 0.0)
    return env.step(FORWARD)


@pytest.mark.parametrize("world", ["FourFlags-v0", "SixFlags-v0"])
def test_check_env_has_no_complaint(world):
    env = gym.make(world, render_size=(64, 48))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(env.unwrapped, skip_render_check=True)
    env.close()


def test_flags_in_order_are_a_success(four):
    four.reset(seed=0, options={"layout": FOUR, "start": (0.0, 0.0, 0.0)})
    for place, flag in enumerate(FLAGS[:4]):
        for earlier in FLAGS[:place]:  # harmless: it was reached before
            _, reward, ended, _, info = walked_to(four, earlier)
            assert (reward, ended, info["phase"]) == (0.0, False, place)
        _, reward, ended, _, info = walked_to(four, flag)
        assert (reward, ended, info["phase"]) == (1.0, place == 3, min(place + 1, 3))
        assert info["is_success"] == (place == 3) and info["failure"] == ""
    assert diagnosis_of("FourFlags-v0").outcome(info) == "success"


@pytest.mark.parametrize(
    ("reached", "touched"),
    [(place, flag) for place in range(4) for flag in FLAGS[place + 1 : 4]],
)
def test_a_flag_before_its_turn_is_a_failure(four, reached, touched):
    four.reset(seed=0, options={"layout": FOUR, "start": (0.0, 0.0, 0.0)})
    for flag in FLAGS[:reached]:
        walked_to(four, flag)
    _, reward, ended, truncated, info = walked_to(four, touched)
    assert (reward, ended, truncated, info["is_success"]) == (0.0, True, False, False)
    assert (info["failure"], info["phase"]) == (f"{touched}_first", reached)
    assert diagnosis_of("FourFlags-v0").outcome(info) == f"{touched}_first"


def test_nothing_that_is_seen_tells_the_phase(four):
    pictures = []
    for reached in range(4):
        four.reset(seed=0, options={"layout": FOUR, "start": (0.0, 0.0, 0.0)})
        for flag in FLAGS[:reached]:
            walked_to(four, flag)
        views = []
        for heading in np.arange(8) * math.pi / 4:
            four.unwrapped.scene.put_avatar(np.array([0.5, 1.0]), heading + 0.1)
            views.append(four.unwrapped.view(64, 48))
        pictures.append(np.stack(views))
    assert all(np.array_equal(pictures[0], other) for other in pictures[1:])


def test_another_number_of_flags_is_a_matter_of_its_options():
    env = ThreeFlagsEnv(render_size=(64, 48), yaw_noise=0.0)
    env.reset(seed=0)
    assert env.flags == FLAGS[:3] and len(env.layout.flags) == 3
    assert [walked_to(env, flag)[2] for flag in FLAGS[:3]] == [False, False, True]
    env.close()


@pytest.mark.parametrize("count", range(2, 7))
def test_layouts_and_starts_leave_room_for_the_avatar(count):
    rng = np.random.default_rng(count)
    sides = []
    for _ in range(60):
        layout = draw_layout(rng, count)
        sides.append(layout.side)
        *start, _ = draw_start(rng, layout)
        assert len(layout.flags) == count
        for flag in layout.flags:
            assert max(map(abs, flag)) + FLAG_RADIUS + 2 * AVATAR_RADIUS < layout.side / 2
            assert math.dist(flag, start) > FLAG_RADIUS + AVATAR_RADIUS
        for one, other in combinations(layout.flags, 2):
            assert math.dist(one, other) > 2 * (FLAG_RADIUS + AVATAR_RADIUS)
    assert 5 <= min(sides) < 8 and 18 < max(sides) <= 20


@pytest.mark.parametrize("options", [{}, {"flags": "fixed"}, {"flags": "fixed", "start": "fixed"}])
@pytest.mark.parametrize(("world", "clear"), [("FourFlags-v0", True), ("TwoFlags-v0", False)])
def test_the_ways_of_many_flags_are_clear_from_every_start(world, clear, options):
    env = gym.make(world, render_size=(64, 48), **options)
    found = []
    for seed in range(12):
        _, info = env.reset(seed=seed)
        flags = [complex(*flag) for flag in env.unwrapped.layout.flags]
        found.append(clear_ways(complex(*info["position"]), flags))
    env.close()
    assert all(found) if clear else options or not all(found)


def test_two_flags_are_drawn_as_ever():
    rng = np.random.default_rng(3)
    layout = draw_layout(rng)
    assert layout == draw_layout(np.random.default_rng(3), 2) and layout.others == ()
    assert layout.flags == (layout.blue, layout.red)


def test_a_layout_of_another_number_of_flags_is_refused(four):
    with pytest.raises(ValueError, match="layout: it has 2 flags: give one of 4"):
        four.reset(options={"layout": Layout(10.0, (2.0, 0.0), (-2.0, 0.0))})


@pytest.mark.parametrize(("world", "count"), [("TwoFlags-v0", 2), ("FourFlags-v0", 4), ("SixFlags-v0", 6)])
def test_recordings_name_every_phase(world, count):
    told = recording_of(world)
    assert len(told.truth["phase"]) == count and told.truth["phase"][:2] == ("before blue", "after blue")
    assert told.task.startswith("reach the blue flag, then the red flag")
    assert [flag in told.task for flag in FLAGS] == [place < count for place in range(6)]


def test_an_episode_has_all_phases_and_its_steps():
    world = {"id": "FourFlags-v0", "render_size": (64, 48), "teacher": "searching"}
    (episode,) = run_episodes(PlannerSource("teacher"), world, [SHORT_SEED])
    assert episode.outcome == "success" and episode.reward == 4
    changes = np.flatnonzero(np.diff(episode.phases))
    assert episode.phases[changes + 1].tolist() == [1, 2, 3] and episode.phases[0] == 0
    events = diagnosis_of("FourFlags-v0").events([episode])
    assert events == {f"{flag}_steps": [step] for flag, step in zip(FLAGS[:3], changes, strict=True)}


def test_the_expert_walks_to_the_flag_whose_turn_it_is(four):
    expert = expert_of("FourFlags-v0")
    observation, info = four.reset(seed=0, options={"layout": FOUR, "start": (0.0, 0.0, -3 * math.pi / 4)})
    expert.reset(four)
    assert expert.act(observation, {**info, "phase": 2}) == FORWARD, "green is straight ahead"
    assert expert.act(observation, info) != FORWARD, "and blue behind"
