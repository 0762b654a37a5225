"""References keep what they know of the truth, and nothing else."""

from collections import Counter

import numpy as np
import pytest
from hypothesis import given, settings
from labellings import segmentations

from dpmacro.metrics import random_cuts_like, segments, transitions, uniform_cuts


def classes(labels, lengths):
    return [part[:, 0].tolist() for part in segments(labels, lengths)]


@settings(deadline=None)
@given(segmentations())
def test_uniform_cuts_make_the_true_segments_equally_long(case):
    _, truth, lengths = case
    labels = uniform_cuts(truth, lengths)
    assert classes(labels, lengths) == classes(truth, lengths)
    for part in segments(labels, lengths):
        assert np.ptp(part[:, 2] - part[:, 1]) <= 1


def test_uniform_cuts_by_hand():
    truth = np.array([5, 7, 7, 7, 7, 5, 3, 3, 3])
    assert uniform_cuts(truth, np.array([6, 3])).tolist() == [5, 5, 7, 7, 5, 5, 3, 3, 3]


@settings(deadline=None)
@given(segmentations())
def test_random_cuts_keep_the_true_segments_in_order(case):
    _, truth, lengths = case
    labels = random_cuts_like(truth, lengths, np.random.default_rng(0))
    assert classes(labels, lengths) == classes(truth, lengths)
    assert labels.tolist() == random_cuts_like(truth, lengths, np.random.default_rng(0)).tolist()


def test_all_sets_of_random_cuts_are_equally_likely():
    truth, lengths = np.tile([0, 1, 2, 2, 2], 6000), np.full(6000, 5)
    labels = random_cuts_like(truth, lengths, np.random.default_rng(0))
    drawn = Counter(tuple(points.tolist()) for points in transitions(labels, lengths))
    assert set(drawn) == {(a, b) for a in range(1, 5) for b in range(a + 1, 5)}
    assert min(drawn.values()) > 850 and max(drawn.values()) < 1150  # 1000 expected, deviation 29


def test_lengths_must_add_up():
    truth, lengths = np.array([0, 0, 1]), np.array([2])
    with pytest.raises(ValueError, match="add up to the 3 labels"):
        uniform_cuts(truth, lengths)
    with pytest.raises(ValueError, match="add up to the 3 labels"):
        random_cuts_like(truth, lengths, np.random.default_rng(0))
