"""What a score is worth: labels that know the truth but for where it changes, to be scored beside others.

Every trajectory keeps its true segments in their order, so number, classes and order are right and only the
change points are not: strong references, and what a score has beyond theirs is owed to the change points.
"""

from collections.abc import Callable

import numpy as np
from jaxtyping import Int

from dpmacro.metrics.segments import segments


def uniform_cuts(
    truth: Int[np.ndarray, " frames"], lengths: Int[np.ndarray, " trajectories"]
) -> Int[np.ndarray, " frames"]:
    """The true segments of every trajectory, all of one length, give or take a frame.

    Raises:
        ValueError: an empty trajectory, or lengths that do not add up.
    """
    return _recut(truth, lengths, lambda length, count: np.arange(1, count) * length // count)


def random_cuts_like(
    truth: Int[np.ndarray, " frames"], lengths: Int[np.ndarray, " trajectories"], rng: np.random.Generator
) -> Int[np.ndarray, " frames"]:
    """The true segments of every trajectory between distinct random cuts, every set of cuts equally likely.

    Raises:
        ValueError: an empty trajectory, or lengths that do not add up.
    """

    def cuts(length: int, count: int) -> np.ndarray:
        return np.sort(rng.choice(length - 1, count - 1, replace=False)) + 1

    return _recut(truth, lengths, cuts)


def _recut(
    truth: np.ndarray, lengths: np.ndarray, cuts: Callable[[int, int], np.ndarray]
) -> Int[np.ndarray, " frames"]:
    """Cut every trajectory at cuts(length, number of true segments), ascending in 1..length-1."""
    parts = []
    for true, length in zip(segments(truth, lengths), lengths.tolist(), strict=True):
        sizes = np.diff(cuts(length, len(true)), prepend=0, append=length)
        parts.append(np.repeat(true[:, 0], sizes))
    return np.concatenate(parts)
