"""The threshold of a switch function, from scores of trajectories that its training left out."""

import itertools
from collections.abc import Sequence

from jaxtyping import Float
from torch import Tensor

from dpmacro.switching.functions import Event

__all__ = ["calibrated"]


def calibrated(
    pair: tuple[int, int], events: Sequence[Event], scores: Float[Tensor, " frames"]
) -> tuple[float, float]:
    """The threshold under which most segments are left in time, and the share of them that are, 0 to 1.

    A segment is left in time where before <= threshold < at: the highest score before its change, and the
    score at the change's first frame. Later frames do not count: a planner that has not changed by then will
    not see them. The middle of the widest best range wins; where no threshold serves any segment, zero, the
    switch function's own decision boundary, stands.

    Args:
        pair: (from, to) of the switch function.
        events: all segments; those that the pair ends count.
        scores: of every frame, by functions that never saw its trajectory.
    """
    peaks = [
        (float(scores[event.start : event.stop].max()), float(scores[event.stop]))
        for event in events
        if (event.macro, event.following) == pair
    ]
    levels = sorted({value for peak in peaks for value in peak})
    ranges = [
        (sum(before <= low and high <= at for before, at in peaks), high - low, (low + high) / 2)
        for low, high in itertools.pairwise(levels)
    ]
    in_time, _, threshold = max(ranges, default=(0, 0.0, 0.0))
    return (threshold, in_time / len(peaks)) if in_time else (0.0, 0.0)
