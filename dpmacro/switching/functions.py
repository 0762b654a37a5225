"""Switch functions: when to leave a macro-action (Section IV of the paper).

For every observed change q -> q' a binary strong classifier H_q^q' tells, frame by frame, whether it is due;
`switching/training.py` fits them. A planner knows what it has just done: a switch function may fire only after an action that comes before its changes in demonstrations, its cues.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int64
from torch import Tensor

from dpmacro.boosting.learners.base import StrongClassifier

__all__ = [
    "Event",
    "SwitchFunctions",
    "causal_labels",
    "cued",
    "macro_segments",
    "starting_macro",
]


@dataclass(frozen=True)
class SwitchFunctions:
    """One switch function for every observed change, the same order throughout.

    Attributes:
        pairs: (from, to) macro-actions.
        thresholds: it fires where its score is above.
        detected: share, 0 to 1, of the segments before its change where, by `held_out`, it fires at the
            change and never before.
        held_out: score of every frame by a function that never saw its trajectory, -18 where it may not fire.
        classifier: one binary problem per switch function; None where nothing ever changes.
        cues: actions that each may follow; none stands for any.
        left_out: False where there was one trajectory alone, whose `held_out` is by what learned from it.
    """

    pairs: list[tuple[int, int]]
    thresholds: Float[Tensor, " switches"]
    detected: Float[Tensor, " switches"]
    held_out: Float[Tensor, "frames switches"]
    classifier: StrongClassifier | None
    cues: tuple[tuple[int, ...], ...] = ()
    left_out: bool = True


@dataclass(frozen=True)
class Event:
    """A segment of a macro-action and what follows it, in frames of the concatenated data."""

    trajectory: int
    macro: int
    start: int
    stop: int
    following: int | None  # the next macro-action; None at the end of the trajectory
    following_stop: int  # end of the next segment; `stop` where there is none


def macro_segments(labels: Int64[Tensor, " frames"], lengths: Int64[Tensor, " trajectories"]) -> list[Event]:
    """The segments of constant macro-label, in order, each with its successor in the trajectory."""
    events = []
    first = 0
    for trajectory, part in enumerate(labels.cpu().split(lengths.tolist())):
        macros, counts = part.unique_consecutive(return_counts=True)
        bounds = (counts.cumsum(0) + first).tolist()
        starts = [first, *bounds[:-1]]
        for k, macro in enumerate(macros.tolist()):
            follows = k + 1 < len(bounds)
            following = int(macros[k + 1]) if follows else None
            events.append(Event(trajectory, macro, starts[k], bounds[k], following, bounds[k + follows]))
        first = bounds[-1]
    return events


def starting_macro(labels: Int64[Tensor, " frames"], lengths: Int64[Tensor, " trajectories"]) -> int:
    """The macro-action that most trajectories start with."""
    starts = torch.nn.functional.pad(lengths.cumsum(0)[:-1], (1, 0)).to(labels.device)
    return int(labels[starts].mode().values)


def cued(
    actions: Int64[Tensor, " frames"],
    lengths: Int64[Tensor, " trajectories"],
    cues: Sequence[Sequence[int]],
) -> Bool[Tensor, "frames switches"]:
    """Whether each switch function may fire at a frame; none may at the first of a trajectory."""
    actions = actions.cpu()
    before = torch.nn.functional.pad(actions[:-1], (1, 0), value=-1)
    before[(lengths.cumsum(0) - lengths).cpu()] = -1
    return torch.stack([torch.isin(before, torch.tensor(own)) for own in cues], 1)


def causal_labels(
    scores: Float[Tensor, "frames switches"],
    thresholds: Float[Tensor, " switches"],
    pairs: list[tuple[int, int]],
    lengths: Int64[Tensor, " trajectories"],
    first_macro: int,
) -> Int64[Tensor, " frames"]:
    """The macro-labels that the switch functions choose as they run, frame by frame, never looking ahead."""
    labels = torch.full((len(scores),), first_macro, dtype=torch.int64)
    for start, length in zip((lengths.cumsum(0) - lengths).tolist(), lengths.tolist(), strict=True):
        stop, frame, macro = start + length, start, first_macro
        while True:
            own = torch.tensor([source == macro for source, _ in pairs], dtype=torch.bool)
            excess = (scores[frame:stop] - thresholds)[:, own]
            firing = (excess > 0).any(1).nonzero()
            if not len(firing):
                break
            frame += int(firing[0])
            macro = [pair for pair in pairs if pair[0] == macro][int(excess[int(firing[0])].argmax())][1]
            labels[frame:stop] = macro
            frame += 1
    return labels
