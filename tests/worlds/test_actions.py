"""Actions handed to worlds: classes counted from the world's first, vectors clipped."""

import numpy as np
import pytest
from gymnasium.spaces import Box, Discrete, MultiDiscrete
from hypothesis import given
from hypothesis import strategies as st

from dpmacro.worlds.actions import ActionMap
from dpmacro.worlds.base import WorldError

ARM = Box(np.array([-1, 0], np.float32), np.array([1, 2], np.float32))


@given(st.lists(st.floats(-5, 5, width=32), min_size=2, max_size=2))
def test_vectors_come_out_within_the_box_and_say_whether_they_were_not(numbers):
    action, clipped = ActionMap.fit("Room-v0", ARM, dims=2).of(np.array(numbers, np.float32), "")
    assert ARM.contains(action) and action.dtype == np.float32
    assert clipped == (not ARM.contains(np.array(numbers, np.float32)))
    if not clipped:
        assert action.tolist() == numbers


def test_whole_numbers_are_rounded_for_a_box_of_them():
    action, clipped = ActionMap.fit("Room-v0", Box(0, 3, (2,), np.int64)).of(np.array([0.6, 3.4]), "")
    assert action.tolist() == [1, 3] and action.dtype == np.int64 and not clipped


def test_classes_of_a_policy_count_from_the_first_of_the_world():
    space = Discrete(3, start=5)
    assert ActionMap.fit("Room-v0", space, classes=3).of(np.int64(1), "") == (6, False)
    assert ActionMap.fit("Room-v0", space).of(6, "") == (6, False), "an expert knows the world's own"


@pytest.mark.parametrize(
    ("space", "given", "message"),
    [
        (ARM, {"classes": 3}, "takes vectors of 2 numbers, and the policy gives one of 3 actions"),
        (ARM, {"dims": 4}, "takes vectors of 2 numbers, and the policy gives vectors of 4 numbers"),
        (Discrete(3), {"dims": 4}, "takes one of 3 actions, and the policy gives vectors of 4 numbers"),
        (Discrete(3), {"classes": 7}, "takes one of 3 actions, and the policy gives one of 7 actions"),
        (
            MultiDiscrete([2, 2]),
            {"classes": 2},
            r"takes actions of MultiDiscrete\(\[2 2\]\), and policies give",
        ),
        (Box(0, 1, (2, 2)), {}, r"takes actions of Box\(0.0, 1.0, \(2, 2\), float32\)"),
    ],
)
def test_spaces_that_do_not_fit_are_refused_in_one_line(space, given, message):
    with pytest.raises(WorldError, match=message) as refused:
        ActionMap.fit("Room-v0", space, **given)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("action", [[0.0], [0.0, np.nan], [[0.0, 0.0]], 1])
def test_an_action_that_is_none_is_refused(action):
    with pytest.raises(WorldError, match=r"the action .* at step 3 is none that the world Room-v0 takes"):
        ActionMap.fit("Room-v0", ARM).of(action, "at step 3")
