"""The threshold of a switch function, from the scores of functions that never saw the trajectory."""

import itertools
from collections.abc import Sequence

from jaxtyping import Float
from torch import Tensor

from dpmacro.segmentation.segments import Segment

__all__ = ["best_threshold", "recognised_share"]


def best_threshold(
    segments: Sequence[Segment], scores: Float[Tensor, " frames"], tolerance: int = 0
) -> float:
    """The threshold under which most of the segments are left at their end and not before.

    A segment is left in time where before <= threshold < at: the highest score before its change, and the
    score at the change's first frame. Later frames do not count, since a policy that has not changed by then
    will not see them. Where a change may be early or late, of the thresholds that leave most segments in time
    those count that leave most of them at the very frame. The middle of the widest range of these wins; where
    no threshold serves any segment, zero, the switch function's own decision boundary, stands.

    Args:
        segments: those that end in the change of the switch function.
        scores: of every frame.
        tolerance: frames by which a change may be early or late, 0 or more.
    """
    ranges = []
    peaks = [_before_and_at(segment, scores, tolerance) for segment in segments]
    exact = [_before_and_at(segment, scores, 0) for segment in segments] if tolerance else peaks
    for low, high in itertools.pairwise(_levels(peaks)):
        within = [low, *(level for level in _levels(exact) if low < level < high), high]
        in_time = _in_time(peaks, low, high)
        counted = [(_in_time(exact, *part), *part) for part in itertools.pairwise(within)]
        for at_once, parts in itertools.groupby(counted, key=lambda part: part[0]):
            own = list(parts)
            start, stop = own[0][1], own[-1][2]
            ranges.append((in_time, at_once, stop - start, (start + stop) / 2))
    most, _, _, threshold = max(ranges, default=(0, 0, 0.0, 0.0))
    return threshold if most else 0.0


def recognised_share(
    segments: Sequence[Segment], margins: Float[Tensor, " frames"], tolerance: int = 0
) -> float:
    """Share, 0 to 1, of the segments whose margin is above 0 at the change that ends them and not before.

    `tolerance` is how many frames early or late that may be, 0 or more.
    """
    peaks = [_before_and_at(segment, margins, tolerance) for segment in segments]
    return sum(before <= 0 < at for before, at in peaks) / len(peaks)


def _levels(peaks: Sequence[tuple[float, float]]) -> list[float]:
    return sorted({value for peak in peaks for value in peak})


def _in_time(peaks: Sequence[tuple[float, float]], low: float, high: float) -> int:
    """How many segments any threshold between the two serves."""
    return sum(before <= low and high <= at for before, at in peaks)


def _before_and_at(segment: Segment, scores: Float[Tensor, " frames"], tolerance: int) -> tuple[float, float]:
    """The highest score before a change, and within the tolerance of it, in the two segments that it parts.

    A segment no longer than the tolerance has nothing before: any score below that of the change.
    """
    early = max(segment.stop - tolerance, segment.start)
    late = min(segment.stop + tolerance + 1, segment.following_stop)
    at = float(scores[early:late].max())
    return float(scores[segment.start : early].max()) if early > segment.start else min(at, 0.0) - 1, at
