"""Macro-labels from per-frame costs, under a strict bound on the number of transitions.

The segmentation knows nothing of boosting: it sees a tensor of costs. It works by transitions rather
than by time. With P_n(q) = sum_{k<=n} c_k(q), the best cost of frames 1..n that ends in q with at most
s transitions is

    E_0(n, q) = P_n(q)
    E_s(n, q) = P_n(q) + min(0, min_{2<=m<=n} [ min_{q'!=q} (E_{s-1}(m-1, q') + T_m(q', q)) - P_{m-1}(q) ])

for n = 1..N and s = 1..S; m is the first frame after the last transition, and the 0 stands for no
transition at all. The inner minimum over m is a running minimum along time, so each s is one
``cummin`` over the padded batch [trajectories, macros, time]. Where the macro-actions have a fixed order,
the recursion is that of `chain`.
"""

from dataclasses import dataclass
from itertools import pairwise

import torch
from jaxtyping import Float, Int64
from torch import Tensor

from dpmacro.segmentation.arguments import checked
from dpmacro.segmentation.chain import cheapest_chain
from dpmacro.segmentation.padding import blocks_of, frames_inside, pad
from dpmacro.segmentation.segments import chain_labels
from dpmacro.utils.tensors import ArrayLike

__all__ = ["Segmentation", "cost_of", "recursion", "segment"]


@dataclass(frozen=True)
class Segmentation:
    """The cheapest macro-labels under a bound on transitions, or in the order of a chain."""

    labels: Int64[Tensor, " frames"]  # 0..Q-1
    cost: Float[Tensor, " trajectories"]  # of these labels, transition costs included; float64
    # Best cost with at most s = 0..S transitions; float64. Of a chain one column, `cost`: with fewer
    # transitions there is none.
    cost_by_bound: Float[Tensor, "trajectories bounds"]


def segment(
    costs: ArrayLike,
    lengths: ArrayLike,
    max_transitions: int,
    transition_costs: ArrayLike | None = None,
    order: str = "free",
) -> Segmentation:
    """The labels that minimise sum_n c_n(q_n) + sum_{n: q_n != q_{n+1}} T with at most S transitions.

    Args:
        costs: [frames, macros], c_n(q) of every frame, trajectories concatenated; finite.
        lengths: [trajectories], frames of each, at least 1; they add up to the number of frames.
        max_transitions: S, 0 to 2^20, the bound in every single trajectory.
        transition_costs: [frames, macros, macros], T_n(q', q), the cost of frame n being the first after
            a change from q' to q; finite where q' != q; the first frame of a trajectory and the diagonal
            are never read.
        order: 'free', any macro-action after any other, S transitions at most; or 'chain', macro-actions
            0, 1, ..., S one after the other in every trajectory, so exactly S transitions. A chain has
            S + 1 macro-actions, takes S + 1 frames or more, and reads T_n(q - 1, q) only.

    Of equally cheap labellings one with the fewest transitions comes back, and always the same one; of
    equally cheap chains the one whose last transition is earliest, then the last but one, and so on.
    Works on the device of `costs`, in float64 since prefix sums cancel.

    Raises ValueError naming the argument: costs that are not finite, a trajectory without frames, lengths
    that do not add up, a bound that is negative or no whole number, another order; for a chain, a number of
    macro-actions other than S + 1 or a trajectory with fewer frames.
    """
    costs, lengths, transition_costs = checked(costs, lengths, max_transitions, transition_costs, order)
    if order == "chain":
        cuts, cost = cheapest_chain(costs, lengths, transition_costs)
        return Segmentation(chain_labels(cuts, lengths), cost, cost[:, None])
    blocks = []
    for frames, part in blocks_of(costs, lengths):
        changes = None if transition_costs is None else transition_costs[frames].double()
        blocks.append(_segment_block(costs[frames].double(), part, max_transitions, changes))
    labels, cost_by_bound = (torch.cat(parts) for parts in zip(*blocks, strict=True))
    return Segmentation(labels, cost_by_bound[:, -1], cost_by_bound)


def cost_of(
    labels: Int64[Tensor, " frames"],
    costs: Float[Tensor, "frames macros"],
    lengths: Int64[Tensor, " trajectories"],
    transition_costs: Float[Tensor, "frames macros macros"] | None = None,
) -> Float[Tensor, ""]:
    """sum_n c_n(q_n) + sum_{n: q_n != q_{n+1}} T of given labels, over all trajectories; float64.

    Labels in any order: those of a chain cost the same sum.
    """
    total = costs.double().gather(1, labels[:, None]).sum()
    if transition_costs is None:
        return total
    changed = torch.zeros_like(labels, dtype=torch.bool)
    changed[1:] = labels[1:] != labels[:-1]
    changed[(lengths.cumsum(0) - lengths).to(labels.device)] = False
    after = changed.nonzero()[:, 0]
    return total + transition_costs.double()[after, labels[after - 1], labels[after]].sum()


def _segment_block(
    costs: Tensor, lengths: Tensor, max_transitions: int, transition_costs: Tensor | None
) -> tuple[Tensor, Tensor]:
    """Labels [frames] and least costs [trajectories, bounds] of some trajectories, padded to one length."""
    inside = frames_inside(lengths).to(costs.device)
    last = (lengths - 1).to(costs.device)
    prefix = pad(costs, inside).cumsum(2)  # [trajectories, macros, time]
    transitions = None if transition_costs is None else pad(transition_costs, inside)
    best, entries = recursion(prefix, max_transitions, transitions)
    by_bound = _at(best, last).amin(2).T
    labels = _trace_back(best, entries, transitions, by_bound, last)
    missing = max_transitions + 1 - by_bound.shape[1]
    return labels[inside], torch.cat([by_bound, by_bound[:, -1:].expand(-1, missing)], 1)


def recursion(
    prefix: Float[Tensor, "trajectories macros time"],
    max_transitions: int,
    transitions: Float[Tensor, "trajectories macros macros time"] | None = None,
) -> tuple[Float[Tensor, "bounds trajectories macros time"], list[Float[Tensor, "..."]]]:
    """E_s(n, q) for s = 0..S, and for s = 1.. the cheapest arrivals at frames m = 2..N.

    `prefix` are the sums P_n(q) of padded costs. An arrival is min over q' of E_{s-1}(m-1, q') + T_m(q', q),
    [trajectories, 1 or Q, time - 1]. There are fewer levels than S + 1 where more transitions cannot be.
    """
    levels = min(max_transitions, prefix.shape[2] - 1) if prefix.shape[1] > 1 else 0
    best = prefix.new_empty(levels + 1, *prefix.shape)
    best[0] = prefix
    entries = []
    for before, after in pairwise(best):
        entries.append(_cheapest_entry(before, transitions))
        gain = (entries[-1] - prefix[:, :, :-1]).cummin(2).values.clamp_(max=0)
        after[:, :, 0] = prefix[:, :, 0]
        torch.add(prefix[:, :, 1:], gain, out=after[:, :, 1:])
    return best, entries


def _cheapest_entry(best: Tensor, transitions: Tensor | None) -> Tensor:
    """Min over q' of E(m-1, q') + T_m(q', q) for m = 2..N, [trajectories, 1 or Q, time - 1].

    Where transitions cost nothing, q' = q need not be left out: arriving from the same macro-action is never
    cheaper than staying in it, and the minimum is one for all q.
    """
    if transitions is None:
        return best[:, :, :-1].amin(1, keepdim=True)
    arriving = best[:, :, None, :-1] + transitions[..., 1:]
    return arriving.masked_fill_(_diagonal(best), torch.inf).amin(1)


def _diagonal(best: Tensor) -> Tensor:
    """True where q' = q, as [macros, macros, 1]."""
    return torch.eye(best.shape[1], dtype=torch.bool, device=best.device)[:, :, None]


def _trace_back(
    best: Tensor, entries: list[Tensor], transitions: Tensor | None, by_bound: Tensor, last: Tensor
) -> Int64[Tensor, "trajectories time"]:
    """Labels from the recursion's costs, all trajectories at once, last segment first.

    The recursion keeps no arguments: those on the way back are few, and found again from the costs.
    """
    rows = torch.arange(len(last), device=last.device)
    level = (by_bound <= by_bound[:, -1:]).int().argmax(1)  # the smallest bound that is as cheap
    macro = best[level, rows, :, last].argmin(1)
    time = torch.arange(best.shape[3], device=last.device)
    labels = macro[:, None].repeat(1, len(time))
    if not entries:
        return labels
    arrivals = torch.stack(entries)
    for _ in entries:
        below = (level - 1).clamp(min=0)
        gain = arrivals[below, rows, macro.clamp(max=arrivals.shape[2] - 1)] - best[0, rows, macro, :-1]
        least = gain.masked_fill_(time[1:] > last[:, None], torch.inf).min(1)
        moved = (least.values < 0) & (level > 0)
        source = best[below, rows, :, least.indices]
        if transitions is not None:
            source = source + transitions[rows, :, macro, least.indices + 1]
            source[rows, macro] = torch.inf
        macro = torch.where(moved, source.argmin(1), macro)
        last = torch.where(moved, least.indices, last)
        level = torch.where(moved, below, 0)
        labels = torch.where(moved[:, None] & (time <= last[:, None]), macro[:, None], labels)
    return labels


def _at(values: Tensor, time: Tensor) -> Tensor:
    """values[s, i, q, time[i]] as [bounds, trajectories, macros]."""
    place = time[:, None, None].expand(*values.shape[:3], 1)
    return values.gather(3, place).squeeze(3)
