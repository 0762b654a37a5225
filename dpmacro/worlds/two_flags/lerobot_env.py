"""TwoFlags and its like in LeRobot's programs: `--env.type=two_flags`, `four_flags` or `six_flags`."""

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from functools import partial
from typing import Any, ClassVar

import gymnasium as gym
import numpy as np
from jaxtyping import UInt8
from lerobot.configs.types import FeatureType, PolicyFeature
from lerobot.envs.configs import EnvConfig
from lerobot.utils.constants import ACTION

from dpmacro.worlds import recording_of
from dpmacro.worlds.two_flags.env import ACTIONS, PIXELS, VIEW, TwoFlagsEnv
from dpmacro.worlds.two_flags.options import FourFlagsConfig, SixFlagsConfig, TwoFlagsConfig

__all__ = [
    "GYM_ID",
    "FourFlagsEnvConfig",
    "LeRobotFourFlags",
    "LeRobotSixFlags",
    "LeRobotTwoFlags",
    "SixFlagsEnvConfig",
    "TwoFlagsEnvConfig",
]

GYM_ID = "dpmacro/TwoFlags-v0"
TASK = recording_of("TwoFlags-v0").task
FPS: Any = TwoFlagsEnv.metadata["render_fps"]
CAMERA = "avatar"  # as recorded demonstrations name it
NEW_ROLLOUT = "lerobot_new_rollout"  # an option that LeRobot 0.6 gives to every reset
OPTIONS = tuple(option.name for option in fields(TwoFlagsConfig))

# LeRobot asks the environment itself for its task and its number of steps, which no wrapper hands on.
for _world in ("TwoFlags", "FourFlags", "SixFlags"):
    gym.register(
        f"dpmacro/{_world}-v0", f"{__name__}:LeRobot{_world}", order_enforce=False, disable_env_checker=True
    )


class LeRobotTwoFlags(TwoFlagsEnv):
    """TwoFlags-v0 with LeRobot's actions and observations.

    An action is a vector of one number for every action of TwoFlags, of which the highest is taken: the
    `action` of recorded demonstrations. The observation is {"pixels": {"avatar": uint8 [48, 64, 3]}}, which
    LeRobot turns into `observation.images.avatar`. `info` holds `is_success`, `phase` and `failure` at every
    step, and so does the `final_info` that LeRobot counts successes by. Options are those of TwoFlags-v0.
    """

    task = task_description = TASK

    def __init__(self, render_mode: str | None = None, **options: Any) -> None:
        super().__init__(render_mode, **options)
        self._max_episode_steps = self.config.max_steps
        self.action_space = gym.spaces.Box(0.0, 1.0, (len(ACTIONS),), np.float32)
        pixels = gym.spaces.Dict({CAMERA: self.observation_space["pixels"]})
        self.observation_space = gym.spaces.Dict({"pixels": pixels})
        self._shown = np.zeros((PIXELS[1], PIXELS[0], 3), np.uint8)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Draw a new episode, as TwoFlags-v0 does."""
        given = {name: value for name, value in (options or {}).items() if name != NEW_ROLLOUT}
        observation, info = super().reset(seed=seed, options=given)
        return self._observed(observation), _told(info)

    def step(self, action: Any) -> tuple[dict[str, Any], float, bool, bool, dict[str, Any]]:
        """Do what the highest number of the action stands for.

        Raises ValueError for an action that has not `len(ACTIONS)` finite numbers.
        """
        numbers = np.asarray(action, np.float64)
        if numbers.shape != (len(ACTIONS),) or not np.isfinite(numbers).all():
            raise ValueError(
                f"{self.config.world}: action is {action}: give {len(ACTIONS)} finite numbers, one for each "
                f"of {', '.join(ACTIONS)}"
            )
        observation, reward, terminated, truncated, info = super().step(int(numbers.argmax()))
        return self._observed(observation), reward, terminated, truncated, _told(info)

    def render(self) -> UInt8[np.ndarray, "240 320 3"]:
        """Return what the policy last saw, enlarged five times: LeRobot draws every step of ten episodes."""
        return self._shown.repeat(VIEW[1] // PIXELS[1], 0).repeat(VIEW[0] // PIXELS[0], 1)

    def _observed(self, observation: Mapping[str, np.ndarray]) -> dict[str, Any]:
        self._shown = observation["pixels"]
        return {"pixels": {CAMERA: self._shown}}


def _told(info: Mapping[str, Any]) -> dict[str, Any]:
    return {name: info[name] for name in ("is_success", "phase", "failure")}


class LeRobotFourFlags(LeRobotTwoFlags):
    """FourFlags-v0 likewise."""

    options_type = FourFlagsConfig
    task = task_description = recording_of("FourFlags-v0").task


class LeRobotSixFlags(LeRobotTwoFlags):
    """SixFlags-v0 likewise."""

    options_type = SixFlagsConfig
    task = task_description = recording_of("SixFlags-v0").task


def make_flags(world: str, options: Mapping[str, Any]) -> gym.Env:
    """One world; another process that unpickles this function registers it first."""
    return gym.make(world, **options)


@EnvConfig.register_subclass("two_flags")
@dataclass
class TwoFlagsEnvConfig(EnvConfig):
    """Options of `--env.type=two_flags`: those of TwoFlags-v0, with its defaults."""

    options_type: ClassVar[type[TwoFlagsConfig]] = TwoFlagsConfig

    task: str | None = TASK
    fps: int = FPS
    features: dict[str, PolicyFeature] = field(
        default_factory=lambda: {
            ACTION: PolicyFeature(FeatureType.ACTION, (len(ACTIONS),)),
            f"pixels/{CAMERA}": PolicyFeature(FeatureType.VISUAL, (PIXELS[1], PIXELS[0], 3)),
        }
    )
    features_map: dict[str, str] = field(
        default_factory=lambda: {ACTION: ACTION, f"pixels/{CAMERA}": f"observation.images.{CAMERA}"}
    )
    flags: str = TwoFlagsConfig.flags
    layout_seed: int = TwoFlagsConfig.layout_seed
    textures: str = TwoFlagsConfig.textures
    ways: str = TwoFlagsConfig.ways
    start: str = TwoFlagsConfig.start
    start_spread: float = TwoFlagsConfig.start_spread
    teacher: str = TwoFlagsConfig.teacher
    yaw_noise: float = TwoFlagsConfig.yaw_noise
    render_size: tuple[int, int] = TwoFlagsConfig.render_size
    max_steps: int = TwoFlagsConfig.max_steps
    renderer: str = TwoFlagsConfig.renderer

    def __post_init__(self) -> None:
        self.options_type(**{name: getattr(self, name) for name in OPTIONS})

    @property
    def package_name(self) -> str:
        """What is imported to register the environment."""
        return __name__

    @property
    def gym_id(self) -> str:
        """Gymnasium's name of it."""
        return f"dpmacro/{self.options_type.world}-v0"

    @property
    def gym_kwargs(self) -> dict[str, Any]:
        """What it is made with."""
        return {"render_mode": "rgb_array", **{name: getattr(self, name) for name in OPTIONS}}

    def create_envs(self, n_envs: int, use_async_envs: bool = False) -> dict[str, dict[int, Any]]:
        """Return {the type: {0: `n_envs` worlds}}; LeRobot 0.6 asks for them here, and 0.4 makes its own.

        LeRobot's own function makes worlds in processes that have not registered any.
        """
        makers = [partial(make_flags, self.gym_id, self.gym_kwargs)] * n_envs
        same_step = gym.vector.AutoresetMode.SAME_STEP
        if use_async_envs and n_envs > 1:
            worlds: Any = gym.vector.AsyncVectorEnv(makers, context="forkserver", autoreset_mode=same_step)
        else:
            worlds = gym.vector.SyncVectorEnv(makers, autoreset_mode=same_step)
        return {self.type: {0: worlds}}


@EnvConfig.register_subclass("four_flags")
@dataclass
class FourFlagsEnvConfig(TwoFlagsEnvConfig):
    """Options of `--env.type=four_flags`: those of FourFlags-v0, with its defaults."""

    options_type: ClassVar[type[TwoFlagsConfig]] = FourFlagsConfig

    task: str | None = LeRobotFourFlags.task
    ways: str = FourFlagsConfig.ways
    max_steps: int = FourFlagsConfig.max_steps


@EnvConfig.register_subclass("six_flags")
@dataclass
class SixFlagsEnvConfig(TwoFlagsEnvConfig):
    """Options of `--env.type=six_flags`: those of SixFlags-v0, with its defaults."""

    options_type: ClassVar[type[TwoFlagsConfig]] = SixFlagsConfig

    task: str | None = LeRobotSixFlags.task
    ways: str = SixFlagsConfig.ways
    max_steps: int = SixFlagsConfig.max_steps
