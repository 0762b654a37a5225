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
    will not see them. The middle of the widest best range wins; where no threshold serves any segment, zero,
    the switch function's own decision boundary, stands.

    Args:
        segments: those that end in the change of the switch function.
        scores: of every frame.
        tolerance: frames by which a change may be early or late, 0 or more.
    """
    peaks = [_before_and_at(segment, scores, tolerance) for segment in segments]
    levels = sorted({value for peak in peaks for value in peak})
    ranges = [
        (sum(before <= low and high <= at for before, at in peaks), high - low, (low + high) / 2)
        for low, high in itertools.pairwise(levels)
    ]
    in_time, _, threshold = max(ranges, default=(0, 0.0, 0.0))
    return threshold if in_time else 0.0


def recognised_share(
    segments: Sequence[Segment], margins: Float[Tensor, " frames"], tolerance: int = 0
) -> float:
    """Share, 0 to 1, of the segments whose margin is above 0 at the change that ends them and not before.

    `tolerance` is how many frames early or late that may be, 0 or more.
    """
    peaks = [_before_and_at(segment, margins, tolerance) for segment in segments]
    return sum(before <= 0 < at for before, at in peaks) / len(peaks)


def _before_and_at(segment: Segment, scores: Float[Tensor, " frames"], tolerance: int) -> tuple[float, float]:
    """The highest score before a change, and within the tolerance of it, in the two segments that it parts.

    A segment no longer than the tolerance has nothing before: any score below that of the change.
    """
    early = max(segment.stop - tolerance, segment.start)
    late = min(segment.stop + tolerance + 1, segment.following_stop)
    at = float(scores[early:late].max())
    return float(scores[segment.start : early].max()) if early > segment.start else min(at, 0.0) - 1, at
