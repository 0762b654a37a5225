"""Change points against mir_eval and SciPy's bipartite matching, and the cases where others go wrong."""

import warnings

import mir_eval
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from labellings import segmentations
from scipy.sparse import csr_array
from scipy.sparse.csgraph import maximum_bipartite_matching

from dpmacro.metrics import boundary_counts, boundary_scores, matched_boundaries, transitions

POINTS = st.sets(st.integers(0, 60), max_size=20).map(sorted)


def cut_at(points, length):
    """Labels of one trajectory that change at these points."""
    return np.searchsorted(np.array(points), np.arange(length), side="right")


def scores(found, true, tolerance, length=200):
    return boundary_scores(cut_at(found, length), cut_at(true, length), np.array([length]), tolerance)


def nearest_first(found, true, tolerance):
    """How many pairs there are if the nearest are paired first: what not to do."""
    pairs = sorted((abs(f - t), f, t) for f in found for t in true if abs(f - t) <= tolerance)
    taken = set()
    for _, f, t in pairs:
        if ("f", f) not in taken and ("t", t) not in taken:
            taken |= {("f", f), ("t", t)}
    return len(taken) // 2


def test_greedy_matching_would_count_too_few():
    assert scores([101, 104], [100, 105], 10) == (1.0, 1.0, 1.0)


def test_pairing_the_nearest_first_would_count_too_few():
    found, true = [12, 15], [10, 13]
    assert nearest_first(found, true, 2) == 1
    assert scores(found, true, 2) == (1.0, 1.0, 1.0)


def test_one_found_boundary_does_not_serve_two_true_ones():
    assert scores([101], [100, 102], 10) == (1.0, 0.5, pytest.approx(2 / 3))


def test_one_true_boundary_does_not_serve_two_found_ones():
    assert scores([100, 102], [101], 10) == (0.5, 1.0, pytest.approx(2 / 3))


@pytest.mark.parametrize(("found", "score"), [([], 1.0), ([100], 0.0), ([3, 100], 0.0)])
def test_truth_without_a_boundary(found, score):
    assert scores(found, [], 10) == (score, score, score)


def test_no_boundary_found():
    assert scores([], [100], 10) == (0.0, 0.0, 0.0)


@pytest.mark.parametrize(("tolerance", "score"), [(0, 0.0), (4, 0.0), (5, 1.0), (6, 1.0)])
def test_the_tolerance_is_inclusive(tolerance, score):
    assert scores([105], [100], tolerance) == scores([95], [100], tolerance) == (score, score, score)


def test_ends_of_trajectories_are_no_boundaries():
    labels, truth = np.array([0, 0, 1, 1]), np.array([0, 0, 0, 0])
    assert boundary_scores(labels, truth, np.array([2, 2]), 0) == (1.0, 1.0, 1.0)


def test_counts_are_pooled_and_trajectories_kept_apart():
    labels, truth = np.array([0, 0, 0, 1, 2, 2, 2, 2, 2]), np.array([0, 0, 1, 1, 2, 3, 3, 3, 3])
    # found 3 against true 2, then none against 1: a reach of 9 frames must not join the two
    assert boundary_scores(labels, truth, np.array([4, 5]), 9) == (1.0, 0.5, pytest.approx(2 / 3))


def test_a_negative_tolerance_is_named():
    with pytest.raises(ValueError, match="tolerance is -1"):
        scores([3], [3], -1)


def test_labels_and_truth_must_be_of_the_same_frames():
    with pytest.raises(ValueError, match="2 labels against 3"):
        boundary_scores(np.array([0, 1]), np.array([0, 1, 1]), np.array([2]), 1)


@settings(deadline=None, max_examples=300)
@given(POINTS, POINTS, st.integers(0, 12))
def test_the_sweep_is_a_maximum_matching(found, true, tolerance):
    hits = matched_boundaries(np.array(found, int), np.array(true, int), tolerance)
    assert hits == len(mir_eval.util.match_events(np.array(true), np.array(found), tolerance))
    if found and true:
        near = np.abs(np.subtract.outer(found, true)) <= tolerance
        assert hits == np.sum(maximum_bipartite_matching(csr_array(near)) >= 0)
    assert hits >= nearest_first(found, true, tolerance)


@settings(deadline=None, max_examples=300)
@given(segmentations(trajectories=1, longest=40), st.integers(0, 8))
def test_scores_of_a_trajectory_equal_mir_evals(case, tolerance):
    labels, truth, lengths = case
    points = [transitions(side, lengths)[0] for side in (truth, labels)]
    scores = boundary_scores(labels, truth, lengths, tolerance)
    if not any(map(len, points)):
        assert scores == (1.0, 1.0, 1.0)
        return
    edges = [np.array([0, *changes, lengths[0]]) for changes in points]
    intervals = [np.stack([edge[:-1], edge[1:]], 1) for edge in edges]
    with warnings.catch_warnings(action="ignore"):  # where one side has no change point
        expected = mir_eval.segment.detection(*intervals, window=tolerance, trim=True)
    assert scores == pytest.approx(expected)


def test_counts_are_pooled_over_trajectories():
    found = np.array([[0, 1, 1, 1, 1], [0, 0, 0, 0, 0], [1, 1, 1, 1, 0], [0, 1, 0, 1, 1]]).ravel()
    truth = np.array([[0, 0, 0, 1, 1], [0, 0, 1, 1, 1], [0, 0, 0, 1, 1], [0, 1, 0, 1, 0]]).ravel()
    lengths = np.array([5, 5, 5, 5])
    assert boundary_counts(found, truth, lengths, 1) == (4, 5, 7)
    assert boundary_counts(found, truth, lengths, 2) == (5, 5, 7)
    assert boundary_counts(truth, truth, lengths, 0) == (7, 7, 7)
