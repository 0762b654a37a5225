"""The threshold of a switch function, from the scores of functions that never saw the trajectory."""

import itertools
from collections.abc import Sequence

from jaxtyping import Float
from torch import Tensor

from dpmacro.segmentation.segments import Segment

__all__ = ["best_threshold", "recognised_share"]


def best_threshold(segments: Sequence[Segment], scores: Float[Tensor, " frames"]) -> float:
    """The threshold under which most of the segments are left at their end and not before.

    A segment is left in time where before <= threshold < at: the highest score before its change, and the
    score at the change's first frame. Later frames do not count, since a policy that has not changed by then
    will not see them. The middle of the widest best range wins; where no threshold serves any segment, zero,
    the switch function's own decision boundary, stands.

    Args:
        segments: those that end in the change of the switch function.
        scores: of every frame.
    """
    peaks = [
        (float(scores[segment.start : segment.stop].max()), float(scores[segment.stop]))
        for segment in segments
    ]
    levels = sorted({value for peak in peaks for value in peak})
    ranges = [
        (sum(before <= low and high <= at for before, at in peaks), high - low, (low + high) / 2)
        for low, high in itertools.pairwise(levels)
    ]
    in_time, _, threshold = max(ranges, default=(0, 0.0, 0.0))
    return threshold if in_time else 0.0


def recognised_share(segments: Sequence[Segment], margins: Float[Tensor, " frames"]) -> float:
    """Share, 0 to 1, of the segments whose margin is above 0 at the change that ends them and not before."""
    in_time = [
        float(margins[segment.start : segment.stop].max()) <= 0 < float(margins[segment.stop])
        for segment in segments
    ]
    return sum(in_time) / len(in_time)
