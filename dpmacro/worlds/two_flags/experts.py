"""The teacher that the world's option `teacher` names."""

from collections.abc import Hashable
from typing import Any

import gymnasium as gym
import numpy as np

from dpmacro.worlds.two_flags.searching import SearchingTeacher
from dpmacro.worlds.two_flags.teacher import Teacher, flags_world

__all__ = ["FlagsExpert"]


class FlagsExpert:
    """The `worlds.base.Expert` of rooms with flags: the paper's teacher, or the searching one."""

    def __init__(self) -> None:
        self._teacher: Teacher | SearchingTeacher = Teacher()

    @property
    def memory(self) -> Hashable:
        """That of the teacher."""
        return self._teacher.memory

    def reset(self, env: gym.Env) -> None:
        """Begin an episode in `env`; raises ValueError for another world."""
        searching = flags_world(env).config.teacher == "searching"
        self._teacher = SearchingTeacher() if searching else Teacher()
        self._teacher.reset(env)

    def act(self, observation: dict[str, np.ndarray], info: dict[str, Any]) -> int:
        """Return the action for the state that the world of `reset` is in; `info` gives the phase."""
        return self._teacher.act(observation, info)
