"""Runs that repeat themselves for ever, noticed on the first repetition."""

from collections.abc import Hashable, Mapping
from typing import Any

from dpmacro.worlds.base import Planner

__all__ = ["VisitedStates"]


class VisitedStates:
    """The situations that a run has been in: a state of the world, the one before it, the planner's memory.

    Two states of the world count since a policy sees two frames. A run that comes to a situation for the
    second time repeats what followed the first time, for ever.
    """

    def __init__(self) -> None:
        self._times: dict[Hashable, int] = {}
        self._previous: Hashable = None

    def visit(self, info: Mapping[str, Any], planner: Planner) -> int:
        """Note where the run is now, and return the number of steps since it was in that very situation.

        Returns 0 where it never was, where the world's info has no `state`, and where the planner has no
        `memory` or it is None.
        """
        memory = getattr(planner, "memory", None)
        if memory is None or "state" not in info:
            return 0
        situation = self._previous, info["state"], memory
        self._previous = info["state"]
        now = len(self._times)
        return now - self._times.setdefault(situation, now)
