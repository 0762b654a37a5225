"""Edit score against the recursion that defines it, F1@k against its rule applied one segment at a time."""

from functools import cache
from itertools import groupby

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from labellings import segmentations

from dpmacro.metrics import edit_score, overlap_f1, segments, transitions

SHARED_NAMES = (-1, 0, 2)


def sequence(labels):
    """Labels of frames by letter: "aab" is [97, 97, 98]."""
    return np.array([ord(label) for label in labels])


def runs(labels, lengths):
    """(label, set of frames) of the segments of every trajectory."""
    for frames in np.split(np.arange(len(labels)), np.cumsum(lengths)[:-1]):
        yield [(label, set(members)) for label, members in groupby(frames.tolist(), lambda n: int(labels[n]))]


def edit_distance(first, second):
    @cache
    def distance(i, j):
        if i == 0 or j == 0:
            return i + j
        return min(
            distance(i - 1, j) + 1,
            distance(i, j - 1) + 1,
            distance(i - 1, j - 1) + (first[i - 1] != second[j - 1]),
        )

    return distance(len(first), len(second))


def test_transitions_do_not_cross_trajectories():
    found = transitions(np.array([0, 0, 1, 1, 0, 0, 0, 2, 0]), np.array([4, 2, 3]))
    assert [points.tolist() for points in found] == [[2], [], [1, 2]]


@pytest.mark.parametrize("lengths", [[], [2], [2, 0, 1], [4], [4, -1]])
def test_lengths_must_add_up(lengths):
    with pytest.raises(ValueError, match="add up to the 3 labels"):
        transitions(np.array([0, 0, 1]), np.array(lengths, int))


def test_segments_count_frames_from_the_start_of_their_trajectory():
    found = segments(np.array([0, 0, 1, 1, 5, 1]), np.array([3, 3]))
    assert [part.tolist() for part in found] == [[[0, 0, 2], [1, 2, 3]], [[1, 0, 1], [5, 1, 2], [1, 2, 3]]]


@settings(deadline=None)
@given(segmentations())
def test_segments_are_the_runs(case):
    labels, _, lengths = case
    ends = np.cumsum(lengths)
    rebuilt = [
        [(label, set(range(start + first, start + end))) for label, first, end in part.tolist()]
        for start, part in zip(ends - lengths, segments(labels, lengths), strict=True)
    ]
    assert rebuilt == list(runs(labels, lengths))


@pytest.mark.parametrize(
    ("labels", "truth", "score"),
    [
        ("aabb", "abbb", 1),  # when is no matter
        ("aaaa", "aabb", 1 / 2),
        ("abab", "aabb", 1 / 2),
        ("bbaa", "aabb", 0),
        ("aaab", "cccc", 0),
        ("abcd", "bcda", 1 / 2),  # an insertion and a deletion
        ("aaaa", "aaaa", 1),
    ],
)
def test_edit_score_by_hand(labels, truth, score):
    assert edit_score(sequence(labels), sequence(truth), np.array([4])) == pytest.approx(score)


def test_edit_score_is_the_mean_over_trajectories():
    labels, truth = sequence("aabb" + "abababab"), sequence("aabb" + "aaaaaaaa")
    assert edit_score(labels, truth, np.array([4, 8])) == pytest.approx((1 + 1 / 8) / 2)


@settings(deadline=None, max_examples=200)
@given(segmentations(values=SHARED_NAMES))
def test_edit_score_is_the_recursion(case):
    labels, truth, lengths = case
    expected = []
    for found, true in zip(runs(labels, lengths), runs(truth, lengths), strict=True):
        distance = edit_distance([label for label, _ in found], [label for label, _ in true])
        expected.append(1 - distance / max(len(found), len(true)))
    assert edit_score(labels, truth, lengths) == pytest.approx(np.mean(expected))


@pytest.mark.parametrize(
    ("labels", "truth", "overlap", "score"),
    [
        ("aaaabbbb", "aaaabbbb", 0.5, 1),
        ("abbbbbbb", "aaaabbbb", 0.5, 1 / 2),  # 1/4 and 4/7
        ("abbbbbbb", "aaaabbbb", 0.25, 1),  # a share of exactly 1/4 is enough
        ("abbbbbbb", "aaaabbbb", 0.26, 1 / 2),
        ("bbbbaaaa", "aaaabbbb", 0.1, 0),
        ("aabaabaa", "aaaaaaaa", 0.1, 2 / 6),  # three of five parts reach 10%; one counts
        ("aaaaaaaa", "aabaabaa", 0.1, 2 / 6),  # one found cannot stand for three
        ("bbbabaaaaaaa", "aaaaaaaaccaa", 0.1, 4 / 7),  # two found, each with its own best
        ("bbaaabaaaabb", "cccaaaaacaaa", 0.1, 2 / 9),  # two found with one best: the second best is not tried
    ],
)
def test_overlap_f1_by_hand(labels, truth, overlap, score):
    found = overlap_f1(sequence(labels), sequence(truth), np.array([len(labels)]), overlap)
    assert found == pytest.approx(score)


def test_overlap_f1_pools_counts_over_trajectories():
    labels, truth = sequence("aabb" + "ababab"), sequence("aabb" + "cccccc")
    assert overlap_f1(labels, truth, np.array([4, 6]), 0.5) == pytest.approx(2 * 2 / (8 + 3))


@settings(deadline=None, max_examples=200)
@given(segmentations(values=SHARED_NAMES, longest=20), st.sampled_from([0.1, 0.25, 0.5, 1.0]))
def test_overlap_f1_is_its_rule(case, overlap):
    labels, truth, lengths = case
    hits = misses = unseen = 0
    for found, true in zip(runs(labels, lengths), runs(truth, lengths), strict=True):
        free = [True] * len(true)
        for label, frames in found:
            ious = [
                len(frames & other) / len(frames | other) if name == label else 0.0 for name, other in true
            ]
            best = ious.index(max(ious))
            if ious[best] >= overlap and free[best]:
                hits, free[best] = hits + 1, False
            else:
                misses += 1
        unseen += sum(free)
    assert overlap_f1(labels, truth, lengths, overlap) == pytest.approx(
        2 * hits / (2 * hits + misses + unseen)
    )
