"""Stages in a fixed order: macro-labels 0, 1, ..., S in every trajectory, each held for one frame at least.

The recursion of `recursion` with one way into each macro-action: S transitions lead to macro-action s only
from s - 1, and each number of transitions belongs to one macro-action. With P_n(q) = sum_{k<=n} c_k(q),

    E_0(n, 0) = P_n(0)
    E_s(n, s) = P_n(s) + min_{s+1<=m<=n} [ E_{s-1}(m-1, s-1) + T_m(s-1, s) - P_{m-1}(s) ]

for s = 1..S and n = s+1..N, infinite for n <= s, where s + 1 segments do not fit; E_S(N, S) is the least cost
of any chain. One cumulative minimum a level over [trajectories, time], where the free order has one over
[trajectories, macros, time]. This is the partition into a known number of segments of Bellman (1961) and
Auger and Lawrence (1989), with costs that know their segment's place; a left-to-right (Bakis) hidden Markov
model searches the same labellings.
"""

import torch
from jaxtyping import Float, Int64, Num
from torch import Tensor

from dpmacro.segmentation.padding import blocks_of, frames_inside, pad

__all__ = ["chain_recursion", "chain_transitions", "cheapest_chain"]


def cheapest_chain(
    costs: Num[Tensor, "frames macros"],
    lengths: Int64[Tensor, " trajectories"],
    transition_costs: Num[Tensor, "frames macros macros"] | None,
) -> tuple[Int64[Tensor, "trajectories transitions"], Float[Tensor, " trajectories"]]:
    """Where macro-actions 1..S begin in every trajectory's cheapest chain, and what it costs; float64.

    The arguments are those of `segment`, as `checked` returns them. Frames count from 0 in each trajectory.
    """
    blocks = []
    for frames, part in blocks_of(costs, lengths):
        inside = frames_inside(part).to(costs.device)
        prefix = pad(costs[frames].double(), inside).cumsum(2)
        changes = chain_transitions(transition_costs, frames)
        best, running = chain_recursion(prefix, None if changes is None else pad(changes, inside))
        last = (part - 1).to(costs.device)
        blocks.append((_trace_back(running, last), best[:, -1].gather(1, last[:, None])[:, 0]))
    cuts, cost = (torch.cat(parts) for parts in zip(*blocks, strict=True))
    return cuts, cost


def chain_transitions(
    transition_costs: Num[Tensor, "frames macros macros"] | None, frames: slice
) -> Float[Tensor, "part transitions"] | None:
    """T_n(s-1, s) for s = 1..S, all that a chain reads of the transition costs, of some frames; float64."""
    return None if transition_costs is None else transition_costs[frames].diagonal(1, 1, 2).double()


def chain_recursion(
    prefix: Float[Tensor, "trajectories macros time"],
    transitions: Float[Tensor, "trajectories transitions time"] | None = None,
) -> tuple[Float[Tensor, "trajectories macros time"], Float[Tensor, "transitions trajectories arrivals"]]:
    """E_s(n, s) for s = 0..S, and the inner minimum over m for s = 1..S and n = 2..N.

    `prefix` are the sums P_n(q) of padded costs, time - 1 the number of arrivals.
    """
    best = torch.full_like(prefix, torch.inf)
    best[:, 0] = prefix[:, 0]
    n_trajectories, n_macros, n_frames = prefix.shape
    running = prefix.new_empty(n_macros - 1, n_trajectories, n_frames - 1)
    for s in range(1, n_macros):
        entry = best[:, s - 1, :-1] - prefix[:, s, :-1]
        if transitions is not None:
            entry += transitions[:, s - 1, 1:]
        running[s - 1] = entry.cummin(1).values
        torch.add(prefix[:, s, 1:], running[s - 1], out=best[:, s, 1:])
    return best, running


def _trace_back(
    running: Float[Tensor, "transitions trajectories arrivals"], last: Int64[Tensor, " trajectories"]
) -> Int64[Tensor, "trajectories transitions"]:
    """First frames of macro-actions 1..S from the inner minima, the last one first.

    A running minimum falls where a cheaper arrival is found: the earliest arrival that is as cheap as the
    cheapest up to `last` has as many larger minima before it as its place says.
    """
    cuts = last.new_empty(len(last), len(running))
    for s in reversed(range(len(running))):
        least = running[s].gather(1, last[:, None] - 1)
        cuts[:, s] = (running[s] > least).sum(1) + 1
        last = cuts[:, s] - 1
    return cuts
