"""How sure a segmentation is: the cheapest path through every label of every frame.

A forward and a backward pass of the segmentation's recursion meet at frame n. With F_s(n, q) the least cost
of frames 1..n that end in q with at most s transitions, and B_s(n, q) that of frames n..N that begin in q,

    V(n, q) = min_{s = 0..S} F'_s(n, q) + B'_{S-s}(n, q)
    F'_s(n, q) = min( F_s(n-1, q), min_{q'} [F_{s-1}(n-1, q') + T_n(q', q)] ), B' likewise with n+1,

is the least cost of all other frames when frame n has label q, and V + c the least cost of any path through q
there (a min-marginal). Those of chains are in `chain_marginals`.
"""

import torch
from jaxtyping import Float, Int64
from torch import Tensor

from dpmacro.segmentation.arguments import checked
from dpmacro.segmentation.chain_marginals import chain_costs_without
from dpmacro.segmentation.padding import blocks_of, frames_inside, mirror, pad
from dpmacro.segmentation.recursion import recursion
from dpmacro.segmentation.segments import follows_chain

__all__ = ["costs_without", "margins"]


def margins(
    costs: Float[Tensor, "frames macros"],
    lengths: Int64[Tensor, " trajectories"],
    max_transitions: int,
    labels: Int64[Tensor, " frames"],
    transition_costs: Float[Tensor, "frames macros macros"] | None = None,
    order: str = "free",
) -> Float[Tensor, " frames"]:
    """What the best path through another label would cost more, for every frame of an optimal segmentation.

    Args and errors are those of `segment`; `labels` is what it returned. 0 or more (up to rounding), in the
    unit of the costs; infinite where there is no other label: with one macro-action, and in a chain at frames
    where no other chain differs, as the first and the last of a trajectory. With order 'chain', labels that
    are none raise ValueError.
    """
    without = costs_without(costs, lengths, max_transitions, transition_costs=transition_costs, order=order)
    if order == "chain" and not follows_chain(labels, lengths, costs.shape[1]):
        raise ValueError(
            f"labels are no chain of {costs.shape[1]} macro-actions: give those that `segment` returns where "
            f"order is 'chain'"
        )
    marginals = costs + without
    own = torch.nn.functional.one_hot(labels, costs.shape[1]).bool()
    return marginals.masked_fill(own, torch.inf).amin(1) - marginals[own]


def costs_without(
    costs: Float[Tensor, "frames macros"],
    lengths: Int64[Tensor, " trajectories"],
    max_transitions: int,
    reach: int = 0,
    transition_costs: Float[Tensor, "frames macros macros"] | None = None,
    order: str = "free",
) -> Float[Tensor, "frames macros"]:
    """V_n(q): the least cost of all frames but n and `reach` on either side when n has label q; float64.

    Args and errors are those of `segment`. With a `reach` of 1 or more the frames left out hold one
    transition at most, which costs nothing but counts: frame n has the label of the frames before them or of
    those after them, at the ends of a trajectory that of the only side there is. (An excursion to another
    label and back within them would be free wherever the bound has slack, and every label of n as good as any
    other.)
    `reach` of 1 or more goes without transition costs (ValueError).

    With order 'chain', V_n(q) is infinite where no chain has label q at frame n: fewer than q frames come
    before it or fewer than S - q after it. The labels before a trajectory and after it are known, 0 and S, so
    that one transition may lie among the frames left out at its ends, too. Where no chain has as few as one
    there, which takes a trajectory of fewer than S + 2 reach + 2 frames, they hold any number.
    """
    costs, lengths, transition_costs = checked(costs, lengths, max_transitions, transition_costs, order)
    if reach < 0 or (reach > 0 and transition_costs is not None):
        raise ValueError(f"reach is {reach}: give 0 or more, and 0 with transition costs")
    if order == "chain":
        return chain_costs_without(costs, lengths, reach, transition_costs)
    parts = []
    for frames, part in blocks_of(costs, lengths):
        changes = None if transition_costs is None else transition_costs[frames].double()
        parts.append(_costs_without(costs[frames].double(), part, max_transitions, reach, changes))
    return torch.cat(parts)


def _costs_without(
    costs: Tensor, lengths: Tensor, max_transitions: int, reach: int, changes: Tensor | None
) -> Float[Tensor, "frames macros"]:
    inside = frames_inside(lengths).to(costs.device)
    mirrored = mirror(lengths).to(costs.device)
    backwards = None
    if changes is not None:
        # Walked backwards, frame n-1 is the first after the change that frame n begins.
        backwards = changes.roll(-1, 0).transpose(1, 2)[mirrored]
    before = _arrivals(costs, inside, max_transitions, reach, changes)
    after = _arrivals(costs[mirrored], inside, max_transitions, reach, backwards)
    if reach == 0:
        return (before[1] + after[1][:, mirrored].flip(0)).amin(0)
    ways = ((0, 1), (1, 0))  # a side that changes its label within the gap, and one that does not
    sums = [before[one] + after[other][:, mirrored].flip(0) for one, other in ways]
    found = torch.minimum(*sums).amin(0)
    return torch.where(found.isfinite(), found, 0.0)  # nothing outside the gap


def _arrivals(
    costs: Tensor, inside: Tensor, max_transitions: int, reach: int, changes: Tensor | None
) -> Float[Tensor, "2 bounds frames macros"]:
    """The least cost of the frames before n - reach, at most s transitions up to n: F_s(n - reach - 1, q)
    without a transition in between, and F'_s(n, q) with one or none.

    Where there are no such frames the former is infinite if `reach` is 1 or more, the latter 0.
    """
    transitions = None if changes is None else pad(changes, inside)
    best, _ = recursion(pad(costs, inside).cumsum(2), max_transitions, transitions)
    gap = reach + 1
    earlier = torch.nn.functional.pad(best, (gap, 0))[..., : best.shape[3]]  # nothing before costs nothing
    moved = earlier[:-1]
    if transitions is None:
        moved = moved.amin(2, keepdim=True)
    else:
        moved = (moved[:, :, :, None] + transitions).masked_fill(_stays(transitions), torch.inf).amin(2)
        moved[..., 0] = 0
    arriving = torch.cat([earlier[:1], torch.minimum(earlier[1:], moved)])
    if reach > 0:
        earlier = earlier.clone()
        earlier[..., :gap] = torch.inf
    return torch.stack([earlier, arriving]).movedim(4, 3)[:, :, inside]


def _stays(transitions: Tensor) -> Tensor:
    """True where q' = q, as [macros, macros, 1]."""
    return torch.eye(transitions.shape[1], dtype=torch.bool, device=transitions.device)[:, :, None]
