"""A teacher that also looks behind flags, and walks round those whose turn it is not."""

import cmath
import math
from collections.abc import Hashable, Sequence
from typing import Any, cast

import gymnasium as gym
import numpy as np

from dpmacro.worlds.two_flags.env import FORWARD, STEP, TURN, TURN_LEFT, TURN_RIGHT, TwoFlagsEnv
from dpmacro.worlds.two_flags.places import CLEAR, TOUCH, clearance, is_seen, way_past
from dpmacro.worlds.two_flags.scene import FIELD_OF_VIEW
from dpmacro.worlds.two_flags.teacher import centring, flags_world

__all__ = ["SearchingTeacher"]

WIDEST = FIELD_OF_VIEW / 2 - math.radians(3)  # off the target, which stays in view
LOOKS = 48  # directions that it tells apart
WALKS = (0.9, 1.5, 2.5, 4.0)  # metres
BEHIND = (1.5, 3.0, 6.0)  # metres behind a flag, where another may stand
AHEAD = 1.0  # metres of the way ahead that must be clear
NEARBY = 1.0  # metres within which it looks from one and the same place
NEAR = 0.1  # metres from a goal that is reached


class SearchingTeacher:
    """Looks for the target like the paper's teacher, and where a whole turn does not show it, walks on.

    It turns left until the target is in view, and walks to it. Where another flag stands in the way, it walks
    past that flag. Where it has turned once round without seeing the target, this must be behind a flag: it
    walks to the nearest place from which most of what flags hide is seen, and looks from there. It does the
    same where it is so close to a flag in the way that walking past would turn its eyes from the target.

    It is told what the paper's teacher is told, the phase and the directions of the flags in view, and beside
    that how far these flags and the walls are, as a person sees. It remembers where the flags are that it has
    seen; a flag that was never in view it does not know, and may run into.
    """

    def __init__(self) -> None:
        self._world: TwoFlagsEnv | None = None
        self._seen: frozenset[str] = frozenset()
        self._goal: complex | None = None  # in the room's coordinates
        self._begin(0)

    @property
    def memory(self) -> Hashable:
        """Phase, flags seen, where and in which directions it has looked for the target, and its goal."""
        return self._phase, self._seen, self._looked_from, self._looked, self._goal

    def reset(self, env: gym.Env) -> None:
        """Begin an episode in `env`, which must be a room with flags; raises ValueError otherwise."""
        self._world, self._seen = flags_world(env), frozenset()
        self._begin(0)

    def act(self, observation: dict[str, np.ndarray], info: dict[str, Any]) -> int:
        """Return the action for the state that the world of `reset` is in; `info` gives the phase.

        What was done before need not have been this teacher's action.
        """
        if info["phase"] != self._phase:
            self._begin(info["phase"])
        world = cast(TwoFlagsEnv, self._world)
        target = world.flags[self._phase]
        self._seen |= {flag for flag in world.flags if world.scene.visible(flag)}
        if world.scene.visible(target):
            self._looked = 0
            place = self._place(target)
            way = self._way_to(place)
            if way is not None:
                self._goal = None
                return self._towards(way)
            if self._goal is None:
                self._plan([place])
        elif self._goal is None and self._has_looked_round():
            self._plan(self._hidden())
        return TURN_LEFT if self._goal is None else self._walk(self._goal)

    def _begin(self, phase: int) -> None:
        self._phase, self._looked, self._looked_from = phase, 0, 0j
        self._goal = None

    @property
    def _here(self) -> complex:
        """Where the avatar is, in the room's coordinates."""
        return complex(*cast(TwoFlagsEnv, self._world).scene.position)

    @property
    def _ahead(self) -> complex:
        """Where it looks, a place at 1 m, less its own, in the room's coordinates."""
        return cmath.rect(1, cast(TwoFlagsEnv, self._world).scene.heading)

    def _has_looked_round(self) -> bool:
        """Note where it looks; whether it has looked everywhere from about here."""
        if not self._looked or abs(self._here - self._looked_from) > NEARBY:
            self._looked, self._looked_from = 0, self._here
        turned = cmath.phase(self._ahead) % (2 * math.pi) / (2 * math.pi)
        self._looked |= 1 << min(int(turned * LOOKS), LOOKS - 1)
        return self._looked == (1 << LOOKS) - 1

    def _place(self, flag: str) -> complex:
        scene = cast(TwoFlagsEnv, self._world).scene
        return cmath.rect(scene.distance(flag), scene.bearing(flag))

    def _others(self, touched: bool) -> list[complex]:
        """Places of the flags it has seen but for the target, with or without those that were touched."""
        flags = cast(TwoFlagsEnv, self._world).flags
        others = (*flags[: self._phase * touched], *flags[self._phase + 1 :])
        return [self._place(flag) for flag in others if flag in self._seen]

    def _way_to(self, target: complex) -> float | None:
        """The direction to walk in towards the target; None where it would be out of view."""
        way = way_past(target, self._others(touched=True), WIDEST)
        # Flags that were touched do no harm, and an avatar glances off them.
        return way_past(target, self._others(touched=False), WIDEST) if way is None else way

    def _towards(self, way: float) -> int:
        action = centring(way)
        if action == FORWARD and clearance(complex(AHEAD), self._others(touched=False)) < CLEAR - 0.03:
            return TURN_LEFT if way > 0 else TURN_RIGHT
        return action

    def _walk(self, goal: complex) -> int:
        """The next action of the walk to a goal, which is given up where it is reached or not free."""
        way = (goal - self._here) / self._ahead
        if abs(way) <= NEAR:
            self._looked = 0
        elif clearance(way, self._others(touched=True)) >= TOUCH + 0.01:
            return centring(cmath.phase(way))
        self._goal = None
        return TURN_LEFT

    def _hidden(self) -> list[complex]:
        """Places where the target may be: behind the flags that were seen, within the walls."""
        scene, found = cast(TwoFlagsEnv, self._world).scene, []
        for flag in self._others(touched=True):
            way = cmath.phase(flag)
            reach = scene.to_wall(way)
            found += [
                cmath.rect(abs(flag) + gap, way)
                for gap in BEHIND
                if gap == BEHIND[0] or abs(flag) + gap < reach
            ]
        return found

    def _plan(self, targets: Sequence[complex]) -> None:
        """Choose a goal from which most of `targets` are seen and can be walked to, the nearest such."""
        scene, flags = cast(TwoFlagsEnv, self._world).scene, self._others(touched=True)
        best = (-1, -math.inf)
        for look in range(LOOKS):
            way = 2 * math.pi * look / LOOKS - math.pi
            room = scene.to_wall(way)
            for walk in WALKS:
                end = cmath.rect(walk, way)
                if walk > room or clearance(end, flags) < CLEAR:
                    continue
                seen = [at for at in targets if self._good(end, at, flags)]
                cost = abs(way) / TURN + walk / STEP + min((_look(end, at) for at in seen), default=0.0)
                if (len(seen), -cost) > best:
                    best = (len(seen), -cost)
                    self._goal = self._here + end * self._ahead

    def _good(self, end: complex, target: complex, flags: Sequence[complex]) -> bool:
        """Whether the target, if it is there, is seen from `end` and can be walked to."""
        others = [flag - end for flag in flags]
        return is_seen(target - end, others) and way_past(target - end, others, WIDEST) is not None


def _look(end: complex, target: complex) -> float:
    """Turns to the left, after a walk to `end`, until the target comes into view."""
    bearing = cmath.phase((target - end) / end) + FIELD_OF_VIEW / 2
    return max(0.0, bearing % (2 * math.pi) - FIELD_OF_VIEW) / TURN
