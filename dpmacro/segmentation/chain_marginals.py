"""The cheapest chain through every label of every frame.

With F(n, q) = E_q(n, q) of `chain`, the least cost of frames 1..n that go through macro-actions 0..q, and
B(n, q) that of frames n..N that go through q..S,

    V(n, q) = F'(n, q) + B'(n, q)
    F'(n, q) = min( F(n-1, q), F(n-1, q-1) + T_n(q-1, q) ), B' likewise with n+1 and q+1,

is the least cost of all other frames when frame n has label q. Before the first frame stands label 0, after
the last one S, at no cost. B is F of the trajectory walked backwards through S, S-1, ..., 0.
"""

import torch
from jaxtyping import Bool, Float, Int64, Num
from torch import Tensor

from dpmacro.segmentation.chain import chain_recursion, chain_transitions
from dpmacro.segmentation.padding import blocks_of, frames_inside, mirror, pad

__all__ = ["chain_costs_without"]


def chain_costs_without(
    costs: Num[Tensor, "frames macros"],
    lengths: Int64[Tensor, " trajectories"],
    reach: int,
    transition_costs: Num[Tensor, "frames macros macros"] | None,
) -> Float[Tensor, "frames macros"]:
    """V_n(q) of `costs_without` in chains; the arguments are as `checked` returns them."""
    parts = []
    for frames, part in blocks_of(costs, lengths):
        changes = chain_transitions(transition_costs, frames)
        parts.append(_costs_without(costs[frames].double(), part, reach, changes))
    return torch.cat(parts)


def _costs_without(
    costs: Tensor, lengths: Tensor, reach: int, changes: Tensor | None
) -> Float[Tensor, "frames macros"]:
    inside = frames_inside(lengths).to(costs.device)
    mirrored = mirror(lengths).to(costs.device)
    backwards = None
    if changes is not None:
        # Walked backwards, frame n-1 is the first after the change that frame n begins.
        backwards = changes.roll(-1, 0)[mirrored].flip(1)
    before = _Side(costs, inside, reach, changes)
    after = _Side(costs[mirrored].flip(1), inside, reach, backwards)

    def meeting(moves_before: int, moves_after: int) -> Tensor:
        """V where so many transitions at most lie among the left-out frames up to n, and after n."""
        return before.arrivals(moves_before) + after.arrivals(moves_after)[mirrored].flip(1)

    possible = _possible(lengths, costs.shape[1]).to(costs.device)
    if reach == 0:
        return meeting(1, 1).masked_fill_(~possible, torch.inf)
    found = torch.minimum(meeting(0, 1), meeting(1, 0)).masked_fill_(~possible, torch.inf)
    crowded = found.isinf().all(1, keepdim=True)
    if bool(crowded.any()):
        most = min(costs.shape[1] - 1, reach + 1)
        found = torch.where(crowded & possible, meeting(most, most), found)
    return found


class _Side:
    """The frames before those that are left out, of every frame."""

    def __init__(self, costs: Tensor, inside: Tensor, reach: int, changes: Tensor | None) -> None:
        self.inside = inside
        self.transitions = None if changes is None else pad(changes, inside)
        best, _ = chain_recursion(pad(costs, inside).cumsum(2), self.transitions)
        gap = min(reach + 1, best.shape[2])
        # F(n - reach - 1, q), [trajectories, macros, time].
        self.earlier = torch.full_like(best, torch.inf)
        self.earlier[:, 0, :gap] = 0
        self.earlier[:, :, gap:] = best[:, :, : best.shape[2] - gap]

    def arrivals(self, moves: int) -> Float[Tensor, "frames macros"]:
        """The least cost of these frames where n has label q after so many further transitions at most."""
        arriving = self.earlier
        for _ in range(moves):
            moved = arriving[:, :-1] if self.transitions is None else arriving[:, :-1] + self.transitions
            moved = torch.nn.functional.pad(moved, (0, 0, 1, 0), value=torch.inf)
            arriving = torch.minimum(self.earlier, moved)
        return arriving.movedim(2, 1)[self.inside]


def _possible(lengths: Int64[Tensor, " trajectories"], n_macros: int) -> Bool[Tensor, "frames macros"]:
    """Where a chain may have label q at frame n: q frames or more come before it, S - q or more after it."""
    ends = lengths.cumsum(0)
    frames = torch.arange(int(ends[-1]))
    before = (frames - (ends - lengths).repeat_interleave(lengths))[:, None]
    after = (ends.repeat_interleave(lengths) - 1 - frames)[:, None]
    macros = torch.arange(n_macros)
    return (macros <= before) & (n_macros - 1 - macros <= after)
