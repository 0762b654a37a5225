"""What tells success: the info, a sum of rewards, or the last reward."""

import numpy as np
import pytest

from dpmacro.worlds.base import WorldError
from dpmacro.worlds.success import SuccessRule


@pytest.mark.parametrize(
    ("given", "threshold", "info", "expected"),
    [
        (None, None, {"is_success": True, "success": False}, (True, 'info["is_success"]')),
        (None, None, {"success": np.array([1.0])}, (True, 'info["success"]')),
        (None, 9.0, {"success": 0.0}, (False, 'info["success"]')),
        (None, 9.0, {}, (False, "rewards of 9 or more in sum")),
        (None, 7.0, {}, (True, "rewards of 7 or more in sum")),
        (None, None, {}, (True, "a reward above 0 on the step that ends the run")),
        ("won", None, {"is_success": True, "won": False}, (False, 'info["won"]')),
        (6.5, None, {"is_success": False}, (True, "rewards of 6.5 or more in sum")),
        (8, 1.0, {}, (False, "rewards of 8 or more in sum")),
    ],
)
def test_the_first_sign_that_there_is_counts(given, threshold, info, expected):
    assert SuccessRule("Room-v0", given, threshold).judge(info, 2.0, 7.0, True) == expected


def test_a_last_reward_counts_where_the_world_ends_the_run():
    rule = SuccessRule("Room-v0")
    told = [rule.judge({}, reward, 5.0, ended)[0] for reward in (0.0, 1.0) for ended in (False, True)]
    assert told == [False, False, False, True]


def test_a_state_is_shown_to_be_successful_by_the_info_alone():
    rule = SuccessRule("Room-v0")
    assert [rule.shown(info) for info in ({}, {"success": 1}, {"is_success": False})] == [False, True, False]
    assert not SuccessRule("Room-v0", 3.0).shown({"is_success": True})
    assert not SuccessRule("Room-v0", "won").shown({})


@pytest.mark.parametrize(
    ("given", "info", "message"),
    [
        ("won", {"lost": 1}, "info of the world Room-v0 has no 'won' to tell success: it has lost; correct"),
        ("won", {}, "it has nothing"),
        (None, {"success": "yes"}, "has 'yes' as 'success': name what is true or false by --world.success="),
        (None, {"success": [1, 0]}, r"has \[1, 0\] as 'success'"),
    ],
)
def test_signs_that_cannot_be_read_are_refused(given, info, message):
    with pytest.raises(WorldError, match=message):
        SuccessRule("Room-v0", given).judge(info, 0.0, 0.0, True)
