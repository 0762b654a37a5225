"""Geometry of walks among flags, as seen by the avatar.

A place is a complex number of metres: the avatar stands at 0 and looks along the real axis, its left is the
imaginary one. So `abs` is a place's distance, and `cmath.phase` its direction, radians, left positive.
"""

import cmath
import math
from collections.abc import Sequence

from dpmacro.worlds.two_flags.scene import AVATAR_RADIUS, FLAG_RADIUS

__all__ = ["CLEAR", "TOUCH", "clear_ways", "clearance", "is_seen", "turn_between", "way_past"]

TOUCH = AVATAR_RADIUS + FLAG_RADIUS
CLEAR, _PASSING = TOUCH + 0.05, TOUCH + 0.08  # what a straight walk needs, and what one round a flag keeps
_WAVERING = TOUCH + 0.25  # what a walk keeps that is straight but for noise and some degrees
_EDGE, _SHADOW = 0.9 * FLAG_RADIUS, 1.1 * FLAG_RADIUS


def clearance(end: complex, flags: Sequence[complex]) -> float:
    """The least distance, metres, to the middles of `flags` on a straight walk to `end`.

    Flags that the walk only leads away from do not count. Infinite where no flag counts.
    """
    length, least = abs(end), math.inf
    for flag in flags:
        beside = flag * cmath.rect(1, -cmath.phase(end))
        if beside.real > 0:
            least = min(least, abs(beside - min(beside.real, length)))
    return least


def clear_ways(start: complex, flags: Sequence[complex]) -> bool:
    """Whether straight walks from `start` to each of `flags` in turn come near no other, reached or not.

    Then each is seen as a whole from where the one before is touched, unless it is behind the avatar.
    """
    here = start
    for place, flag in enumerate(flags):
        others = [other - here for other in (*flags[:place], *flags[place + 1 :])]
        if clearance(flag - here, others) < _WAVERING:
            return False
        here = flag - cmath.rect(TOUCH, cmath.phase(flag - here))
    return True


def way_past(target: complex, flags: Sequence[complex], widest: float) -> float | None:
    """The direction of a straight walk towards `target`, or past those of `flags` that are in the way.

    None where there is none within `widest` radians of the target's own direction.
    """
    towards = cmath.phase(target)
    ways = [towards]
    for flag in flags:
        if abs(flag) > _PASSING:
            off = math.asin(_PASSING / abs(flag))
            ways += [cmath.phase(flag) + off, cmath.phase(flag) - off]
    length = abs(target) - TOUCH
    near = [way for way in ways if abs(turn_between(towards, way)) <= widest]
    clear = [way for way in near if clearance(cmath.rect(length, way), flags) >= CLEAR]
    return min(clear, key=lambda way: abs(turn_between(towards, way)), default=None)


def is_seen(target: complex, flags: Sequence[complex]) -> bool:
    """Whether `flags` leave an edge of the flag at `target` to be seen."""
    across = 1j * target / abs(target) * _EDGE
    return any(clearance(edge, flags) > _SHADOW for edge in (target - across, target + across))


def turn_between(one: float, other: float) -> float:
    """The angle from one direction to another, radians in [-pi, pi)."""
    return (other - one + math.pi) % (2 * math.pi) - math.pi
