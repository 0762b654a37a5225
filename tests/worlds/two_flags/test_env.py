"""TwoFlags-v0 as a gymnasium environment, and as the world that its docstring describes."""

import math
import os
import subprocess
import sys
import warnings
from hashlib import sha256
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import dpmacro.worlds  # noqa: F401
from dpmacro.worlds.two_flags.env import FORWARD, TURN_LEFT, TURN_RIGHT, TwoFlagsEnv, draw_layout, draw_start
from dpmacro.worlds.two_flags.scene import AVATAR_RADIUS, FLAG_RADIUS, Layout
from dpmacro.worlds.two_flags.teacher import Teacher

LAYOUT = Layout(10.0, (2.0, 0.0), (-2.0, 0.0))


@pytest.fixture(scope="module")
def env():
    env = gym.make("TwoFlags-v0", render_size=(64, 48))
    yield env
    env.close()


def digest(seed):
    """Hash of every pixel of a seeded episode of 60 random actions."""
    env = gym.make("TwoFlags-v0")
    observation, _ = env.reset(seed=seed)
    actions = np.random.default_rng(seed).integers(0, 3, 60)
    pixels = [observation["pixels"].tobytes(), *(env.step(a)[0]["pixels"].tobytes() for a in actions)]
    env.close()
    return sha256(b"".join(pixels)).hexdigest()


def test_check_env_has_no_complaint():
    env = gym.make("TwoFlags-v0", render_mode="rgb_array")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(env.unwrapped)


def test_it_comes_without_wrappers(env):
    assert env.unwrapped is env


def test_two_copies_agree_here_and_in_another_process():
    code = "from tests.worlds.two_flags.test_env import digest; print(digest(3))"
    elsewhere = subprocess.run(
        [sys.executable, "-c", code],
        cwd=Path(__file__).parents[3],
        env={**os.environ, "PYTHONPATH": str(Path(__file__).parents[3])},
        capture_output=True,
        text=True,
        check=True,
    )
    assert digest(3) == digest(3) == elsewhere.stdout.strip()
    assert digest(3) != digest(4)
    assert elsewhere.stderr == ""


def test_observation_info_and_render(env):
    observation, info = env.reset(seed=0)
    assert env.observation_space.contains(observation)
    assert observation["pixels"].shape == (48, 64, 3)
    assert set(info) == {"phase", "is_success", "failure", "position", "heading", "state"}
    assert info["position"].dtype == np.float64 and -math.pi <= info["heading"] < math.pi
    assert env.unwrapped.render().shape == (240, 320, 3)


def test_the_picture_is_downscaled_by_area():
    small, large = (gym.make("TwoFlags-v0", render_size=size) for size in [(64, 48), (128, 96)])
    mean = large.reset(seed=1)[0]["pixels"].astype(float)
    direct = large.unwrapped.view(128, 96).reshape(48, 2, 64, 2, 3).mean(axis=(1, 3))
    assert np.abs(mean - direct).max() <= 0.5
    assert not np.array_equal(mean, small.reset(seed=1)[0]["pixels"])
    small.close()
    large.close()


@pytest.mark.parametrize(
    "action, distance, turn",
    [(FORWARD, 0.03, 0.0), (TURN_LEFT, 0.0, math.pi / 300), (TURN_RIGHT, 0.0, -math.pi / 300)],
)
def test_actions(action, distance, turn):
    env = gym.make("TwoFlags-v0", yaw_noise=0.0, render_size=(64, 48))
    _, before = env.reset(seed=0, options={"layout": LAYOUT, "start": (0.0, 0.0, 1.0)})
    _, reward, terminated, truncated, after = env.step(action)
    assert after["position"] == pytest.approx([distance * math.cos(1.0), distance * math.sin(1.0)], abs=1e-12)
    assert after["heading"] - before["heading"] == pytest.approx(turn)
    assert (reward, terminated, truncated) == (0.0, False, False)
    env.close()


@pytest.mark.parametrize("noise", [0.5, 0.0])
def test_equal_states_are_the_same_moment(noise):
    env = gym.make("TwoFlags-v0", yaw_noise=noise, render_size=(64, 48))
    rng = np.random.default_rng(0)
    seen, met = {}, 0
    observation, info = env.reset(seed=0, options={"layout": LAYOUT, "start": (0.0, 4.5, math.pi / 2)})
    for t in range(400):
        heading, pixels, position = info["heading"], observation["pixels"], info["position"]
        if info["state"] in seen:
            met += 1
            first_heading, first_pixels, first_position = seen[info["state"]]
            assert heading == pytest.approx(first_heading, abs=1e-9)
            assert np.array_equal(pixels, first_pixels) and np.array_equal(position, first_position)
        seen.setdefault(info["state"], (heading, pixels, position))
        observation, _, _, _, info = env.step(rng.choice(3, p=[0.1, 0.45, 0.45]) if t > 10 else FORWARD)
    assert 100 < met < 390
    env.close()


@pytest.mark.parametrize("turn", [TURN_LEFT, TURN_RIGHT])
def test_a_whole_turn_leads_back_to_the_state_and_less_does_not(env, turn):
    _, start = env.reset(seed=0)
    states = [env.step(turn)[-1]["state"] for _ in range(600)]
    assert states.index(start["state"]) == 599 and len(set(states)) == 600


def test_a_state_changes_with_what_the_avatar_does():
    quiet, noisy = (gym.make("TwoFlags-v0", yaw_noise=noise, render_size=(64, 48)) for noise in (0.0, 0.5))
    for env in (quiet, noisy):
        _, before = env.reset(seed=0, options={"layout": LAYOUT, "start": (1.25, 0.0, 0.0)})
        _, _, _, _, walked = env.step(FORWARD)
        _, reward, _, _, reached = env.step(FORWARD)
        assert reward == 1 and np.array_equal(walked["position"][1:], [0.0])
        assert len({before["state"], walked["state"], reached["state"]}) == 3
        _, again = env.reset(seed=0, options={"layout": LAYOUT, "start": (1.25, 0.0, 0.0)})
        assert again["state"] == before["state"]
        env.reset(seed=0, options={"layout": LAYOUT, "start": (0.0, 4.5, math.pi / 2)})
        against_the_wall = [env.step(FORWARD)[-1]["state"] for _ in range(8)]
        assert len(set(against_the_wall)) == (3 if env is quiet else 8)
        env.close()


@pytest.mark.parametrize("action", [-1, 3, np.int64(7)])
def test_an_action_out_of_range_is_refused(env, action):
    env.reset(seed=0)
    with pytest.raises(ValueError, match=f"action is {action}: choose 0"):
        env.step(action)


def test_yaw_noise_strikes_every_forward_step_blocked_or_not():
    env = gym.make("TwoFlags-v0", yaw_noise=2.0, render_size=(64, 48))
    walks, blocked = [], []
    _, before = env.reset(seed=0, options={"layout": LAYOUT, "start": (0.0, 3.0, math.pi / 2)})
    for _ in range(1500):
        _, _, _, _, after = env.step(FORWARD)
        turn = (after["heading"] - before["heading"] + math.pi) % (2 * math.pi) - math.pi
        (blocked if np.array_equal(after["position"], before["position"]) else walks).append(
            math.degrees(turn)
        )
        before = after
    for turns in (walks, blocked):
        assert len(turns) > 100 and 0.0 not in turns
        assert np.mean(turns) == pytest.approx(0.0, abs=4 * 2.0 / math.sqrt(len(turns)))
        assert np.std(turns) == pytest.approx(2.0, rel=0.2)
    env.close()


def test_it_never_enters_a_wall_or_a_flag(env):
    rng = np.random.default_rng(0)
    touched, side = 0, 6.0
    layout = Layout(side, (1.2, 0.0), (-1.2, 0.0))
    for seed in range(4):
        _, info = env.reset(seed=seed, options={"layout": layout})
        for _ in range(500):
            actions = [FORWARD] * 3 + [rng.integers(0, 3)]
            _, _, terminated, _, after = env.step(actions[rng.integers(4)])
            touched += np.array_equal(after["position"], info["position"])
            info = after
            assert np.abs(info["position"]).max() <= side / 2 - AVATAR_RADIUS + 1e-6
            for flag in (layout.blue, layout.red):
                assert math.dist(info["position"], flag) >= AVATAR_RADIUS + FLAG_RADIUS - 1e-3
            if terminated:
                break
    assert touched > 100


def test_red_first_is_a_failure(env):
    env.reset(seed=0, options={"layout": LAYOUT, "start": (-1.0, 0.0, math.pi)})
    ended, rewards = False, []
    while not ended:
        _, reward, ended, truncated, info = env.step(FORWARD)
        rewards.append(reward)
    assert not truncated and sum(rewards) == 0
    assert (info["phase"], info["is_success"], info["failure"]) == (0, False, "red_first")
    with pytest.raises(gym.error.ResetNeeded):
        env.step(FORWARD)


@pytest.mark.parametrize("seed", [0, 1, 3])
def test_blue_then_red_is_a_success(env, seed):
    teacher = Teacher()
    observation, info = env.reset(seed=seed, options={"layout": Layout(8.0, (2.0, 2.0), (-2.0, 2.0))})
    teacher.reset(env)
    ended, rewards, phases = False, [], []
    while not ended:
        assert not info["is_success"]
        observation, reward, ended, truncated, info = env.step(teacher.act(observation, info))
        rewards.append(reward)
        phases.append(info["phase"])
        assert not truncated
    assert (info["phase"], info["is_success"], info["failure"]) == (1, True, "")
    assert sum(rewards) == 2 and rewards[-1] == 1
    assert rewards[phases.index(1)] == 1  # the first reward comes with the change of phase


def test_truncation():
    env = gym.make("TwoFlags-v0", max_steps=5, render_size=(64, 48))
    for _ in range(2):
        env.reset(seed=0)
        assert [env.step(TURN_LEFT)[3] for _ in range(5)] == [False] * 4 + [True]
    env.close()


def test_a_fixed_layout_stays_while_textures_and_start_change():
    env, other = (gym.make("TwoFlags-v0", flags="fixed", layout_seed=k, render_size=(64, 48)) for k in (2, 3))
    layouts, starts, pictures = set(), set(), set()
    for seed in (0, 1, None, None):
        _, info = env.reset(seed=seed)
        starts.add(tuple(info["position"]))
        layouts.add(env.unwrapped.layout)
        env.reset(options={"start": (0.0, 0.0, 0.0)})
        pictures.add(env.unwrapped.view(64, 48).tobytes())
    assert (len(layouts), len(starts), len(pictures)) == (1, 4, 4)
    other.reset(seed=0)
    assert other.unwrapped.layout not in layouts
    env.close()
    other.close()


def test_random_layouts_differ(env):
    layouts = []
    for seed in (0, 1, None):
        env.reset(seed=seed)
        layouts.append(env.unwrapped.layout)
    assert len(set(layouts)) == 3
    env.reset(seed=0)
    assert env.unwrapped.layout == layouts[0]


def test_layouts_and_starts_leave_room_for_the_avatar():
    rng = np.random.default_rng(0)
    sides = []
    for _ in range(500):
        layout = draw_layout(rng)
        sides.append(layout.side)
        x, y, heading = draw_start(rng, layout)
        for flag in (layout.blue, layout.red):
            assert max(map(abs, flag)) + FLAG_RADIUS + 2 * AVATAR_RADIUS < layout.side / 2
            assert math.dist(flag, (x, y)) > FLAG_RADIUS + AVATAR_RADIUS
        assert math.dist(layout.blue, layout.red) > 2 * (FLAG_RADIUS + AVATAR_RADIUS)
        assert max(abs(x), abs(y)) + AVATAR_RADIUS < layout.side / 2
        assert -math.pi <= heading < math.pi
    assert min(sides) < 5.2 and max(sides) > 19.8 and min(sides) >= 5 and max(sides) <= 20


@pytest.mark.parametrize(
    "options, message",
    [
        ({"flags": "some"}, "flags is 'some': choose 'random' or 'fixed'"),
        ({"layout_seed": -1}, "layout_seed is -1: give a seed of 0"),
        ({"yaw_noise": -0.5}, "yaw_noise is -0.5: give degrees"),
        ({"yaw_noise": math.inf}, "yaw_noise is inf: give degrees"),
        ({"yaw_noise": math.nan}, "yaw_noise is nan: give degrees"),
        ({"render_size": (63, 48)}, r"render_size is \(63, 48\): give a width"),
        ({"render_size": (32, 24)}, r"render_size is \(32, 24\): give a width"),
        ({"render_size": (128, 128)}, r"render_size is \(128, 128\): give a width"),
        ({"max_steps": 0}, "max_steps is 0: give 1 or more"),
        ({"renderer": "gpu"}, "renderer is 'gpu': choose 'tiny' or 'egl'"),
        ({"colour": 1}, "no option 'colour': choose among flags, layout_seed"),
        ({"render_mode": "ansi"}, "render_mode is 'ansi'"),
    ],
)
def test_unfit_options_are_refused(options, message):
    with pytest.raises(ValueError, match=message):
        TwoFlagsEnv(**options)


@pytest.mark.parametrize(
    "options, message",
    [
        ({"room": 3}, "no option 'room': choose among layout, start"),
        ({"layout": LAYOUT, "start": (2.0, 0.5, 0.0)}, "lies in a wall or flag"),
        ({"layout": LAYOUT, "start": (0.0, 4.8, 0.0)}, "lies in a wall or flag"),
    ],
)
def test_unfit_reset_options_are_refused(env, options, message):
    with pytest.raises(ValueError, match=message):
        env.reset(options=options)


def test_actions_given_as_numpy_integers(env):
    env.reset(seed=0)
    for kind in (np.int64, np.int32, np.uint8):
        env.step(kind(TURN_RIGHT))


def test_stepping_before_reset_is_refused():
    env = gym.make("TwoFlags-v0")
    with pytest.raises(gym.error.ResetNeeded):
        env.step(0)
    env.close()
