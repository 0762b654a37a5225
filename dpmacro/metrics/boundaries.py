"""Change points found against true ones. The ends of a trajectory are none."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Int

from dpmacro.metrics.frames import check_same_frames
from dpmacro.metrics.segments import transitions
from dpmacro.utils.checks import as_count


class Boundaries(NamedTuple):
    """Change points of all trajectories together, as `boundary_counts` has them."""

    hits: int
    found: int
    true: int


def boundary_counts(
    labels: Int[np.ndarray, " frames"],
    truth: Int[np.ndarray, " _frames"],
    lengths: Int[np.ndarray, " trajectories"],
    tolerance: int,
) -> Boundaries:
    """How many change points were found, how many are true, and how many of them are the same.

    Hits are those of `matched_boundaries` within a trajectory, `tolerance` frames apart at most (inclusive).

    Raises:
        ValueError: a tolerance that is not a whole number, 0 or more, no frames, not one label per true one,
            lengths that do not add up.
    """
    check_same_frames(labels, truth)
    found, true = transitions(labels, lengths), transitions(truth, lengths)
    hits = sum(matched_boundaries(*both, tolerance) for both in zip(found, true, strict=True))
    return Boundaries(hits, sum(map(len, found)), sum(map(len, true)))


def boundary_scores(
    labels: Int[np.ndarray, " frames"],
    truth: Int[np.ndarray, " _frames"],
    lengths: Int[np.ndarray, " trajectories"],
    tolerance: int,
) -> tuple[float, float, float]:
    """Precision, recall and F1 of change points in 0..1, of `boundary_counts` and with its errors.

    With none found and none true all three are 1; with none on one side only all three are 0, as mir_eval
    has it.
    """
    hits, found, true = boundary_counts(labels, truth, lengths, tolerance)
    if found == true == 0:
        return 1.0, 1.0, 1.0
    return hits / max(found, 1), hits / max(true, 1), 2 * hits / (found + true)


def matched_boundaries(
    found: Int[np.ndarray, " found"], true: Int[np.ndarray, " true"], tolerance: int
) -> int:
    """The most pairs (f, t) with |f - t| <= tolerance and no point in two; both sides ascending, in frames.

    All points reach equally far, so the earliest found and the earliest true one, where in reach, may always
    be a pair, and else the earlier of them has none: one sweep is exact. Pairing the nearest first is not.

    Raises:
        ValueError: a tolerance that is not a whole number, 0 or more.
    """
    as_count("tolerance", tolerance, 0)
    hits = f = t = 0
    while f < len(found) and t < len(true):
        distance = int(found[f]) - int(true[t])
        hits += abs(distance) <= tolerance
        f += distance <= tolerance
        t += distance >= -tolerance
    return hits
