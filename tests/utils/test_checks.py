"""Arguments: what is let through and as what, and the one line that refuses the rest."""

import numpy as np
import pytest
import torch

from dpmacro.utils.checks import as_count, as_flag, as_number, shown
from dpmacro.utils.tensors import as_lengths, as_tensor, as_whole_vector

VALUES = torch.tensor([[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]])
FROZEN = VALUES.numpy().copy()
FROZEN.flags.writeable = False


@pytest.mark.parametrize("value", [1, np.int64(5), np.uint8(7), 9])
def test_a_count_may_be_any_whole_number(value):
    assert as_count("macros", value, 1, 9) == value and type(as_count("macros", value)) is int


@pytest.mark.parametrize(
    ("value", "line"),
    [
        (0, "macros is 0: give 1 or more"),
        (10, "macros is 10: give 9 or less"),
        (2.0, "macros is 2.0: give a whole number, 1 or more"),
        ("2", "macros is '2': give a whole number, 1 or more"),
        (None, "macros is None: give a whole number, 1 or more"),
        (True, "macros is True: give a whole number, 1 or more"),
        (np.True_, "macros is np.True_: give a whole number, 1 or more"),
        (torch.tensor(2), "macros is tensor(2): give a whole number, 1 or more"),
    ],
)
def test_what_is_no_count_is_refused(value, line):
    with pytest.raises(ValueError) as caught:
        as_count("macros", value, 1, 9)
    assert str(caught.value) == line


@pytest.mark.parametrize("value", [True, False, np.True_])
def test_a_flag_is_true_or_false(value):
    assert as_flag("early_stopping", value) is bool(value)


@pytest.mark.parametrize("value", ["no", 0, 1, None, torch.tensor(True)])
def test_what_is_no_flag_is_refused(value):
    with pytest.raises(ValueError, match=r"^early_stopping is .*: give True or False$"):
        as_flag("early_stopping", value)


@pytest.mark.parametrize("value", [1, 0.5, np.float32(0.25), np.int64(1)])
def test_a_number_may_be_of_any_real_type(value):
    assert as_number("shrinkage", value, above=0.0, most=1.0) == value


@pytest.mark.parametrize(
    "value", [0, -1, 1.01, "1", None, True, float("nan"), float("inf"), 1j, pytest.param(10**400, id="huge")]
)
def test_what_is_no_number_is_refused(value):
    with pytest.raises(ValueError, match=r"^shrinkage is .*: give a finite number above 0 and up to 1$"):
        as_number("shrinkage", value, above=0.0, most=1.0)


def test_the_least_number_is_let_through():
    assert as_number("weight", 0, least=0.0) == 0.0
    with pytest.raises(ValueError, match=r"^weight is -1: give a finite number of 0 or more$"):
        as_number("weight", -1, least=0.0)


@pytest.mark.parametrize(
    "value",
    [
        VALUES,
        VALUES.tolist(),
        VALUES.numpy(),
        VALUES.numpy().astype(object),
        VALUES.numpy().astype(">f4"),
        VALUES.numpy().astype(np.longdouble),
        VALUES.numpy().astype(np.uint16),
        VALUES.numpy()[::-1].copy()[::-1],
        np.asfortranarray(VALUES.numpy()),
        FROZEN,
        VALUES.bfloat16(),
        VALUES.half(),
        VALUES.to(torch.float8_e4m3fn),
        VALUES.to(torch.uint16),
        VALUES.clone().requires_grad_(),
        VALUES.T.contiguous().T,
    ],
)
@pytest.mark.filterwarnings("error")
def test_all_that_holds_real_numbers_becomes_a_tensor(value):
    found = as_tensor("features", value, 2, "[frames, columns]")
    assert torch.equal(found.double(), VALUES.double()) and not found.requires_grad
    found.sort(0), found.abs(), found.gather(0, torch.zeros(1, 2, dtype=torch.int64))  # has the operations


@pytest.mark.parametrize(
    "value",
    [
        "abc",
        None,
        3,
        {"a": 1},
        VALUES[0],
        VALUES[:0],
        VALUES[:, :0],
        VALUES.to_sparse(),
        VALUES + 0j,
        VALUES.numpy() + 0j,
        VALUES.to("meta"),
        VALUES.numpy().astype(str),
        np.array([["a", 1], [2, 3]], object),
        np.full((3, 2), 2**64 - 1, np.uint64),
        np.ma.masked_greater(VALUES.numpy(), 3),
        np.zeros((3, 2), "datetime64[s]"),
        [[1, 2], [3]],
        [[2**70]],
    ],
)
def test_all_else_is_refused_in_a_line(value):
    with pytest.raises(ValueError, match=r"^features .*: .*\[frames, columns\]$") as caught:
        as_tensor("features", value, 2, "[frames, columns]")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "value", [[0, 3], [0.0, 3.0], np.array([0, 3], np.uint8), torch.tensor([0.0, 3.0]).bfloat16()]
)
def test_whole_numbers_may_be_of_any_type(value):
    found = as_whole_vector("actions", value, "[frames]", least=0, most=3)
    assert found.dtype == torch.int64 and found.tolist() == [0, 3]


@pytest.mark.parametrize(
    ("value", "line"),
    [
        ([0, 1.5], "actions[1] is 1.5: give whole numbers, [frames]"),
        ([0, float("nan")], "actions[1] is nan: give whole numbers, [frames]"),
        ([0, 1e300], "actions[1] is 1e+300: give whole numbers, [frames]"),
        ([0, -1], "actions[1] is -1: give 0 to 3"),
        ([4, 0], "actions[0] is 4: give 0 to 3"),
        ([[0], [1]], "actions have shape [2, 1]: give [frames]"),
    ],
)
def test_other_numbers_are_named_with_their_place(value, line):
    with pytest.raises(ValueError) as caught:
        as_whole_vector("actions", value, "[frames]", least=0, most=3)
    assert str(caught.value) == line


def test_lengths_add_up_to_the_frames():
    assert as_lengths([2, 3], 5, "features").tolist() == [2, 3]
    for lengths, message in (
        ([2, 4], "^lengths add up to 6 frames but features have 5: make them agree$"),
        ([5, 0], r"^lengths\[1\] is 0: give 1 or more$"),
        ([2**63 - 1, 2**63 - 1, 7], "^lengths add up to 18446744073709551621"),  # 5 in 64 bits
    ):
        with pytest.raises(ValueError, match=message):
            as_lengths(lengths, 5, "features")


def test_what_is_shown_is_a_short_line():
    assert shown("a") == "'a'"
    assert shown(10**5000) == "int of too many digits"  # which Python refuses to print
    assert shown(torch.arange(1000.0).reshape(10, 100)).startswith("tensor([[")
    assert len(shown(np.zeros((9, 9)))) == 60 and "\n" not in shown(np.zeros((9, 9)))
