"""The threshold of a switch function, from scores made by hand."""

import math

import pytest
import torch
from hypothesis import example, given, settings
from hypothesis import strategies as st

from dpmacro.segmentation.segments import macro_segments
from dpmacro.switching.threshold import best_threshold, recognised_share

PARTS = st.lists(
    st.tuples(
        st.lists(st.integers(-5, 5), min_size=1, max_size=4),
        st.lists(st.integers(-5, 5), min_size=1, max_size=3),
    ),
    min_size=1,
    max_size=6,
)


def changes_of(parts, others=()):
    """The segments that end in a change, those that do not, and the scores of all.

    `parts`: for each trajectory the scores before its change, and those from the change on; `others` alike,
    with another change.
    """
    labels = [label for before, after in parts for label in [0] * len(before) + [1] * len(after)]
    labels += [label for before, after in others for label in [0] * len(before) + [2] * len(after)]
    parts = [*parts, *others]
    lengths = torch.tensor([len(before) + len(after) for before, after in parts])
    scores = torch.tensor([float(score) for part in parts for side in part for score in side])
    segments = [one for one in macro_segments(torch.tensor(labels), lengths) if one.macro == 0]
    ends = [[one for one in segments if (one.following == 1) == wanted] for wanted in (True, False)]
    return *ends, scores


def found(parts, tolerance=0):
    """The threshold, and the share that is recognised under it."""
    segments, _, scores = changes_of(parts)
    threshold = best_threshold(segments, scores, tolerance)
    return threshold, recognised_share(segments, scores - threshold, tolerance)


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
    assert found(parts) == pytest.approx(expected)


@settings(deadline=None)
@given(PARTS)
def test_no_other_threshold_serves_more(parts):
    def served(at):
        return sum(max(before) <= at < after[0] for before, after in parts) / len(parts)

    threshold, share = found(parts)
    best = max(served(level / 2) for level in range(-12, 13))
    assert share == pytest.approx(best)
    if share:
        assert served(threshold) == pytest.approx(share)


@settings(deadline=None)
@example([([0, 0], [0, 5])], 1)  # late
@example([([0, 0, 5], [0])], 1)  # early
@given(PARTS, st.integers(0, 4))
def test_a_change_within_the_tolerance_is_in_time(parts, tolerance):
    def served(at):
        hits = 0
        for before, after in parts:
            far, near = before[: max(len(before) - tolerance, 0)], before[max(len(before) - tolerance, 0) :]
            hits += max(far, default=-99) <= at < max([*near, *after[: tolerance + 1]])
        return hits / len(parts)

    threshold, share = found(parts, tolerance)
    assert served(threshold) == pytest.approx(share)
    # A segment with nothing before it is in time at any threshold far enough down.
    if all(len(before) > tolerance for before, _ in parts):
        assert share == pytest.approx(max(served(level / 2) for level in range(-12, 13)))


@pytest.mark.parametrize(
    ("parts", "expected"),
    [
        ([([0, 0, 6], [10])], 8.0),  # both 3 and 8 are in time within a frame, 8 at the very one
        ([([0, 0, 6], [10]), ([0, 0, 4], [9])], 7.5),
        ([([0, 0, 6], [10]), ([0, 0, 9], [7])], 7.5),  # one of two at its frame
        ([([0, 0, 6], [5])], 3.0),  # never at its frame: any that is in time
    ],
)
def test_of_thresholds_that_serve_as_many_the_one_at_the_very_frames_wins(parts, expected):
    segments, _, scores = changes_of(parts)
    assert best_threshold(segments, scores, 1) == expected


@pytest.mark.parametrize(
    ("parts", "others", "expected"),
    [
        ([([0], [4])], [([3], [9])], 2.0),  # the other has no say: it is no majority
        ([([0], [4])], [([5], [0]), ([-1], [0])], math.inf),  # one at its time, and one too early
        ([([0], [4])], [([1], []), ([-1], [])], 2.0),  # those that end with their trajectory, likewise
        ([([0], [4])], [([1], [9]), ([-1], [9])], 2.0),  # what they have once they ended does not count
        ([([0], [4]), ([0], [4])], [([5], [0]), ([-1], [0]), ([-1], [0])], 2.0),  # two at their time
        ([([3], [1])], [([0], [0]), ([0], [0])], math.inf),  # it never comes in time
        ([([3], [1])], [([0], [0])], 0.0),
    ],
)
def test_a_rare_change_is_never_made_where_that_is_as_good(parts, others, expected):
    segments, rest, scores = changes_of(parts, others)
    assert best_threshold(segments, scores, others=rest) == expected


@settings(deadline=None)
@given(PARTS, st.lists(PARTS.map(lambda parts: parts[0]), max_size=8), st.integers(0, 2))
def test_never_is_worth_no_less_than_the_threshold(parts, others, tolerance):
    segments, rest, scores = changes_of(parts, others)
    without = best_threshold(segments, scores, tolerance)
    right = round(recognised_share(segments, scores - without, tolerance) * len(segments))
    right += sum(max(before) <= without for before, _ in others)
    never = len(parts) < len(others) and right <= len(others)
    assert best_threshold(segments, scores, tolerance, rest) == (math.inf if never else without)


def test_without_segments_the_decision_boundary_stands():
    assert best_threshold([], torch.tensor([1.0, 2.0])) == 0.0


@settings(deadline=None)
@given(PARTS)
def test_the_recognised_share_is_of_changes_seen_at_once_and_not_before(parts):
    segments, _, margins = changes_of(parts)
    wanted = sum(max(before) <= 0 < after[0] for before, after in parts) / len(parts)
    assert recognised_share(segments, margins) == pytest.approx(wanted)
    barred = margins.clone()
    barred[[one.stop for one in segments]] = -torch.inf
    assert recognised_share(segments, barred) == 0
