"""What was drawn accounts for every action, within the bounds that were asked for."""

import sys
from dataclasses import fields

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sklearn.datasets import load_digits

from dpmacro.data.synthetic import RULES, Digits, digits, two_rules

ACTION_1 = ({1, 3, 5, 7, 9}, {5, 6, 7, 8, 9}, {0, 3, 6, 9}, {0, 1, 4, 5, 8, 9})  # of the rules, by hand


@st.composite
def arguments(draw):
    rule_count = draw(st.integers(2, len(RULES)))
    segments = draw(st.integers(rule_count, 30))
    return {
        "rule_count": rule_count,
        "seed": draw(st.integers(0, 2**32)),
        "segments": segments,
        "min_segment": draw(st.integers(1, 1797 // segments)),
        "trajectories": draw(st.integers(1, 1797 // 2)),
    }


@settings(deadline=None)
@given(arguments())
def test_the_truth_accounts_for_the_actions_within_the_bounds(given):
    drawn = digits(**given)
    wanted = [int(digit in ACTION_1[rule]) for digit, rule in zip(drawn.digits, drawn.truth, strict=True)]
    assert drawn.actions.tolist() == wanted
    changes = np.flatnonzero(np.diff(drawn.truth)) + 1
    assert len(changes) == given["segments"] - 1
    assert np.diff([0, *changes, 1797]).min() >= given["min_segment"]
    assert set(drawn.truth) == set(range(given["rule_count"]))
    assert len(drawn.lengths) == given["trajectories"] and drawn.lengths.sum() == 1797
    assert drawn.lengths.max() - drawn.lengths.min() <= 1 and drawn.lengths.min() >= 2


def test_every_digit_comes_once_with_its_own_pixels():
    drawn, data = digits(2, 0), load_digits()
    ours = np.column_stack([drawn.features, drawn.digits])
    theirs = np.column_stack([data.data, data.target]).astype(int)
    assert sorted(map(tuple, ours.tolist())) == sorted(map(tuple, theirs.tolist()))
    assert ours.tolist() != theirs.tolist()


def same(one: Digits, other: Digits) -> list[bool]:
    return [np.array_equal(getattr(one, field.name), getattr(other, field.name)) for field in fields(one)]


def test_a_seed_repeats_the_draw_and_another_changes_it():
    state = np.random.get_state()[1].copy()  # noqa: NPY002  the global state is what must stay
    first = digits(3, 5)
    assert all(same(first, digits(3, 5)))
    names = [field.name for field in fields(first)]
    differ = [name for name, equal in zip(names, same(first, digits(3, 6)), strict=True) if not equal]
    assert differ == [name for name in names if name != "lengths"]
    assert np.array_equal(state, np.random.get_state()[1])  # noqa: NPY002


def test_change_points_are_spread_evenly():
    """With two segments the one change is uniform from 45 to 1752: a mean of 200 is within 5 sigma."""
    at = np.array([np.flatnonzero(np.diff(digits(2, seed, segments=2).truth))[0] + 1 for seed in range(200)])
    sigma = (1752 - 45) / np.sqrt(12 * 200)
    assert abs(at.mean() - 1797 / 2) < 5 * sigma
    assert at.min() < 200 and at.max() > 1600


def test_where_nothing_is_left_over_the_segments_are_equal():
    drawn = digits(2, 0, segments=3, min_segment=599)
    assert (np.flatnonzero(np.diff(drawn.truth)) + 1).tolist() == [599, 1198]


@pytest.mark.parametrize("rule_count", [2, 3, 4])
def test_by_default_there_are_twice_as_many_segments_as_rules(rule_count):
    drawn = digits(rule_count, 1)
    assert (np.diff(drawn.truth) != 0).sum() == 2 * rule_count - 1
    assert drawn.lengths.tolist() == [1797]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"rule_count": 1}, "rule_count is 1: give 2 to 4"),
        ({"rule_count": 5}, "rule_count is 5: give 2 to 4"),
        ({"seed": -1}, "seed is -1: give 0 or more"),
        ({"segments": 1}, "segments is 1: give 2 to 1797"),
        ({"min_segment": 0}, "min_segment is 0: give 1 to 449"),
        ({"segments": 30, "min_segment": 60}, "min_segment is 60: give 1 to 59"),
        ({"trajectories": 899}, "trajectories is 899: give 1 to 898"),
    ],
)
def test_what_cannot_be_drawn_is_refused(options, message):
    with pytest.raises(ValueError, match=message):
        digits(**({"rule_count": 2, "seed": 0} | options))


def test_without_scikit_learn_the_remedy_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "sklearn.datasets", None)
    with pytest.raises(ValueError, match="pip install scikit-learn"):
        digits(2, 0)


@pytest.mark.parametrize(("trajectories", "length"), [(1, 8), (5, 9), (20, 80)])
def test_two_rules_account_for_the_actions(trajectories, length):
    drawn = two_rules(trajectories, length, seed=3)
    assert drawn.features.shape == (trajectories * length, 6) and drawn.features.dtype == np.float32
    assert drawn.lengths.tolist() == [length] * trajectories
    for n, (features, rule) in enumerate(zip(drawn.features, drawn.truth, strict=True)):
        assert drawn.actions[n] == (features[1 + rule] > 0)
    for labels in drawn.truth.reshape(trajectories, length):
        (change,) = np.flatnonzero(np.diff(labels)) + 1
        assert labels[0] == 0 and length // 4 <= change < length - length // 4


def test_the_change_of_two_rules_can_be_seen():
    drawn = two_rules(200, 20, seed=1)
    signal, truth = drawn.features[:, 0].reshape(200, 20), drawn.truth.reshape(200, 20)
    shown = np.take_along_axis(signal, truth.argmax(1)[:, None] + np.arange(3), 1)
    assert abs(shown.mean() - 6) < 0.3
    assert abs((signal.sum() - shown.sum()) / (200 * 17)) < 0.1
    assert abs(drawn.features[:, 1:].mean()) < 0.1


def test_the_seed_of_two_rules_repeats_them():
    first, same, other = two_rules(seed=4), two_rules(seed=4), two_rules(seed=5)
    assert all(np.array_equal(value, vars(same)[name]) for name, value in vars(first).items())
    assert not np.array_equal(first.features, other.features)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"trajectories": 0}, "trajectories is 0: give 1 or more"),
        ({"length": 7}, "length is 7: give 8 or more"),
        ({"seed": -1}, "seed is -1: give 0 or more"),
    ],
)
def test_rules_that_cannot_be_drawn_are_refused(options, message):
    with pytest.raises(ValueError, match=message):
        two_rules(**options)
