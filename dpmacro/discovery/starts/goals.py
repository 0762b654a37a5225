"""Pieces named by what holds when they end: a subtask mostly ends where its goal is reached."""

import torch
from jaxtyping import Bool, Float, Int64, UInt8
from torch import Tensor

from dpmacro.discovery.starts.events import jump_places, shift_places, slow_places, stacked
from dpmacro.discovery.starts.evidence import Evidence, firsts, in_turn
from dpmacro.features.levels import SortedLevels

__all__ = ["by_goals", "goals"]

COLUMNS = 256  # at most, drawn at random for every restart
CONDITIONS = 512  # most telling ones that are compared
WIDEST = 8  # levels on either side of a condition's


def by_goals(
    data: SortedLevels, evidence: Evidence, restarts: int, generator: torch.Generator
) -> Int64[Tensor, "restarts frames"]:
    """Cuts at shifts, mostly, or at jumps or slow moments; pieces that end alike are the same macro-action.

    The first restart in every four looks at all columns, or `COLUMNS` of them, the others at a half of those.
    """
    sources = (shift_places, jump_places, shift_places, slow_places)
    starts = []
    for restart in range(restarts):
        changes = sources[restart % 4](evidence, restart // 4, generator)
        if evidence.chain:
            starts.append(in_turn(changes, evidence.lengths, evidence.macros))
            continue
        most = min(COLUMNS, data.n_columns)
        columns = torch.randperm(data.n_columns, generator=generator)[
            : most if restart % 4 == 0 else -(-most // 2)
        ]
        reach = 1 + int(torch.randint(WIDEST, (1,), generator=generator))
        own = data.rows(columns).cpu()
        starts.append(goals(own, changes, evidence, reach))
    return stacked(starts, evidence)


def goals(
    levels: UInt8[Tensor, "columns frames"],
    changes: Bool[Tensor, " frames"],
    evidence: Evidence,
    reach: int = 4,
) -> Int64[Tensor, " frames"]:
    """The pieces between changes, named by the conditions that hold in their last frames.

    A condition is a column within `reach` levels of one; it tells of a goal where it holds at the ends of
    pieces more often than at other frames. Q conditions are chosen greedily, each to add most to the sum over
    pieces of the largest log ratio of the two shares (facility location), and every piece goes with the
    condition that says most of it, or with the first where none holds.
    """
    starting = changes | firsts(evidence.lengths)
    piece = starting.cumsum(0) - 1
    last = torch.cat([starting.nonzero()[1:, 0] - 1, torch.tensor([len(piece) - 1])])
    ends = levels[:, last].long()
    count = len(last)
    at_ends, anywhere = _shares(ends, reach), _shares(levels.long(), reach)
    ratio = ((at_ends + 0.5 / count) / (anywhere + 0.5 / count)).log().clamp(min=0)
    order = (ratio * at_ends).flatten().argsort(descending=True, stable=True)[:CONDITIONS]
    column, level = order // ratio.shape[1], order % ratio.shape[1]
    holds = (ends[column] - level[:, None]).abs() <= reach
    gains = ratio[column, level, None] * holds  # [conditions, pieces]
    said, names = torch.zeros(count), torch.zeros(count, dtype=torch.int64)
    for macro in range(evidence.macros):
        gain = gains[(gains - said).clamp(min=0).sum(1).argmax()]
        names[gain > said] = macro
        said = torch.maximum(said, gain)
    return names[piece]


def _shares(levels: Int64[Tensor, "columns frames"], reach: int) -> Float[Tensor, "columns 256"]:
    """For every column and level the share of frames within `reach` of it."""
    ones = torch.ones_like(levels, dtype=torch.float32)
    counts = torch.zeros(len(levels), 256).scatter_add_(1, levels, ones)
    sums = torch.nn.functional.pad(counts.cumsum(1), (1, 0))
    places = torch.arange(256)
    return (
        sums[:, (places + reach + 1).clamp(max=256)] - sums[:, (places - reach).clamp(min=0)]
    ) / levels.shape[1]
