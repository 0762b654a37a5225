"""Changes moved to where switch functions fire, so that few inexact ones do not spoil those to come."""

from collections.abc import Callable

import torch
from jaxtyping import Int64
from torch import Tensor

from dpmacro.switching.functions import SwitchFunctions, causal_labels, starting_macro

__all__ = ["aligned", "realigned"]

ALIGNMENTS = 3  # times that changes are moved, at most


def aligned(
    switches: SwitchFunctions, labels: Int64[Tensor, " frames"], lengths: Int64[Tensor, " trajectories"]
) -> Int64[Tensor, " frames"]:
    """The segmentation with its changes where switch functions that never saw a trajectory make them in it.

    Trajectories in which they would not make the same changes in the same order stay as they are.
    """
    first = starting_macro(labels, lengths)
    told = causal_labels(switches.held_out, switches.thresholds, switches.pairs, lengths, first)
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

    Where a change is a frame or two late in a few trajectories, the others tell. Changes are moved as long as
    more of them are recognised for it, `ALIGNMENTS` times at most; where nothing was left out, never.
    """
    switches = fit(labels)
    for _ in range(ALIGNMENTS * switches.left_out):
        moved = aligned(switches, labels, lengths)
        if torch.equal(moved, labels):
            break
        again = fit(moved)
        if float(again.detected.mean()) <= float(switches.detected.mean()):
            break
        labels, switches = moved, again
    return labels
