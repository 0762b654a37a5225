from math import isnan

import numpy as np
import pytest
from scipy.optimize import linear_sum_assignment

from dpmacro.metrics import (
    boundary_offsets,
    frame_accuracy,
    match_labels,
    success_summary,
    transitions,
    wilson_interval,
)


@pytest.mark.parametrize(
    ("successes", "runs", "low", "high"),
    [  # tables of Newcombe 1998 and R's prop.test(correct=FALSE)
        (81, 263, 0.2553, 0.3662),
        (15, 148, 0.0624, 0.1605),
        (0, 20, 0.0, 0.1611),
        (1, 29, 0.0061, 0.1718),
        (29, 29, 0.8830, 1.0),
    ],
)
def test_wilson_interval_agrees_with_published_values(successes, runs, low, high):
    assert wilson_interval(successes, runs) == pytest.approx((low, high), abs=6e-5)


def test_a_higher_confidence_gives_a_wider_interval():
    low, high = wilson_interval(5, 10, confidence=0.99)
    assert low < wilson_interval(5, 10)[0] and high > wilson_interval(5, 10)[1]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [((0, 0), "0 of 0"), ((3, 2), "3 of 2"), ((-1, 2), "-1 of 2"), ((1, 2, 1.0), "confidence is 1.0")],
)
def test_wilson_interval_names_what_is_wrong(arguments, message):
    with pytest.raises(ValueError, match=message):
        wilson_interval(*arguments)


@pytest.mark.parametrize(
    ("labels", "truth", "accuracy", "truth_of"),
    [
        ([0, 0, 1, 1], [0, 0, 1, 1], 1.0, {0: 0, 1: 1}),
        ([1, 1, 0, 0], [0, 0, 1, 1], 1.0, {0: 1, 1: 0}),
        ([0, 0, 0, 0], [0, 0, 0, 1], 0.75, {0: 0}),
        ([0, 0, 1, 2, 2], [5, 5, 5, 7, 7], 0.8, {0: 5, 2: 7}),
        ([3, 3, 3, 3, 9, 9], [0, 0, 1, 2, 2, 1], 0.5, None),
        # the greedy choice (0 with 0, three frames) leaves label 1 with nothing
        ([0, 0, 0, 0, 0, 1, 1], [0, 0, 0, 1, 1, 0, 0], 4 / 7, {0: 1, 1: 0}),
    ],
)
def test_labels_are_matched_to_truth_one_to_one(labels, truth, accuracy, truth_of):
    matching = match_labels(np.array(labels), np.array(truth))
    assert matching.accuracy == pytest.approx(accuracy)
    if truth_of is not None:
        assert matching.truth_of == truth_of


@pytest.mark.parametrize(("labels", "classes"), [(1, 4), (2, 2), (3, 7), (8, 8), (30, 3), (3, 30)])
def test_matching_is_as_good_as_the_hungarian_algorithm(labels, classes):
    rng = np.random.default_rng(labels * 100 + classes)
    for _ in range(5):
        found, truth = rng.integers(labels, size=400), rng.integers(classes, size=400)
        counts = np.zeros((labels, classes), int)
        np.add.at(counts, (found, truth), 1)
        expected = counts[linear_sum_assignment(counts, maximize=True)].sum() / 400
        matching = match_labels(found, truth)
        assert matching.accuracy == frame_accuracy(found, truth) == pytest.approx(expected)
        assert len(set(matching.truth_of.values())) == len(matching.truth_of)


@pytest.mark.parametrize(
    ("labels", "truth", "message"),
    [
        ([], [], "0 labels against 0"),
        ([0, 1], [0], "2 labels against 1"),
        (list(range(13)), list(range(13)), "13 labels against 13 true classes"),
    ],
)
def test_matching_names_what_is_wrong(labels, truth, message):
    with pytest.raises(ValueError, match=message):
        match_labels(np.array(labels, int), np.array(truth, int))


def test_transitions_do_not_cross_trajectories():
    found = transitions(np.array([0, 0, 1, 1, 0, 0, 0, 2, 0]), np.array([4, 2, 3]))
    assert [points.tolist() for points in found] == [[2], [], [1, 2]]


@pytest.mark.parametrize("lengths", [[], [2], [2, 0, 1], [4]])
def test_lengths_must_add_up(lengths):
    with pytest.raises(ValueError, match="add up to the 3 labels"):
        transitions(np.array([0, 0, 1]), np.array(lengths, int))


def test_boundary_offsets_compare_single_transitions_only():
    found = np.array([[0, 1, 1, 1, 1], [0, 0, 0, 0, 0], [1, 1, 1, 1, 0], [0, 0, 0, 1, 1]]).ravel()
    truth = np.array([[0, 0, 0, 1, 1], [0, 0, 1, 1, 1], [0, 0, 0, 1, 1], [0, 1, 0, 1, 1]]).ravel()
    result = boundary_offsets(found, truth, np.array([5, 5, 5, 5]))
    assert result.offsets.tolist() == [2, 1]
    assert (result.median, result.trajectories) == (1.5, 4)
    assert isnan(boundary_offsets(truth[:2], truth[:2], np.array([2])).median)


def test_success_summary_splits_failures():
    summary = success_summary(
        ["success", "red_first", "red_never_reached", "red_first"], [1, 0, 1, 0], [1, 0, 0, 0]
    )
    assert (summary.successes, summary.runs, summary.rate) == (1, 4, 0.25)
    assert summary.interval == wilson_interval(1, 4)
    assert list(summary.endings.items()) == [(("red_first", 0, 0), 2), (("red_never_reached", 1, 0), 1)]


@pytest.mark.parametrize("arguments", [([], [], []), (["success"], [1], []), (["success"], [], [0])])
def test_success_summary_needs_complete_runs(arguments):
    with pytest.raises(ValueError, match=r"0 of 0|every run needs one of each"):
        success_summary(*arguments)


def test_the_interval_holds_the_rate_itself():
    for runs in range(1, 60):
        for successes in range(runs + 1):
            low, high = wilson_interval(successes, runs)
            assert 0 <= low <= successes / runs <= high <= 1
