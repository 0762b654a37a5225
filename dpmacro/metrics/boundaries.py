"""Change points found against true ones. The ends of a trajectory are none."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Int

from dpmacro.metrics.frames import check_same_frames
from dpmacro.metrics.segments import transitions


@dataclass(frozen=True)
class BoundaryOffsets:
    """How far found change points lie from true ones, in frames.

    Attributes:
        offsets: |found - true| of every trajectory in which both have exactly one, in their order.
        trajectories: how many trajectories there were.
    """

    offsets: Int[np.ndarray, " compared"]
    trajectories: int

    @property
    def median(self) -> float:
        """Median offset in frames, NaN where nothing could be compared."""
        return float(np.median(self.offsets)) if self.offsets.size else float("nan")


def boundary_offsets(
    labels: Int[np.ndarray, " frames"],
    truth: Int[np.ndarray, " _frames"],
    lengths: Int[np.ndarray, " trajectories"],
) -> BoundaryOffsets:
    """Distance of found from true change points where both have exactly one; see `transitions`."""
    check_same_frames(labels, truth)
    both = zip(transitions(labels, lengths), transitions(truth, lengths), strict=True)
    offsets = [abs(int(found[0]) - int(true[0])) for found, true in both if len(found) == len(true) == 1]
    return BoundaryOffsets(np.array(offsets, np.int64), len(lengths))


def boundary_scores(
    labels: Int[np.ndarray, " frames"],
    truth: Int[np.ndarray, " _frames"],
    lengths: Int[np.ndarray, " trajectories"],
    tolerance: int,
) -> tuple[float, float, float]:
    """Precision, recall and F1 of change points in 0..1, within `tolerance` frames (inclusive).

    Hits are those of `matched_boundaries` within a trajectory; hits, found and true change points are
    pooled over trajectories. With none found and none true all three are 1; with none on one side only
    all three are 0, as mir_eval has it.

    Raises:
        ValueError: a negative tolerance, no frames, not one label per true one, lengths that do not add up.
    """
    check_same_frames(labels, truth)
    found, true = transitions(labels, lengths), transitions(truth, lengths)
    hits = sum(matched_boundaries(*both, tolerance) for both in zip(found, true, strict=True))
    n_found, n_true = sum(map(len, found)), sum(map(len, true))
    if n_found == n_true == 0:
        return 1.0, 1.0, 1.0
    return hits / max(n_found, 1), hits / max(n_true, 1), 2 * hits / (n_found + n_true)


def matched_boundaries(
    found: Int[np.ndarray, " found"], true: Int[np.ndarray, " true"], tolerance: int
) -> int:
    """The most pairs (f, t) with |f - t| <= tolerance and no point in two; both sides ascending, in frames.

    All points reach equally far, so the earliest found and the earliest true one, where in reach, may always
    be a pair, and else the earlier of them has none: one sweep is exact. Pairing the nearest first is not.

    Raises:
        ValueError: a negative tolerance.
    """
    if tolerance < 0:
        raise ValueError(f"tolerance is {tolerance}, it must be a number of frames, 0 or more")
    hits = f = t = 0
    while f < len(found) and t < len(true):
        distance = int(found[f]) - int(true[t])
        hits += abs(distance) <= tolerance
        f += distance <= tolerance
        t += distance >= -tolerance
    return hits
