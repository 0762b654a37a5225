"""All scores together: what holds whatever the labels are called, and one case by hand."""

from dataclasses import asdict

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from labellings import NAMES, segmentations

from dpmacro.metrics import SegmentationScores, segmentation_scores

SCORES = [field for field in SegmentationScores.__annotations__ if "segments" not in field]


def test_scores_by_hand():
    labels = np.array([4, 4, 4, 4, 4, 4, 9, 9, 9, 9, 4, 4, 9, 9, 9])
    truth = np.array([0, 0, 0, 0, 1, 1, 1, 1, 1, 1, 0, 1, 0, 1, 1])
    result = segmentation_scores(labels, truth, np.array([10, 5]), tolerance=1)
    assert result.accuracy == pytest.approx(11 / 15)
    assert result.edit == pytest.approx((1 + 2 / 4) / 2)
    # shares 4/6, 4/6 | 1/2, 2/3
    assert (result.f1_10, result.f1_25, result.f1_50) == pytest.approx((8 / 10,) * 3)
    # found 6 | 2, true 4 | 1, 2, 3
    assert (result.precision, result.recall, result.boundary_f1) == pytest.approx((1 / 2, 1 / 4, 1 / 3))
    assert (result.segments, result.true_segments) == (4, 6)


@settings(deadline=None)
@given(segmentations(), st.permutations(NAMES))
def test_truth_under_other_names_has_every_score(case, renamed):
    _, truth, lengths = case
    labels = np.array([renamed[NAMES.index(name)] for name in truth])
    result = segmentation_scores(labels, truth, lengths, tolerance=0)
    assert {name: getattr(result, name) for name in SCORES} == pytest.approx(dict.fromkeys(SCORES, 1.0))
    assert result.segments == result.true_segments


@settings(deadline=None)
@given(segmentations(), st.permutations(NAMES), st.permutations(NAMES))
def test_no_score_depends_on_names(case, names, classes):
    labels, truth, lengths = case
    result = segmentation_scores(labels, truth, lengths, tolerance=1)
    renamed = [
        np.array([new[NAMES.index(name)] for name in side])
        for side, new in ((labels, names), (truth, classes))
    ]
    again = segmentation_scores(*renamed, lengths, tolerance=1)
    assert asdict(again) == pytest.approx(asdict(result), abs=1e-12)


@settings(deadline=None)
@given(segmentations())
def test_scores_keep_their_range(case):
    result = segmentation_scores(*case)
    for name in SCORES:
        assert (-0.5 if name == "ari" else 0) <= getattr(result, name) <= 1, name
    assert result.f1_10 >= result.f1_25 >= result.f1_50


def test_an_unmatched_label_never_equals_a_class_of_its_name():
    labels, truth = np.array([5, 5, 5, 7]), np.array([7, 7, 7, 7])
    result = segmentation_scores(labels, truth, np.array([4]))
    assert (result.accuracy, result.edit, result.f1_10) == pytest.approx((3 / 4, 1 / 2, 2 / 3))


def test_overlaps_of_exactly_10_25_and_50_percent_are_hits():
    shares = np.array([9, 10, 25, 50])
    labels = np.concatenate([np.repeat([0, 1 + n], [share, 100 - share]) for n, share in enumerate(shares)])
    result = segmentation_scores(labels, np.zeros(400, int), np.full(4, 100))
    assert (result.f1_10, result.f1_25, result.f1_50) == pytest.approx((6 / 12, 4 / 12, 2 / 12))


def test_labels_are_matched_over_the_whole_dataset():
    labels, truth = np.array([0, 0, 1, 1, 1, 1, 0]), np.array([0, 0, 1, 1, 0, 0, 1])
    result = segmentation_scores(labels, truth, np.array([4, 3]))
    assert (result.accuracy, result.edit, result.boundary_f1) == pytest.approx((4 / 7, 1 / 2, 1))


def test_the_tolerance_is_in_frames():
    labels, truth = np.repeat([0, 1], [30, 30]), np.repeat([0, 1], [40, 20])
    assert segmentation_scores(labels, truth, np.array([60])).boundary_f1 == 1
    assert segmentation_scores(labels, truth, np.array([60]), tolerance=9).boundary_f1 == 0


@pytest.mark.parametrize(
    ("labels", "truth", "lengths", "tolerance", "message"),
    [
        ([], [], [], 10, "0 labels against 0"),
        ([0, 1], [0], [2], 10, "2 labels against 1"),
        ([0, 1], [0, 1], [1], 10, "add up to the 2 labels"),
        ([0, 1], [0, 1], [2], -3, "tolerance is -3"),
    ],
)
def test_mistakes_are_named(labels, truth, lengths, tolerance, message):
    with pytest.raises(ValueError, match=message):
        segmentation_scores(np.array(labels, int), np.array(truth, int), np.array(lengths, int), tolerance)
