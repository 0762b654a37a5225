"""The paper's teacher: it knows the phase and what is in view, and walks straight at its target."""

import math
from typing import Any, cast

import gymnasium as gym
import numpy as np

from dpmacro.worlds.two_flags.env import FORWARD, TURN_LEFT, TURN_RIGHT, TwoFlagsEnv

__all__ = ["TOLERANCE", "Teacher", "centring", "flags_world"]

TOLERANCE = math.radians(3)


class Teacher:
    """Turns left until the target flag is in view, centres it within 3 degrees, walks towards it.

    The target is blue in phase 0 and red in phase 1, and so on where there are more flags. The teacher knows
    no detours: where one flag hides the other, or stands in its way, it fails.
    """

    memory = ()  # of `worlds.base.Planner`: it acts by the world's state alone

    def __init__(self) -> None:
        self._world: TwoFlagsEnv | None = None

    def reset(self, env: gym.Env) -> None:
        """Begin an episode in `env`, which must be a room with flags; raises ValueError otherwise."""
        self._world = flags_world(env)

    def act(self, observation: dict[str, np.ndarray], info: dict[str, Any]) -> int:
        """Return the action for the state that the world of `reset` is in; `info` gives the phase."""
        world = cast(TwoFlagsEnv, self._world)
        target = world.flags[info["phase"]]
        if not world.scene.visible(target):
            return TURN_LEFT
        return centring(world.scene.bearing(target))


def centring(bearing: float) -> int:
    """The action that leads to what lies in this direction, radians, left positive."""
    if abs(bearing) <= TOLERANCE:
        return FORWARD
    return TURN_LEFT if bearing > 0 else TURN_RIGHT


def flags_world(env: gym.Env) -> TwoFlagsEnv:
    """The room with flags that `env` wraps; raises ValueError where it is another world."""
    world = env.unwrapped
    if not isinstance(world, TwoFlagsEnv):
        raise ValueError(f"the teacher was given {type(world).__name__}: it teaches TwoFlags-v0 and its like")
    return world
