"""Matching against enumeration, NMI and ARI against scikit-learn."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from labellings import segmentations
from sklearn.metrics import adjusted_rand_score, normalized_mutual_info_score

from dpmacro.metrics import (
    adjusted_rand_index,
    frame_accuracy,
    match_labels,
    normalized_mutual_information,
)
from dpmacro.metrics.frames import named_after_truth


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
        # class 1 is free, and yet no frame says that it is label 1's
        ([0, 0, 0, 1], [0, 0, 1, 0], 0.5, {0: 0}),
    ],
)
def test_labels_are_matched_to_truth_one_to_one(labels, truth, accuracy, truth_of):
    matching = match_labels(np.array(labels), np.array(truth))
    assert matching.accuracy == pytest.approx(accuracy)
    if truth_of is not None:
        assert matching.truth_of == truth_of


@settings(deadline=None)
@given(segmentations())
def test_no_other_matching_agrees_on_more_frames(case):
    labels, truth, _ = case
    names, classes = np.unique(labels).tolist(), np.unique(truth).tolist()
    few, many, sides = (
        (names, classes, (labels, truth)) if len(names) < len(classes) else (classes, names, (truth, labels))
    )
    best = max(
        sum(int(np.sum((sides[0] == a) & (sides[1] == b))) for a, b in zip(few, chosen, strict=True))
        for chosen in itertools.permutations(many, len(few))
    )
    matching = match_labels(labels, truth)
    assert matching.accuracy == frame_accuracy(labels, truth) == best / len(labels)
    assert len(set(matching.truth_of.values())) == len(matching.truth_of)
    agreeing = [matching.truth_of.get(label) == true for label, true in zip(labels, truth, strict=True)]
    assert np.mean(agreeing) == pytest.approx(matching.accuracy)


def test_many_labels_are_matched():
    truth = np.random.default_rng(0).integers(100, size=5000)
    assert match_labels((truth * 37 + 5) % 101, truth).accuracy == 1.0


@settings(deadline=None)
@given(segmentations())
def test_names_after_truth_are_equal_where_matched(case):
    labels, truth, _ = case
    named, classes = named_after_truth(labels, truth)
    truth_of = match_labels(labels, truth).truth_of
    agreeing = [truth_of.get(label) == true for label, true in zip(labels, truth, strict=True)]
    assert (named == classes).tolist() == agreeing
    assert len(set(zip(labels, named, strict=True))) == len(set(labels)) == len(set(named))
    assert len(set(zip(truth, classes, strict=True))) == len(set(truth)) == len(set(classes))


@pytest.mark.parametrize(
    ("labels", "truth", "message"), [([], [], "0 labels against 0"), ([0, 1], [0], "2 labels against 1")]
)
@pytest.mark.parametrize("score", [match_labels, normalized_mutual_information, adjusted_rand_index])
def test_a_score_names_what_is_wrong(score, labels, truth, message):
    with pytest.raises(ValueError, match=message):
        score(np.array(labels, int), np.array(truth, int))


@settings(deadline=None)
@given(segmentations())
def test_scores_without_names_equal_scikit_learns(case):
    labels, truth, _ = case
    mutual = normalized_mutual_information(labels, truth)
    assert mutual == pytest.approx(normalized_mutual_info_score(truth, labels), abs=1e-12)
    assert adjusted_rand_index(labels, truth) == pytest.approx(adjusted_rand_score(truth, labels), abs=1e-12)


@pytest.mark.parametrize(
    ("labels", "truth", "mutual", "rand"),
    [
        ([4, 4, 4], [9, 9, 9], 1, 1),  # one value each: the same partition
        ([4, 4, 4], [1, 2, 1], 0, 0),
        ([1, 2, 1], [4, 4, 4], 0, 0),
        ([1, 2, 3], [6, 5, 4], 1, 1),  # no two frames together
        ([8], [8], 1, 1),
        ([0, 1, 0, 1], [0, 0, 1, 1], 0, -0.5),
    ],
)
def test_scores_without_names_where_partitions_are_trivial(labels, truth, mutual, rand):
    labels, truth = np.array(labels), np.array(truth)
    assert normalized_mutual_information(labels, truth) == pytest.approx(mutual, abs=1e-12)
    assert normalized_mutual_info_score(truth, labels) == pytest.approx(mutual, abs=1e-12)
    assert adjusted_rand_index(labels, truth) == adjusted_rand_score(truth, labels) == rand


def test_pairs_of_many_frames_do_not_overflow():
    rng = np.random.default_rng(0)
    truth = np.repeat([0, 1], 150_000)
    labels = np.where(rng.random(300_000) < 0.1, 1 - truth, truth)
    assert adjusted_rand_index(labels, truth) == pytest.approx(adjusted_rand_score(truth, labels))
