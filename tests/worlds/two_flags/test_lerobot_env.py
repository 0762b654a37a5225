"""TwoFlags as LeRobot's environment: its options, what it shows and takes, and what it says of success."""

import json
from dataclasses import asdict, fields

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from lerobot.envs.configs import EnvConfig
from lerobot.envs.factory import make_env
from lerobot.envs.utils import env_to_policy_features

from dpmacro.worlds import recording_of
from dpmacro.worlds.two_flags.env import TwoFlagsConfig
from dpmacro.worlds.two_flags.lerobot_env import GYM_ID, OPTIONS, TASK, TwoFlagsEnvConfig

SMALL = {"render_size": (64, 48), "max_steps": 3, "flags": "fixed"}
LEFT = np.array([0, 1, 0], np.float32)


@pytest.fixture
def world():
    env = gym.make(GYM_ID, **SMALL)
    yield env
    env.close()


def test_the_options_are_those_of_the_world():
    assert tuple(option.name for option in fields(TwoFlagsConfig)) == OPTIONS
    given = {name: getattr(TwoFlagsEnvConfig(), name) for name in OPTIONS}
    assert given == asdict(TwoFlagsConfig())
    assert EnvConfig.get_choice_class("two_flags") is TwoFlagsEnvConfig
    with pytest.raises(ValueError, match="TwoFlags: max_steps is 0: give 1 or more"):
        TwoFlagsEnvConfig(max_steps=0)


@pytest.mark.parametrize(("kind", "world"), [("four_flags", "FourFlags"), ("six_flags", "SixFlags")])
def test_rooms_with_more_flags_are_environments_of_their_own(kind, world):
    config = EnvConfig.get_choice_class(kind)(render_size=(64, 48))
    assert config.type == kind and config.gym_id == f"dpmacro/{world}-v0"
    assert config.max_steps == config.gym_kwargs["max_steps"] == config.options_type().max_steps
    with pytest.raises(ValueError, match=f"{world}: start is 'fixed': give flags='fixed'"):
        type(config)(start="fixed")
    worlds = make_env(config, n_envs=1)[kind][0]
    plain = gym.make(f"{world}-v0", render_size=(64, 48))
    (shown,) = worlds.reset(seed=[4])[0]["pixels"]["avatar"]
    np.testing.assert_array_equal(shown, plain.reset(seed=4)[0]["pixels"])
    assert worlds.call("task_description") == (recording_of(f"{world}-v0").task,) == (config.task,)
    assert worlds.call("_max_episode_steps") == (config.max_steps,)
    worlds.close()
    plain.close()


def test_it_shows_and_takes_what_demonstrations_hold(recorded):
    features = env_to_policy_features(TwoFlagsEnvConfig())
    of_dataset = json.loads((recorded / "meta/info.json").read_text())["features"]
    assert features["action"].shape == tuple(of_dataset["action"]["shape"])
    (camera,) = features.keys() - {"action"}
    height, width, channels = of_dataset[camera]["shape"]
    assert features[camera].shape == (channels, height, width)


def test_it_is_the_world_under_other_names(world):
    check_env(world.unwrapped, skip_render_check=True)
    plain = gym.make("TwoFlags-v0", **SMALL)
    observation, info = world.reset(seed=5, options={"lerobot_new_rollout": True})
    own, _ = plain.reset(seed=5)
    for action in range(3):
        np.testing.assert_array_equal(observation["pixels"]["avatar"], own["pixels"])
        picture = world.render()
        assert picture.shape == (240, 320, 3)
        np.testing.assert_array_equal(picture[2::5, 2::5], own["pixels"])
        assert info["is_success"] is False
        observation, *ended, info = world.step(np.eye(3)[action] * 0.4 - 0.1)
        own, *own_ended, own_info = plain.step(action)
        assert ended == own_ended and info == {name: own_info[name] for name in info}
    assert ended[-1], "it truncates itself"
    plain.close()


@pytest.mark.parametrize("action", [1, [1.0, 0.0], [np.nan, 0, 0], np.zeros((1, 3))])
def test_an_action_that_is_none_is_named(world, action):
    world.reset(seed=0)
    with pytest.raises(
        ValueError, match=r"TwoFlags: action is .*: give 3 finite numbers, one for each of forward"
    ):
        world.step(action)


def test_another_option_of_reset_is_refused(world):
    with pytest.raises(ValueError, match="reset has no option 'phase'"):
        world.reset(options={"phase": 1})


def test_lerobot_makes_worlds_that_tell_success_and_their_task():
    worlds = make_env(TwoFlagsEnvConfig(**SMALL), n_envs=2)["two_flags"][0]
    worlds.reset(seed=[1, 2])
    assert worlds.call("_max_episode_steps") == (3, 3) and worlds.call("task_description") == (TASK, TASK)
    for _ in range(3):
        *_, info = worlds.step(np.stack([LEFT, LEFT]))
    assert info["final_info"]["is_success"].tolist() == [False, False]
    worlds.close()


@pytest.mark.skipif(not hasattr(EnvConfig, "create_envs"), reason="LeRobot 0.4 makes no worlds in processes")
def test_processes_make_worlds_of_their_own():
    worlds = make_env(TwoFlagsEnvConfig(**SMALL), n_envs=2, use_async_envs=True)["two_flags"][0]
    here = make_env(TwoFlagsEnvConfig(**SMALL), n_envs=2)["two_flags"][0]
    for envs in (worlds, here):
        envs.reset(seed=[1, 2])
    theirs, ours = (envs.step(np.stack([LEFT, LEFT]))[0]["pixels"]["avatar"] for envs in (worlds, here))
    np.testing.assert_array_equal(theirs, ours)
    worlds.close()
    here.close()
