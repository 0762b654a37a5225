"""The threshold of a switch function, from scores made by hand."""

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from dpmacro.switching.functions import macro_segments
from dpmacro.switching.threshold import calibrated

PAIR = (0, 1)


def threshold(parts, pair=PAIR):
    """`parts`: for each trajectory the scores before its change, and those from the change on."""
    labels = [label for before, after in parts for label in [0] * len(before) + [1] * len(after)]
    lengths = torch.tensor([len(before) + len(after) for before, after in parts])
    scores = torch.tensor([float(score) for part in parts for side in part for score in side])
    return calibrated(pair, macro_segments(torch.tensor(labels), lengths), scores)


@pytest.mark.parametrize(
    ("parts", "expected"),
    [
        ([([-3, 1], [5])], (3.0, 1.0)),
        ([([1, -3], [5])], (3.0, 1.0)),  # the highest score before counts, wherever it is
        ([([0], [4]), ([2], [8])], (3.0, 1.0)),  # what serves both
        ([([0], [4]), ([6], [14])], (10.0, 0.5)),  # the wider of two ranges as good
        ([([0], [10]), ([12], [14])], (5.0, 0.5)),
        ([([0], [4]), ([1], [5]), ([9], [8])], (2.5, 2 / 3)),  # the third cannot be served
        ([([3], [1])], (0.0, 0.0)),
        ([([2], [2])], (0.0, 0.0)),  # at the change and before alike
        ([([3], [1, 9, 9])], (0.0, 0.0)),  # only the first frame of a change counts
        ([([0], [4, -9])], (2.0, 1.0)),
        ([([0, 0], [4]), ([7], [])], (2.0, 1.0)),  # a trajectory without the change has no say
    ],
)
def test_the_threshold_serves_most_segments(parts, expected):
    assert threshold(parts) == pytest.approx(expected)


@settings(deadline=None)
@given(
    st.lists(
        st.tuples(
            st.lists(st.integers(-5, 5), min_size=1, max_size=4),
            st.lists(st.integers(-5, 5), min_size=1, max_size=3),
        ),
        min_size=1,
        max_size=6,
    )
)
def test_no_other_threshold_serves_more(parts):
    def served(at):
        return sum(max(before) <= at < after[0] for before, after in parts) / len(parts)

    found, share = threshold(parts)
    best = max(served(level / 2) for level in range(-12, 13))
    assert share == pytest.approx(best)
    if share:
        assert served(found) == pytest.approx(share)
