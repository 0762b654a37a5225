"""Macro-labels as segments: stretches of constant label, the transitions between them, the first of each."""

from dataclasses import dataclass

import torch
from jaxtyping import Int64
from torch import Tensor

__all__ = [
    "Segment",
    "chain_labels",
    "distinct",
    "follows_chain",
    "macro_segments",
    "starting_macros",
    "transition_counts",
]


@dataclass(frozen=True)
class Segment:
    """A stretch of constant macro-label and what follows it, in frames of the concatenated data."""

    trajectory: int
    macro: int
    start: int
    stop: int
    following: int | None  # the next macro-action; None at the end of the trajectory
    following_stop: int  # end of the next segment; `stop` where there is none


def macro_segments(
    labels: Int64[Tensor, " frames"], lengths: Int64[Tensor, " trajectories"]
) -> list[Segment]:
    """The segments of constant macro-label, in order, each with its successor in the trajectory."""
    segments = []
    first = 0
    for trajectory, part in enumerate(labels.cpu().split(lengths.tolist())):
        macros, counts = part.unique_consecutive(return_counts=True)
        bounds = (counts.cumsum(0) + first).tolist()
        starts = [first, *bounds[:-1]]
        for k, macro in enumerate(macros.tolist()):
            follows = k + 1 < len(bounds)
            following = int(macros[k + 1]) if follows else None
            segments.append(Segment(trajectory, macro, starts[k], bounds[k], following, bounds[k + follows]))
        first = bounds[-1]
    return segments


def starting_macros(
    labels: Int64[Tensor, " frames"], lengths: Int64[Tensor, " trajectories"]
) -> Int64[Tensor, " trajectories"]:
    """The macro-action that every trajectory starts with."""
    return labels.cpu()[(lengths.cumsum(0) - lengths).cpu()]


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


def chain_labels(
    cuts: Int64[Tensor, "trajectories transitions"], lengths: Int64[Tensor, " trajectories"]
) -> Int64[Tensor, " frames"]:
    """Labels 0, 1, ..., S in every trajectory i, where macro-action s begins at frame `cuts[i, s - 1]`.

    Frames count from 0 in each trajectory. The labels are on the device of `cuts`. Raises ValueError naming
    the trajectory whose cuts do not rise within 1..N_i - 1.
    """
    n_transitions = cuts.shape[1]
    starts = (lengths.cumsum(0) - lengths).to(cuts.device)
    ends = lengths.to(cuts.device)[:, None]
    wrong = (torch.cat([torch.zeros_like(ends), cuts, ends], 1).diff(dim=1) < 1).any(1)
    if bool(wrong.any()):
        place = int(wrong.nonzero()[0])
        raise ValueError(
            f"cuts[{place}] are {cuts[place].tolist()}: give {n_transitions} frames that rise within 1 to "
            f"{int(lengths[place]) - 1}, as the trajectory has {int(lengths[place])}"
        )
    begins = torch.zeros(int(lengths.sum()), dtype=torch.int64, device=cuts.device)
    begins[(starts[:, None] + cuts).flatten()] = 1
    begins[starts[1:]] = -n_transitions
    return begins.cumsum(0)


def follows_chain(
    labels: Int64[Tensor, " frames"], lengths: Int64[Tensor, " trajectories"], macros: int
) -> bool:
    """Whether labels go 0, 1, ..., `macros` - 1 in every trajectory, each held for one frame at least."""
    ends = lengths.to(labels.device).cumsum(0)
    starts = torch.nn.functional.pad(ends[:-1], (1, 0))
    steps = labels.diff()
    steps[ends[:-1] - 1] = 0
    begun_and_ended = (labels[starts] == 0) & (labels[ends - 1] == macros - 1)
    return bool(((steps == 0) | (steps == 1)).all() & begun_and_ended.all())


def distinct(labellings: Int64[Tensor, "labellings frames"], similar: float = 0.99) -> Int64[Tensor, " kept"]:
    """The first of every group of labellings that agree on `similar` of the frames, labels taken as named."""
    kept: list[int] = []
    for k, labels in enumerate(labellings):
        if all(float((labels == labellings[other]).float().mean()) < similar for other in kept):
            kept.append(k)
    return torch.tensor(kept)
