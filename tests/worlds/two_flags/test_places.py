"""Walks among flags, as geometry: against what a walk in small steps meets."""

import cmath
import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from dpmacro.worlds.two_flags.places import (
    CLEAR,
    TOUCH,
    clear_ways,
    clearance,
    is_seen,
    turn_between,
    way_past,
)

angles = st.floats(-math.pi, math.pi)
places = st.builds(cmath.rect, st.floats(0.8, 12.0), angles)
flags = st.lists(places, max_size=4)


@given(places, flags)
def test_clearance_is_the_least_distance_on_the_way(end, flags):
    walk = np.linspace(0, 1, 2001)[:, None] * end
    along = [(flag * end.conjugate()).real for flag in flags]
    assume(all(abs(way) > 1e-6 for way in along))
    ahead = [flag for flag, way in zip(flags, along, strict=True) if way > 0]
    met = np.abs(walk - np.array(ahead, complex)).min() if ahead else math.inf
    assert clearance(end, flags) == pytest.approx(met, abs=4e-3)


@given(places, flags, st.floats(0, math.pi))
def test_a_way_is_clear_and_not_wider_than_it_may_be(target, flags, widest):
    way = way_past(target, flags, widest)
    if way is not None:
        assert abs(turn_between(cmath.phase(target), way)) <= widest + 1e-9
        assert clearance(cmath.rect(abs(target) - TOUCH, way), flags) >= CLEAR


@given(places, st.lists(places, min_size=1, max_size=3))
def test_where_nothing_is_in_the_way_it_is_straight(target, flags):
    if clearance(target, flags) >= CLEAR:
        assert way_past(target, flags, 1.0) == cmath.phase(target)


@given(places, flags, angles)
def test_ways_turn_and_mirror_with_the_places(target, flags, angle):
    way, turn = way_past(target, flags, 0.5), cmath.rect(1, angle)
    turned = way_past(target * turn, [flag * turn for flag in flags], 0.5)
    mirrored = way_past(target.conjugate(), [flag.conjugate() for flag in flags], 0.5)
    if way is not None and turned is not None and mirrored is not None:  # on the edge rounding decides
        off = abs(turn_between(cmath.phase(target), way))
        assert off == pytest.approx(abs(turn_between(cmath.phase(target * turn), turned)), abs=1e-6)
        assert off == pytest.approx(abs(turn_between(cmath.phase(target.conjugate()), mirrored)), abs=1e-6)


@pytest.mark.parametrize("aside", [0.2, -0.2])
def test_it_passes_a_flag_on_the_nearer_side(aside):
    way = way_past(8 + 0j, [complex(4, -aside)], 0.6)
    assert way is not None and math.copysign(1, way) == math.copysign(1, aside)
    assert way_past(8 + 0j, [complex(4, -aside)], 0.05) is None


@pytest.mark.parametrize(
    ("target", "flag", "seen"),
    [(6 + 0j, 3 + 0j, False), (6 + 0j, 3 + 1j, True), (3 + 0j, 6 + 0j, True), (6 + 0j, -3 + 0j, True)],
)
def test_a_flag_hides_what_is_behind_it(target, flag, seen):
    assert is_seen(target, [flag]) == seen and is_seen(target, [])


@given(angles, angles)
def test_turns_are_the_shorter_ones(one, other):
    turn = turn_between(one, other)
    assert -math.pi <= turn < math.pi
    assert cmath.rect(1, one + turn) == pytest.approx(cmath.rect(1, other))


def least_on_walks(start, flags):
    """The least distance to another flag, on walks of small steps from each flag to the next."""
    here, least = start, math.inf
    for place, flag in enumerate(flags):
        others = np.array([*flags[:place], *flags[place + 1 :]])
        way = (flag - here) / abs(flag - here)
        others = others[((others - here) / way).real > 0]  # those that the walk leads away from do not count
        walk = here + way * np.linspace(0, abs(flag - here), 2001)[:, None]
        least = min(least, np.abs(walk - others).min(initial=math.inf))
        here = flag - TOUCH * way
    return least


@given(places, st.lists(places, min_size=2, max_size=4, unique=True))
def test_ways_are_clear_where_walks_of_small_steps_keep_away_from_other_flags(start, flags):
    met = least_on_walks(start, flags)
    assume(abs(met - TOUCH - 0.25) > 5e-3)
    assert clear_ways(start, flags) == (met > TOUCH + 0.25)


def test_a_flag_that_was_touched_hides_the_next_behind_it():
    assert clear_ways(0j, [3 + 0j, 3j])
    assert not clear_ways(0j, [3 + 0j, 6 + 0j])
    assert not clear_ways(0j, [6 + 0j, 3 + 0.5j]), "red stands beside the way to blue"
