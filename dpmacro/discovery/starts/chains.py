"""Chains: macro-actions 0, 1, ..., Q - 1 in this order, each once, in every trajectory."""

import torch
from jaxtyping import Float, Int64
from torch import Tensor

from dpmacro.segmentation.recursion import frames_inside, pad

__all__ = ["chained", "cheapest_chain"]


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


def cheapest_chain(
    costs: Float[Tensor, "frames macros"], lengths: Int64[Tensor, " trajectories"]
) -> Int64[Tensor, " frames"]:
    """The chain of least cost: with P_n(q) the sum of c_k(q) over k <= n,

        E_q(n) = P_n(q) + min_{m < n} [ E_{q-1}(m) - P_m(q) ],   E_0(n) = P_n(0)

    and E_q(n) infinite for n <= q. Every trajectory has Q frames at least.
    """
    inside = frames_inside(lengths)
    prefix = torch.nn.functional.pad(pad(costs.double(), inside).cumsum(2), (1, 0))  # P_0 = 0 first
    n_macros = prefix.shape[1]
    best = prefix[:, 0].clone()
    best[:, 0] = torch.inf
    entries = []
    for macro in range(1, n_macros):
        entries.append(best[:, :-1] - prefix[:, macro, :-1])
        best = torch.full_like(best, torch.inf)
        best[:, 1:] = prefix[:, macro, 1:] + entries[-1].cummin(1).values
    time = torch.arange(inside.shape[1])
    labels = torch.zeros(inside.shape, dtype=torch.int64)
    last = lengths.clone()
    for entry in reversed(entries):
        last = entry.masked_fill(time >= last[:, None], torch.inf).argmin(1)
        labels += time >= last[:, None]
    return labels[inside]
