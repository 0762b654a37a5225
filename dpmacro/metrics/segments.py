"""Segments, the runs of equal labels in a trajectory: which there are, in which order, how far they overlap.

Labels bear the names of true classes here: a segment is right only if its label equals the true one.
"""

import numpy as np
from jaxtyping import Int


def transitions(
    labels: Int[np.ndarray, " frames"], lengths: Int[np.ndarray, " trajectories"]
) -> list[Int[np.ndarray, " changes"]]:
    """Change points of every trajectory: positions t in 1..length-1 whose label differs from t-1's.

    Raises:
        ValueError: an empty trajectory, or lengths that do not add up to the number of labels.
    """
    if len(lengths) == 0 or lengths.min() < 1 or lengths.sum() != len(labels):
        raise ValueError(
            f"lengths {lengths.tolist()} must be positive and add up to the {len(labels)} labels given"
        )
    trajectories = np.split(labels, np.cumsum(lengths)[:-1])
    return [np.flatnonzero(trajectory[1:] != trajectory[:-1]) + 1 for trajectory in trajectories]


def segments(
    labels: Int[np.ndarray, " frames"], lengths: Int[np.ndarray, " trajectories"]
) -> list[Int[np.ndarray, "segments 3"]]:
    """Label, first frame and end (excluded) of the segments of every trajectory; its first frame is 0.

    Raises:
        ValueError: as `transitions`.
    """
    result, start = [], 0
    for changes, length in zip(transitions(labels, lengths), lengths.tolist(), strict=True):
        first = np.append(0, changes)
        result.append(np.stack([labels[start + first], first, np.append(changes, length)], 1))
        start += length
    return result


def edit_score(
    labels: Int[np.ndarray, " frames"],
    truth: Int[np.ndarray, " frames"],
    lengths: Int[np.ndarray, " trajectories"],
) -> float:
    """Segmental edit score in 0..1, mean over trajectories (Lea et al. 2016).

        1 - Levenshtein(l, t) / max(|l|, |t|),  l and t the labels of the segments in their order:

    it sees what happened and in which order, not when.
    """
    scores = []
    for found, true in zip(segments(labels, lengths), segments(truth, lengths), strict=True):
        distance = _levenshtein(found[:, 0], true[:, 0])
        scores.append(1 - distance / max(len(found), len(true)))
    return float(np.mean(scores))


def overlap_f1(
    labels: Int[np.ndarray, " frames"],
    truth: Int[np.ndarray, " frames"],
    lengths: Int[np.ndarray, " trajectories"],
    overlap: float,
) -> float:
    """Segmental F1@k in 0..1, 2 hits / (found + true), counts pooled over trajectories (Lea et al. 2017).

    A found segment stands for the true one of its label with the largest intersection over union, the first
    of several. It is a hit if that reaches `overlap` (in 0..1, 0 excluded), one hit per true segment at most.
    """
    hits = total = 0
    for found, true in zip(segments(labels, lengths), segments(truth, lengths), strict=True):
        shared = np.minimum.outer(found[:, 2], true[:, 2]) - np.maximum.outer(found[:, 1], true[:, 1])
        hull = np.maximum.outer(found[:, 2], true[:, 2]) - np.minimum.outer(found[:, 1], true[:, 1])
        ious = np.where(np.equal.outer(found[:, 0], true[:, 0]), shared / hull, 0)
        hits += len(np.unique(ious.argmax(1)[ious.max(1) >= overlap]))
        total += len(found) + len(true)
    return 2 * hits / total


def _levenshtein(first: Int[np.ndarray, " first"], second: Int[np.ndarray, " second"]) -> int:
    """Insertions, deletions and substitutions that turn one sequence into the other, at least."""
    columns = np.arange(len(second) + 1)
    row = columns
    for count, item in enumerate(first.tolist(), 1):
        best = np.append(count, np.minimum(row[1:] + 1, row[:-1] + (second != item)))
        # min over k <= j of best[k] + (j - k): what insertions make of it.
        row = np.minimum.accumulate(best - columns) + columns
    return int(row[-1])
