"""Chains: macro-actions 0, 1, ..., Q - 1 in this order, each once, in every trajectory."""

import torch
from jaxtyping import Int64
from torch import Tensor

__all__ = ["chained"]


def chained(
    labels: Int64[Tensor, "restarts frames"], lengths: Int64[Tensor, " trajectories"], macros: int
) -> Int64[Tensor, "restarts frames"]:
    """The changes of other segmentations as chains of exactly Q - 1 transitions.

    Where a trajectory has more changes than Q - 1 the first ones stay, where it has fewer its longest pieces
    are halved until there are enough. Every trajectory has Q frames at least.
    """
    rows = []
    for row in labels:
        parts = []
        for part in row.split(lengths.tolist()):
            cuts = ((part[1:] != part[:-1]).nonzero()[:, 0] + 1).tolist()[: macros - 1]
            while len(cuts) < macros - 1:
                ends = [0, *cuts, len(part)]
                longest = max(range(len(ends) - 1), key=lambda k: ends[k + 1] - ends[k])
                cuts.insert(longest, (ends[longest] + ends[longest + 1]) // 2)
            places = torch.zeros(len(part), dtype=torch.int64)
            places[cuts] = 1
            parts.append(places.cumsum(0))
        rows.append(torch.cat(parts))
    return torch.stack(rows) if rows else labels
