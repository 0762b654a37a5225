"""The threshold of a switch function, from the scores of functions that never saw the trajectory."""

from collections.abc import Iterator, Sequence
from itertools import pairwise

import numpy as np
from jaxtyping import Float, Int
from torch import Tensor

from dpmacro.segmentation.segments import Segment

__all__ = ["best_threshold", "recognised_share"]


def best_threshold(
    segments: Sequence[Segment],
    scores: Float[Tensor, " frames"],
    tolerance: int = 0,
    others: Sequence[Segment] = (),
) -> float:
    """The threshold under which most of the segments are left at their end and not before.

    A segment is left in time where before <= threshold < at: the highest score before its change, and the
    score at the change's first frame. Later frames do not count, since a policy that has not changed by then
    will not see them. Where a change may be early or late, of the thresholds that leave most segments in time
    those count that leave most of them at the very frame. The middle of the widest range of these wins; where
    no threshold serves any segment, zero, the switch function's own decision boundary, stands.

    Other segments of the macro-action have no say in it: a change too many can be undone, one that is missed
    cannot. But a change that most of them end without has no threshold, infinity, where never to make it is
    as good: where no more segments are left in time, or without it, than have another end.

    Args:
        segments: those that end in the change of the switch function.
        scores: of every frame.
        tolerance: frames by which a change may be early or late, 0 or more.
        others: the other segments of the macro-action that the change leaves.
    """
    peaks, exact = (
        np.array([_before_and_at(segment, scores, frames) for segment in segments]).reshape(-1, 2)
        for frames in (tolerance, 0)
    )
    alone = np.array([float(scores[one.start : one.stop].max()) for one in others])
    levels = np.unique(np.concatenate([peaks.ravel(), exact.ravel()]))
    in_time, at_once = _served(peaks, levels), _served(exact, levels)
    # Levels of the changes part ranges, those of the very frames only where their count differs.
    parts = np.stack([np.searchsorted(np.unique(peaks), levels[:-1], side="right"), at_once], 1)
    ranges = []
    for first, last in _runs(parts):
        low, high = levels[first], levels[last]
        if in_time[first]:
            ranges.append((in_time[first], at_once[first], high - low, (low + high) / 2))
    most, _, _, threshold = max(ranges, default=(0, 0, 0.0, 0.0))
    if len(segments) < len(others) and most + int((alone <= threshold).sum()) <= len(others):
        return float("inf")
    return float(threshold)


def recognised_share(
    segments: Sequence[Segment], margins: Float[Tensor, " frames"], tolerance: int = 0
) -> float:
    """Share, 0 to 1, of the segments whose margin is above 0 at the change that ends them and not before.

    `tolerance` is how many frames early or late that may be, 0 or more.
    """
    peaks = [_before_and_at(segment, margins, tolerance) for segment in segments]
    return sum(before <= 0 < at for before, at in peaks) / len(peaks)


def _served(peaks: Float[np.ndarray, "segments 2"], levels: Float[np.ndarray, " levels"]) -> np.ndarray:
    """How many segments any threshold between each two neighbouring levels serves."""
    before, at = np.searchsorted(levels, peaks[peaks[:, 0] < peaks[:, 1]]).T
    steps = np.zeros(max(len(levels), 1), dtype=np.int64)
    np.add.at(steps, before, 1)
    np.add.at(steps, at, -1)
    return steps.cumsum()[:-1]


def _runs(rows: Int[np.ndarray, "rows fields"]) -> Iterator[tuple[int, int]]:
    """First row of every stretch of equal rows, and the row after it."""
    edges = np.flatnonzero((rows[1:] != rows[:-1]).any(1)) + 1
    return pairwise([0, *edges.tolist(), len(rows)]) if len(rows) else iter(())


def _before_and_at(segment: Segment, scores: Float[Tensor, " frames"], tolerance: int) -> tuple[float, float]:
    """The highest score before a change, and within the tolerance of it, in the two segments that it parts.

    A segment no longer than the tolerance has nothing before: any score below that of the change.
    """
    early = max(segment.stop - tolerance, segment.start)
    late = min(segment.stop + tolerance + 1, segment.following_stop)
    at = float(scores[early:late].max())
    return float(scores[segment.start : early].max()) if early > segment.start else min(at, 0.0) - 1, at
