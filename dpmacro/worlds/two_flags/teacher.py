"""The teacher of TwoFlags: it knows the phase and what is in view, and walks straight at its target."""

import math
from typing import Any, cast

import gymnasium as gym
import numpy as np

from dpmacro.worlds.two_flags.env import FORWARD, TURN_LEFT, TURN_RIGHT, TwoFlagsEnv
from dpmacro.worlds.two_flags.scene import Scene

TOLERANCE = math.radians(3)


class Teacher:
    """Turns left until the target flag is in view, centres it within 3 degrees, walks towards it.

    The target is blue in phase 0 and red in phase 1. The teacher knows no detours: where one flag
    hides the other, or stands in its way, it fails.
    """

    memory = ()  # of `worlds.base.Planner`: it acts by the world's state alone

    def __init__(self) -> None:
        self._scene: Scene | None = None

    def reset(self, env: gym.Env) -> None:
        """Begin an episode in `env`, which must be a TwoFlags world; raises ValueError otherwise."""
        world = env.unwrapped
        if not isinstance(world, TwoFlagsEnv):
            raise ValueError(f"the teacher was given {type(world).__name__}: it teaches TwoFlags-v0 only")
        self._scene = world.scene

    def act(self, observation: dict[str, np.ndarray], info: dict[str, Any]) -> int:
        """Return the action for the state that the world of `reset` is in; `info` gives the phase."""
        scene = cast(Scene, self._scene)
        target = "red" if info["phase"] else "blue"
        if not scene.visible(target):
            return TURN_LEFT
        bearing = scene.bearing(target)
        if abs(bearing) <= TOLERANCE:
            return FORWARD
        return TURN_LEFT if bearing > 0 else TURN_RIGHT
