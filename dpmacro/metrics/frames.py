"""Frames that agree: the best naming of labels after true classes, and two scores that need no names."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int


@dataclass(frozen=True)
class Matching:
    """Macro-labels named after true classes, one to one.

    Attributes:
        accuracy: share in 0..1 of all frames whose label is matched to their true class.
        truth_of: true class of every matched label; a label without a class of its own is left out.
    """

    accuracy: float
    truth_of: dict[int, int]


def match_labels(labels: Int[np.ndarray, " frames"], truth: Int[np.ndarray, " _frames"]) -> Matching:
    """The one-to-one matching of labels to true classes under which most frames agree (Kuhn 1955).

    Either side may have more values than the other; what is left over counts as wrong. Of equally good
    matchings the one taken depends on where labels lie, not on what they are called.

    Raises:
        ValueError: no frames, or not one label per true one.
    """
    from scipy.optimize import linear_sum_assignment  # late: its import takes longer than ours

    names, classes, counts = _contingency(labels, truth)
    pairs = [pair for pair in zip(*linear_sum_assignment(counts, maximize=True), strict=True) if counts[pair]]
    agreeing = sum(int(counts[pair]) for pair in pairs)
    return Matching(agreeing / len(labels), {int(names[row]): int(classes[column]) for row, column in pairs})


def frame_accuracy(labels: Int[np.ndarray, " frames"], truth: Int[np.ndarray, " _frames"]) -> float:
    """Share in 0..1 of frames that agree under the best one-to-one matching, see `match_labels`."""
    return match_labels(labels, truth).accuracy


def named_after_truth(
    labels: Int[np.ndarray, " frames"], truth: Int[np.ndarray, " _frames"]
) -> tuple[Int[np.ndarray, " frames"], Int[np.ndarray, " frames"]]:
    """Labels and truth in numbers that are equal just where `match_labels` matches the label to the class.

    True classes become 0..C-1 in ascending order, a label the number of its class, one without C or more.
    """
    truth_of = match_labels(labels, truth).truth_of
    names, rows = np.unique(labels, return_inverse=True)
    classes, columns = np.unique(truth, return_inverse=True)
    numbers = {name: number for number, name in enumerate(classes.tolist())}
    renamed = [
        numbers[truth_of[name]] if name in truth_of else len(classes) + row
        for row, name in enumerate(names.tolist())
    ]
    return np.array(renamed)[rows], columns


def normalized_mutual_information(
    labels: Int[np.ndarray, " frames"], truth: Int[np.ndarray, " _frames"]
) -> float:
    """I(labels; truth) / ((H(labels) + H(truth)) / 2) in 0..1; 1 where both have a single value.

    Raises:
        ValueError: no frames, or not one label per true one.
    """
    joint = _contingency(labels, truth)[2] / len(labels)
    if joint.size == 1:
        return 1.0
    entropies = _entropy(joint.sum(1)) + _entropy(joint.sum(0))
    information = entropies - _entropy(joint.ravel())
    # Rounding could leave it a hair outside.
    return min(1.0, max(0.0, 2 * information / entropies))


def adjusted_rand_index(labels: Int[np.ndarray, " frames"], truth: Int[np.ndarray, " _frames"]) -> float:
    """Pairs of frames that labels and truth both keep together, corrected for chance (Hubert, Arabie 1985).

        (R - E) / ((A + B) / 2 - E),  E = A B / N,

    of all N pairs A have one label, B one class, R both. 1 for the same partition, 0 expected by chance,
    never below -0.5.

    Raises:
        ValueError: no frames, or not one label per true one.
    """
    counts = _contingency(labels, truth)[2]
    both, same_label, same_class = map(_pairs, (counts.ravel(), counts.sum(1), counts.sum(0)))
    if both == same_label == same_class:
        return 1.0
    # Whole numbers up to the division; Python's, since they pass 64 bits.
    pairs = len(labels) * (len(labels) - 1) // 2
    chance = 2 * same_label * same_class
    return (2 * both * pairs - chance) / ((same_label + same_class) * pairs - chance)


def check_same_frames(labels: np.ndarray, truth: np.ndarray) -> None:
    """Raise ValueError where there are no frames, or not one label per true one."""
    if len(labels) == 0 or len(labels) != len(truth):
        raise ValueError(f"{len(labels)} labels against {len(truth)} true ones: one of each per frame")


def _contingency(labels: np.ndarray, truth: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Labels, classes and the frames of every pair [labels, classes]; both in the order of first frames."""
    check_same_frames(labels, truth)
    (names, rows), (classes, columns) = _by_first_frame(labels), _by_first_frame(truth)
    counts = np.bincount(rows * len(classes) + columns, minlength=len(names) * len(classes))
    return names, classes, counts.reshape(len(names), len(classes))


def _by_first_frame(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distinct values in the order of their first frames, and the position of every frame's among them."""
    names, first, positions = np.unique(values, return_index=True, return_inverse=True)
    order = np.argsort(first)
    return names[order], np.argsort(order)[positions]


def _entropy(shares: Float[np.ndarray, " values"]) -> float:
    positive = shares[shares > 0]
    return float(-(positive * np.log(positive)).sum())


def _pairs(counts: Int[np.ndarray, " values"]) -> int:
    return int((counts * (counts - 1) // 2).sum())
