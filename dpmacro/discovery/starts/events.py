"""Cuts where vectors change: jumps of dimensions that mostly rest, shifts of windows, slow moments."""

import torch
from jaxtyping import Float, Int64
from torch import Tensor

from dpmacro.discovery.starts.evidence import Evidence, best_places, firsts, in_turn, k_means, window_means

__all__ = ["jumps", "named", "shifts", "slow_moments"]

RESTING = 5  # dimensions that rest most are cut at


def jumps(evidence: Evidence, restarts: int, generator: torch.Generator) -> Int64[Tensor, "restarts frames"]:
    """Cuts where a dimension that mostly rests, like a gripper's, changes most within a few frames.

    Dimensions are those of actions and the components; how much one rests is told by the participation
    ratio of its changes, (sum |d|)^2 / sum d^2, the frames that share them. The first restart takes the
    dimension that rests most, every other one of the `RESTING` first, and a window of 1 to 8 frames.
    """
    values = torch.cat([evidence.actions, evidence.components], 1)
    before = window_means(values, evidence.lengths, 1, 0)
    change = (values - before).masked_fill_(firsts(evidence.lengths)[:, None], 0)
    sharing = change.abs().sum(0).square() / change.square().sum(0)
    still = (change == 0).all(0)
    order = sharing.masked_fill(still, torch.inf).argsort()[: int((~still).sum())][:RESTING]
    starts = []
    for restart in range(restarts):
        if len(order) == 0:
            starts.append(torch.zeros(len(values), dtype=torch.int64))
            continue
        place = 0 if restart == 0 else int(torch.randint(len(order), (1,), generator=generator))
        width = 1 << int(torch.randint(4, (1,), generator=generator))
        starts.append(_shifted(evidence, values[:, order[place], None], width, restart % 2 == 1, generator))
    return _stacked(starts, evidence)


def shifts(evidence: Evidence, restarts: int, generator: torch.Generator) -> Int64[Tensor, "restarts frames"]:
    """Cuts where the mean of the frames after differs most from that of the frames before.

    Every restart draws a half of the dimensions of actions and components, and a window of one frame up to
    a half of a segment's mean length, shorter ones likelier.
    """
    values = torch.cat([evidence.actions, evidence.components], 1)
    starts = []
    for restart in range(restarts):
        drawn = torch.randperm(values.shape[1], generator=generator)[: (values.shape[1] + 1) // 2]
        width = int((2 * evidence.gap) ** float(torch.rand(1, generator=generator)))
        starts.append(_shifted(evidence, values[:, drawn], width, restart % 2 == 1, generator))
    return _stacked(starts, evidence)


def slow_moments(
    evidence: Evidence, restarts: int, generator: torch.Generator
) -> Int64[Tensor, "restarts frames"]:
    """Cuts where what moves is slowest: minima of the smoothed speed, far apart.

    In turn, speed is that of the components, the size of the action, and the speed of the action; it is
    smoothed over a drawn window, of 3 frames up to a segment's fourth.
    """
    lengths, first = evidence.lengths, firsts(evidence.lengths)[:, None]
    speeds = []
    for values, moving in (
        (evidence.components, True),
        (evidence.actions - evidence.actions.median(0).values, False),
        (evidence.actions, True),
    ):
        change = (values - window_means(values, lengths, 1, 0)).masked_fill(first, 0) if moving else values
        speeds.append(change.norm(dim=1, keepdim=True))
    starts = []
    for restart in range(restarts):
        width = 1 + int(evidence.gap ** float(torch.rand(1, generator=generator)))
        smooth = window_means(speeds[restart % 3], lengths, width, width + 1)[:, 0]
        places = best_places(-smooth, lengths, evidence.max_transitions, evidence.gap)
        starts.append(named(evidence, places, restart // 3 % 2 == 1, generator))
    return _stacked(starts, evidence)


def named(
    evidence: Evidence, changes: Tensor, alike: bool, generator: torch.Generator
) -> Int64[Tensor, " frames"]:
    """Pieces between changes as macro-actions: in turn, or alike ones the same by k-means of their means."""
    if evidence.chain or not alike or evidence.macros == 1:
        return in_turn(changes, evidence.lengths, evidence.macros)
    piece = (changes | firsts(evidence.lengths)).cumsum(0) - 1
    values = torch.cat([evidence.actions, evidence.components], 1)
    means = torch.zeros(int(piece[-1]) + 1, values.shape[1]).index_add_(0, piece, values)
    means /= piece.bincount()[:, None]
    return torch.cdist(means, k_means(means, evidence.macros, generator)).argmin(1)[piece]


def _shifted(
    evidence: Evidence,
    values: Float[Tensor, "frames dims"],
    width: int,
    alike: bool,
    generator: torch.Generator,
) -> Int64[Tensor, " frames"]:
    """Cuts where the means of `width` frames after and before differ most."""
    after = window_means(values, evidence.lengths, 0, width)
    shift = (after - window_means(values, evidence.lengths, width, 0)).norm(dim=1)
    places = best_places(shift, evidence.lengths, evidence.max_transitions, evidence.gap)
    return named(evidence, places, alike, generator)


def _stacked(starts: list[Tensor], evidence: Evidence) -> Int64[Tensor, "restarts frames"]:
    if not starts:
        return torch.zeros(0, len(evidence.actions), dtype=torch.int64)
    return torch.stack(starts)
