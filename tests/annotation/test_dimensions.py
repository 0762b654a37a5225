"""Which numbers of an action are worth drawing, where it is known by construction."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from segmented import random_demonstrations

from dpmacro.annotation.dimensions import SHOWN, action_lines, explained, grippers, standardised

LABELS = np.repeat([0, 1, 2], 40)


def noise(dims, seed=0):
    return np.random.default_rng(seed).normal(size=(len(LABELS), dims)).astype(np.float32)


def test_standardised_numbers_have_mean_0_and_deviation_1_or_are_0():
    actions = noise(4) * [1, 1e4, 1e-4, 0] + [0, 1e5, 3, 1e6]
    values = standardised(actions.astype(np.float32))
    assert values.mean(0) == pytest.approx(np.zeros(4), abs=1e-4)
    assert values.std(0) == pytest.approx([1, 1, 1, 0], abs=1e-3)


@given(st.integers(0, 1000))
def test_what_is_explained_is_the_variance_between_macro_actions(seed):
    rng = np.random.default_rng(seed)
    values, labels = standardised(noise(3, seed)), rng.integers(0, 4, len(LABELS))
    within = sum(((values[labels == q] - values[labels == q].mean(0)) ** 2).sum(0) for q in np.unique(labels))
    assert explained(values, labels) == pytest.approx(1 - within / len(labels), abs=1e-4)


def positions(*shares):
    """A number that is at 0, between, and at 1 for such shares of the frames, with some jitter."""
    rng = np.random.default_rng(0)
    counts = np.round(np.array(shares) * len(LABELS)).astype(int)
    at = np.concatenate([np.zeros(counts[0]), np.linspace(0.3, 0.7, counts[1]), np.ones(counts[2])])
    return at + rng.normal(size=len(at)) * 0.01


@pytest.mark.parametrize(
    ("columns", "names", "found"),
    [
        ([None, None], ("x", "Left_Gripper.pos"), [1]),
        ([None, positions(0.5, 0, 0.5)], ("finger_joint", "y"), [0]),
        ([None, positions(0.5, 0, 0.5)], ("x", "y"), [1]),
        ([None, positions(0.2, 0.1, 0.7)], ("x", "y"), [1]),
        ([None, positions(0.3, 0.4, 0.3)], ("x", "y"), []),
        ([None, positions(0.95, 0, 0.05)], ("x", "y"), []),
        ([positions(0.5, 0, 0.5)] * 2, ("x", "y"), [0, 1]),
        ([positions(0.5, 0, 0.5)] * 3, ("x", "y", "z"), []),
        ([None, np.zeros(len(LABELS))], ("x", "gripper"), []),
    ],
)
def test_a_gripper_is_known_by_its_name_or_its_two_positions(columns, names, found):
    values = noise(len(columns))
    for dim, column in enumerate(columns):
        if column is not None:
            values[:, dim] = column
    assert grippers(standardised(values), names) == found


def lines_of(actions, names):
    made = random_demonstrations(truth=False, vector=True)
    changed = {"actions": actions.astype(np.float32), "action_names": tuple(names)}
    changed |= {"observations": {}, "lengths": np.array([len(actions)])}
    return action_lines(type(made)(**{**vars(made), **changed}), LABELS)


def test_grippers_then_what_tells_macro_actions_apart_in_the_order_of_the_action():
    actions = noise(12)
    for dim in (1, 3, 4, 6, 8, 9, 10):
        actions[:, dim] += 3 * LABELS
    actions[:, 11] = 5
    lines = lines_of(actions, [*(f"joint_{k}" for k in range(2)), "gripper", *map(str, range(3, 12))])
    names = ["gripper", "joint_1", *(f"action {k}" for k in (3, 4, 6, 8, 9, 10))]
    assert [line.name for line in lines] == names and len(lines) == SHOWN
    assert [line.tall for line in lines] == [True] + [False] * 7
    np.testing.assert_allclose(lines[1].values, standardised(actions)[:, 1])


def test_many_fingers_leave_room_for_others():
    actions = noise(14)
    actions[:, [5, 7, 13]] += 2 * LABELS[:, None]
    lines = lines_of(actions, [*(f"finger_{k}" for k in range(13)), "wrist"])
    assert len(lines) == SHOWN and {"finger_5", "finger_7", "wrist"} <= {line.name for line in lines}
    assert [line.name for line in lines][:4] == sorted(
        (line.name for line in lines[:4]), key=lambda n: int(n[7:])
    )


def test_classes_have_no_dimensions():
    with pytest.raises(ValueError, match=r"^the actions of data/noise & more are classes"):
        action_lines(random_demonstrations(), LABELS)
