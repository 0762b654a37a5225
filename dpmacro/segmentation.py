"""Macro-labels from per-frame costs, under a strict bound on the number of transitions.

The segmentation knows nothing of boosting: it sees a tensor of costs. It works by transitions rather
than by time. With P_n(q) = sum_{k<=n} c_k(q), the best cost of frames 1..n that ends in q with at most
s transitions is

    E_0(n, q) = P_n(q)
    E_s(n, q) = P_n(q) + min(0, min_{2<=m<=n} [ min_{q'!=q} (E_{s-1}(m-1, q') + T_m(q', q)) - P_{m-1}(q) ])

for n = 1..N and s = 1..S; m is the first frame after the last transition, and the 0 stands for no
transition at all. The inner minimum over m is a running minimum along time, so each s is one
``cummin`` over the padded batch [trajectories, macros, time].
"""

from dataclasses import dataclass

import torch
from jaxtyping import Float, Int64
from torch import Tensor

__all__ = ["Segmentation", "segment", "transition_counts"]


@dataclass(frozen=True)
class Segmentation:
    """The cheapest macro-labels under a bound on transitions."""

    labels: Int64[Tensor, " frames"]  # 0..Q-1
    cost: Float[Tensor, " trajectories"]  # of these labels, transition costs included; float64
    cost_by_bound: Float[
        Tensor, "trajectories bounds"
    ]  # best cost with at most s = 0..S transitions; float64


def segment(
    costs: Float[Tensor, "frames macros"],
    lengths: Int64[Tensor, " trajectories"],
    max_transitions: int,
    transition_costs: Float[Tensor, "..."] | None = None,
) -> Segmentation:
    """The labels that minimise sum_n c_n(q_n) + sum_{n: q_n != q_{n+1}} T with at most S transitions.

    Args:
        costs: c_n(q) of every frame, trajectories concatenated; finite.
        lengths: frames of each trajectory, at least 1 each; they add up to the number of frames.
        max_transitions: S >= 0, the bound in every single trajectory.
        transition_costs: [frames, macros, macros], T_n(q', q), the cost of frame n being the first after
            a change from q' to q; finite where q' != q; the first frame of a trajectory and the diagonal
            are never read.

    Of equally cheap labellings one with the fewest transitions comes back, and always the same one.
    Works on the device of `costs`, in float64 since prefix sums cancel.

    Raises ValueError for costs that are not finite, an empty trajectory, lengths that do not add up
    and a negative bound.
    """
    _check(costs, lengths, max_transitions, transition_costs)
    n_macros = costs.shape[1]
    padded = _pad(costs.double(), lengths).transpose(1, 2)  # [trajectories, macros, time]
    padded_transitions = None
    if transition_costs is not None:
        padded_transitions = _pad(transition_costs.double(), lengths).permute(0, 2, 3, 1)
    prefix = padded.cumsum(2)
    last = (lengths - 1).to(costs.device)

    best = prefix  # E_s(n, q)
    ends = [_at(best, last)]  # [trajectories, macros] for every s
    starts: list[Tensor] = []  # first frame after the last transition, 0 where there is none
    sources: list[Tensor] = []  # the macro-action before it
    for _ in range(min(max_transitions, padded.shape[2] - 1) if n_macros > 1 else 0):
        entry, source = _cheapest_entry(best, padded_transitions)
        gain, start = (entry - prefix[:, :, :-1]).cummin(2)
        stays = torch.zeros_like(prefix)
        stays[:, :, 1:] = gain.clamp(max=0)
        moved = torch.zeros_like(prefix, dtype=torch.int64)
        moved[:, :, 1:] = torch.where(gain < 0, start + 1, 0)
        best = prefix + stays
        ends.append(_at(best, last))
        starts.append(moved)
        sources.append(source)
    by_bound = torch.stack([end.min(1).values for end in ends], 1)
    labels = _trace_back(torch.stack(ends, 1), by_bound, starts, sources, lengths)
    missing = max_transitions + 1 - by_bound.shape[1]
    cost_by_bound = torch.cat([by_bound, by_bound[:, -1:].expand(-1, missing)], 1)
    return Segmentation(labels, cost_by_bound[:, -1], cost_by_bound)


def transition_counts(
    labels: Int64[Tensor, " frames"], lengths: Int64[Tensor, " trajectories"]
) -> Int64[Tensor, " trajectories"]:
    """The number of frames whose macro-label differs from the one before, for every trajectory."""
    changed = torch.zeros_like(labels)
    changed[1:] = (labels[1:] != labels[:-1]).long()
    ends = lengths.to(labels.device).cumsum(0)
    changed[ends[:-1]] = 0
    total = torch.nn.functional.pad(changed.cumsum(0), (1, 0))
    return total[ends] - total[torch.nn.functional.pad(ends[:-1], (1, 0))]


def _cheapest_entry(best: Tensor, transitions: Tensor | None) -> tuple[Tensor, Tensor]:
    """Min and argmin over q' != q of E(m-1, q') + T_m(q', q), for m = 2..N.

    Both come as [trajectories, macros, time - 1].
    """
    n_macros = best.shape[1]
    arriving = best[:, :, None, :-1].expand(-1, -1, n_macros, -1)  # [trajectories, from, to, time - 1]
    if transitions is not None:
        arriving = arriving + transitions[..., 1:]
    same = torch.eye(n_macros, dtype=torch.bool, device=best.device)[:, :, None]
    entry, source = arriving.masked_fill(same, torch.inf).min(1)
    return entry, source


def _trace_back(
    ends: Tensor, by_bound: Tensor, starts: list[Tensor], sources: list[Tensor], lengths: Tensor
) -> Tensor:
    """Labels [frames] from the recursion's arguments, all trajectories at once, last segment first."""
    n_trajectories = len(ends)
    rows = torch.arange(n_trajectories, device=ends.device)
    level = (by_bound <= by_bound[:, -1:]).int().argmax(1)  # the smallest bound that is as cheap
    macro = ends[rows, level].argmin(1)
    stop = lengths.to(ends.device)
    time = torch.arange(int(lengths.max()), device=ends.device)
    labels = torch.zeros(n_trajectories, len(time), dtype=torch.int64, device=ends.device)
    never = torch.zeros(n_trajectories, ends.shape[2], len(time), dtype=torch.int64, device=ends.device)
    start_of = torch.stack([never, *starts])
    source_of = torch.stack(sources) if sources else never[None]
    for _ in range(len(starts) + 1):
        first = start_of[level, rows, macro, stop - 1]
        labels = torch.where((time >= first[:, None]) & (time < stop[:, None]), macro[:, None], labels)
        moved = first > 0
        source = source_of[(level - 1).clamp(min=0), rows, macro, (first - 1).clamp(min=0)]
        macro = torch.where(moved, source, macro)
        level = torch.where(moved, level - 1, 0)
        stop = torch.where(moved, first, stop)
    return labels[time < lengths.to(ends.device)[:, None]]


def _pad(values: Tensor, lengths: Tensor) -> Tensor:
    """Concatenated frames as [trajectories, time, ...], zeros after the end of each."""
    return torch.nn.utils.rnn.pad_sequence(values.split(lengths.tolist()), batch_first=True)


def _at(values: Tensor, time: Tensor) -> Tensor:
    """values[i, q, time[i]] as [trajectories, macros]."""
    return values.gather(2, time[:, None, None].expand(-1, values.shape[1], 1)).squeeze(2)


def _check(costs: Tensor, lengths: Tensor, max_transitions: int, transition_costs: Tensor | None) -> None:
    if max_transitions < 0:
        raise ValueError(f"max_transitions is {max_transitions}: the bound on transitions must be 0 or more")
    if costs.ndim != 2 or costs.shape[1] == 0:
        raise ValueError(f"costs have shape {tuple(costs.shape)}: give [frames, macros], one macro at least")
    if len(lengths) == 0:
        raise ValueError("lengths are empty: give the number of frames of one trajectory at least")
    if int(lengths.min()) < 1:
        empty = int(lengths.argmin())
        raise ValueError(f"trajectory {empty} has {int(lengths[empty])} frames: each needs one at least")
    if int(lengths.sum()) != len(costs):
        raise ValueError(f"lengths add up to {int(lengths.sum())} frames but costs have {len(costs)}")
    bad = (~costs.isfinite()).nonzero()
    if len(bad):
        frame, macro = bad[0].tolist()
        value = costs[frame, macro].item()
        raise ValueError(f"the cost of frame {frame}, macro {macro} is {value}: costs must be finite")
    if transition_costs is None:
        return
    wanted = (*costs.shape, costs.shape[1])
    if tuple(transition_costs.shape) != wanted:
        raise ValueError(f"transition_costs have shape {tuple(transition_costs.shape)}: give {wanted}")
    off_diagonal = ~torch.eye(costs.shape[1], dtype=torch.bool, device=costs.device)
    if not bool(transition_costs[:, off_diagonal].isfinite().all()):
        raise ValueError("transition_costs hold NaN or infinity off the diagonal: they must be finite")
