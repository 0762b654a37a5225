"""Cuts where vectors change: jumps of dimensions that mostly rest, shifts of windows, slow moments."""

from collections.abc import Callable

import torch
from jaxtyping import Bool, Float, Int64
from torch import Tensor

from dpmacro.discovery.starts.evidence import Evidence, best_places, firsts, in_turn, k_means, window_means

__all__ = ["cut_at", "jump_places", "shift_places", "slow_places", "stacked"]

RESTING = 5  # dimensions that rest most are cut at

Places = Callable[[Evidence, int, torch.Generator], Bool[Tensor, " frames"]]


def cut_at(
    places: Places, evidence: Evidence, restarts: int, generator: torch.Generator
) -> Int64[Tensor, "restarts frames"]:
    """Segmentations cut at such places; in every other one pieces with means alike are named the same."""
    starts = []
    for restart in range(restarts):
        changes = places(evidence, restart, generator)
        if evidence.chain or restart % 2 == 0:
            starts.append(in_turn(changes, evidence.lengths, evidence.macros))
        else:
            starts.append(_alike(evidence, changes, generator))
    return stacked(starts, evidence)


def jump_places(evidence: Evidence, restart: int, generator: torch.Generator) -> Bool[Tensor, " frames"]:
    """Where a dimension that mostly rests, like a gripper's, changes most within a few frames.

    Dimensions are those of actions and the components. How much one rests is told by the participation ratio
    of its changes, (sum |d|)^2 / sum d^2, the frames that share them: restart 0 takes the one that rests
    most, others draw one of the first `RESTING`. The change is between means of 1, 2, 4 or 8 frames.
    """
    values = evidence.values
    change = _steps(values, evidence)
    sharing = change.abs().sum(0).square() / change.square().sum(0)
    still = (change == 0).all(0)
    order = sharing.masked_fill(still, torch.inf).argsort()[: int((~still).sum())][:RESTING]
    if len(order) == 0:
        return torch.zeros(len(values), dtype=torch.bool)
    place = 0 if restart == 0 else int(torch.randint(len(order), (1,), generator=generator))
    width = 1 << int(torch.randint(4, (1,), generator=generator))
    return _shifted(evidence, values[:, order[place], None], width)


def shift_places(evidence: Evidence, restart: int, generator: torch.Generator) -> Bool[Tensor, " frames"]:
    """Where the mean of the frames after differs most from that of the frames before.

    It is the mean of all actions in every other restart, else of a drawn half of the dimensions of actions
    and components, over one frame up to half of a segment's mean length, shorter windows likelier.
    """
    values = evidence.actions
    if restart % 2 == 1:
        values = evidence.values
        values = values[:, torch.randperm(values.shape[1], generator=generator)[: (values.shape[1] + 1) // 2]]
    width = int((2 * evidence.gap) ** float(torch.rand(1, generator=generator)))
    return _shifted(evidence, values, width)


def slow_places(evidence: Evidence, restart: int, generator: torch.Generator) -> Bool[Tensor, " frames"]:
    """Where what moves is slowest: minima of the smoothed speed, far apart.

    In turn, speed is that of the components, the size of the action, and the speed of the action, smoothed
    over a drawn window of 3 frames up to half of a segment.
    """
    values = evidence.components if restart % 3 == 0 else evidence.actions
    moved = values - values.median(0).values if restart % 3 == 1 else _steps(values, evidence)
    width = 1 + int(evidence.gap ** float(torch.rand(1, generator=generator)))
    smooth = window_means(moved.norm(dim=1, keepdim=True), evidence.lengths, width, width + 1)[:, 0]
    return best_places(-smooth, evidence.lengths, evidence.max_transitions, evidence.gap)


def stacked(starts: list[Tensor], evidence: Evidence) -> Int64[Tensor, "restarts frames"]:
    """Segmentations one below the other, of which there may be none."""
    if not starts:
        return torch.zeros(0, len(evidence.actions), dtype=torch.int64)
    return torch.stack(starts)


def _steps(values: Float[Tensor, "frames dims"], evidence: Evidence) -> Float[Tensor, "frames dims"]:
    """Changes over the last frame; 0 at a trajectory's first."""
    before = values.roll(1, 0)
    return (values - before).masked_fill(firsts(evidence.lengths)[:, None], 0)


def _shifted(evidence: Evidence, values: Float[Tensor, "frames dims"], width: int) -> Bool[Tensor, " frames"]:
    """Where the means of `width` frames after and before differ most."""
    after = window_means(values, evidence.lengths, 0, width)
    shift = (after - window_means(values, evidence.lengths, width, 0)).norm(dim=1)
    return best_places(shift, evidence.lengths, evidence.max_transitions, evidence.gap)


def _alike(
    evidence: Evidence, changes: Bool[Tensor, " frames"], generator: torch.Generator
) -> Int64[Tensor, " frames"]:
    """Pieces between changes, named by k-means of their means."""
    piece = (changes | firsts(evidence.lengths)).cumsum(0) - 1
    values = evidence.values
    means = torch.zeros(int(piece[-1]) + 1, values.shape[1]).index_add_(0, piece, values)
    means /= piece.bincount()[:, None]
    return torch.cdist(means, k_means(means, evidence.macros, generator)).argmin(1)[piece]
