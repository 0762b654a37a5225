"""Two places to visit in order: the rules of the worlds, their expert, what runs and recordings tell."""

from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dpmacro.data.demonstrations import Demonstrations
from dpmacro.evaluation.recording import run_expert
from dpmacro.evaluation.rollouts import PlannerSource, run_episodes, run_on
from dpmacro.evaluation.run_writer import writing_runs
from dpmacro.evaluation.stage import Stage
from dpmacro.worlds import expert_of, recording_of
from dpmacro.worlds.base import WorldError
from dpmacro.worlds.making import make_world
from dpmacro.worlds.two_places import APART, DIMENSIONS, HIGH, LOW, NEAR, STATE, STEP, TOP

WORLDS = ("TwoButtons-v0", "TwoGoals-v0")


def walked(env, goal):
    """Straight to a point, until the run ends or it is there; what the last step gave."""
    world = env.unwrapped
    for _ in range(200):
        way = goal - world.hand
        result = env.step(np.float32(np.clip(way / STEP, -1, 1)))
        if result[2] or result[3] or np.abs(way).max() < 1e-6:
            return result
    raise AssertionError("it never came there")


def into(place):
    return place - np.array([0, 0, STEP])


def over(place):
    return np.array([place[0], place[1], 0.2])


@pytest.mark.parametrize("world", WORLDS)
@given(seed=st.integers(0, 10_000))
@settings(max_examples=25, deadline=None)
def test_a_seed_places_all_apart_and_within_reach(world, seed):
    env = gym.make(world)
    state = env.reset(seed=seed)[0][STATE]
    again = gym.make(world).reset(seed=seed)[0][STATE]
    assert np.array_equal(state, again)
    assert env.observation_space.contains({STATE: state})
    hand, blue, red = state[:9].reshape(3, 3)
    assert state[9] == 0.0
    gaps = [np.linalg.norm(a - b) for a, b in ((hand, blue), (hand, red), (blue, red))]
    assert min(gaps) >= APART - 1e-6
    assert (state[:9].reshape(3, 3) >= LOW).all() and (state[:9].reshape(3, 3) <= HIGH).all()


@pytest.mark.parametrize("world", WORLDS)
def test_blue_then_red_is_success_and_red_first_is_failure(world):
    env = gym.make(world)
    env.reset(seed=3)
    blue, red = env.unwrapped.places.copy()
    walked(env, over(blue))
    _, reward, ended, truncated, info = walked(env, into(blue))
    assert (reward, ended, truncated, info) == (0.0, False, False, {"is_success": False, "phase": 1})
    assert walked(env, into(blue))[0][STATE][9] == 1.0, "the contact is felt"
    assert walked(env, over(blue))[0][STATE][9] == 0.0
    walked(env, over(red))
    _, reward, ended, truncated, info = walked(env, into(red))
    assert (reward, ended, truncated, info) == (1.0, True, False, {"is_success": True, "phase": 1})
    env.reset(seed=3)
    walked(env, over(red))
    _, reward, ended, truncated, info = walked(env, into(red))
    assert (reward, ended, truncated, info) == (0.0, True, False, {"is_success": False, "phase": 0})


def test_a_button_is_pressed_from_above_only_and_a_goal_from_anywhere():
    env = gym.make("TwoButtons-v0")
    env.reset(seed=0)
    world = env.unwrapped
    blue = world.places[0]
    world.hand = blue + np.array([0, 0, 0.01])
    env.step(np.zeros(3, np.float32))
    assert world.phase == 0, "above its top"
    world.hand = np.array([blue[0] + NEAR + 0.01, blue[1], 0.0])
    env.step(np.zeros(3, np.float32))
    assert world.phase == 0, "beside it"
    world.hand = np.array([blue[0], blue[1], TOP])
    env.step(np.zeros(3, np.float32))
    assert world.phase == 1
    env = gym.make("TwoGoals-v0")
    env.reset(seed=0)
    world = env.unwrapped
    world.hand = world.places[0] + np.array([0, 0, 0.001 - NEAR])
    env.step(np.zeros(3, np.float32))
    assert world.phase == 1


def test_the_phase_cannot_be_seen():
    env = gym.make("TwoButtons-v0")
    env.reset(seed=0)
    world = env.unwrapped
    world.hand = over(world.places[0])
    before = env.step(np.zeros(3, np.float32))[0][STATE]
    walked(env, into(world.places[0]))
    world.hand = over(world.places[0])
    after, _, _, _, info = env.step(np.zeros(3, np.float32))
    assert info["phase"] == 1
    assert np.array_equal(before, after[STATE])


@pytest.mark.parametrize("world", WORLDS)
def test_the_expert_succeeds_and_tells_its_stages(world):
    episodes = run_episodes(PlannerSource("teacher"), {"id": world}, range(30))
    assert [episode.outcome for episode in episodes] == ["success"] * 30
    assert {0, 1} == set(np.concatenate([episode.phases for episode in episodes]).tolist())
    run = run_expert({"id": world}, 0, noise=0.3)
    assert run.task == recording_of(world).task
    for name, labels in run.truth.items():
        assert sorted(set(labels.tolist())) == list(range(len(recording_of(world).truth[name])))
        assert (np.diff(labels) >= 0).all() or name == "stage", "noise may push the hand out of a stage"
    with pytest.raises(ValueError, match="it teaches TwoPlaces"):
        expert_of(world).reset(gym.make("CartPole-v1"))


@pytest.mark.parametrize(
    ("phase", "steps", "outcome"),
    [(0, 0, "blue_never_reached"), (1, 0, "red_never_reached"), (0, 1, "red_first")],
)
def test_runs_that_fail_say_how(phase, steps, outcome, monkeypatch):
    class Planner:
        def reset(self, env):
            self.world = env.unwrapped
            self.world.phase = phase
            if steps:
                self.world.hand = self.world.places[1].copy()

        def act(self, observation, info):
            return np.zeros(3, np.float32)

    stage = Stage(Planner(), {"id": "TwoGoals-v0", "max_steps": 5})
    assert run_on(stage, 0).outcome == outcome


def test_a_picture_shows_hand_and_places():
    env = gym.make("TwoGoals-v0", render_mode="rgb_array")
    env.reset(seed=0)
    picture = env.render()
    assert picture.shape == (480, 480, 3) and picture.dtype == np.uint8
    env.unwrapped.hand = env.unwrapped.hand + 0.1
    assert not np.array_equal(picture, env.render())


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"max_steps": 0}, "max_steps is 0: give 1 or more"),
        ({"max_steps": True}, "max_steps is True"),
        ({"render_mode": "ansi"}, "render_mode is 'ansi'"),
        ({"nothing": 1}, "nothing"),
    ],
)
def test_bad_options_are_named(options, said):
    with pytest.raises(ValueError, match=said):
        make_world({"id": "TwoButtons-v0", **options})


def test_it_is_recorded_as_any_world(tmp_path):
    told, world, root = recording_of("TwoGoals-v0"), {"id": "TwoGoals-v0"}, tmp_path / "goals"
    with writing_runs(root, world, told, noise=0.1) as writer:
        for seed in range(3):
            writer.add(run_expert(world, seed, noise=0.1))
    demonstrations = Demonstrations.load(root)
    assert demonstrations.world["id"] == "TwoGoals-v0"
    assert demonstrations.state_names[STATE] == DIMENSIONS
    wrong = replace(told, states={STATE: DIMENSIONS[1:]})
    with (
        pytest.raises(WorldError, match=r"names 9 numbers of observation\.state, and the world"),
        writing_runs(tmp_path / "wrong", world, wrong) as writer,
    ):
        writer.add(run_expert(world, 0))
