"""Change points moved to where switch functions fire.

A change point that lies a frame or two late in a few trajectories makes the switch function that learns from
it worse. Functions fitted to the other trajectories show where it belongs.
"""

from collections.abc import Callable

import torch
from jaxtyping import Int64
from torch import Tensor

from dpmacro.segmentation.segments import starting_macros
from dpmacro.switching.functions import SwitchFunctions, causal_labels

__all__ = ["aligned", "realigned"]

PASSES = 3  # times that change points are moved, at most


def aligned(
    switches: SwitchFunctions, labels: Int64[Tensor, " frames"], lengths: Int64[Tensor, " trajectories"]
) -> Int64[Tensor, " frames"]:
    """The segmentation with its changes where the left-out margins of switch functions make them.

    Trajectories in which they would not make the same changes in the same order stay as they are.
    """
    told = causal_labels(switches.margins, switches.pairs, lengths, starting_macros(labels, lengths))
    parts = [part.split(lengths.tolist()) for part in (labels.cpu(), told)]
    return torch.cat(
        [
            other if torch.equal(own.unique_consecutive(), other.unique_consecutive()) else own
            for own, other in zip(*parts, strict=True)
        ]
    )


def realigned(
    fit: Callable[[Int64[Tensor, " frames"]], SwitchFunctions],
    labels: Int64[Tensor, " frames"],
    lengths: Int64[Tensor, " trajectories"],
) -> Int64[Tensor, " frames"]:
    """The segmentation with its changes moved to where switch functions fire that `fit` makes from labels.

    Changes are moved for as long as a larger share of them is recognised for it, `PASSES` times at most, and
    never where nothing was left out.
    """
    switches = fit(labels)
    for _ in range(PASSES * switches.left_out):
        moved = aligned(switches, labels, lengths)
        if torch.equal(moved, labels):
            break
        again = fit(moved)
        if again.mean_recognised <= switches.mean_recognised:
            break
        labels, switches = moved, again
    return labels
