"""Macro-actions cut once more: a search in the stretches of each, as in trajectories of their own.

A task of many macro-actions in a row is hard to cut at once: a candidate has to hit every change of a
demonstration. Cut in two first, each part is a smaller task, which the same search cuts in two again.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Int64
from torch import Tensor

from dpmacro.discovery.criteria import CandidateScores, standard_error
from dpmacro.discovery.fields import part_of
from dpmacro.discovery.result import Discovery
from dpmacro.discovery.task import Task
from dpmacro.features.levels import SortedLevels
from dpmacro.segmentation.segments import macro_segments, transition_counts

__all__ = ["divided", "pays"]

Halving = Callable[[SortedLevels, Task], Discovery]


def divided(
    data: SortedLevels, task: Task, labels: Int64[Tensor, " frames"], search: Halving
) -> Int64[Tensor, " frames"]:
    """Labels 0.. with macro-actions cut in two wherever this pays, within the Q and S of the task.

    Args:
        data: levels of every frame.
        task: whose frames `labels` cut.
        labels: a segmentation.
        search: finds two macro-actions in the stretches of one, given as trajectories.
    """
    labels = labels.unique(return_inverse=True)[1]
    number, parts = int(labels.max()) + 1, list[_Part]()
    fresh: Sequence[int] = range(number)
    while number < task.macros and _most_transitions(labels, task) < task.max_transitions:
        parts += [_parted(data, task, labels, macro, search) for macro in fresh]
        fitting = [
            part
            for part in parts
            if part.saved > 0 and _most_transitions(part.cut(labels, number), task) <= task.max_transitions
        ]
        if not fitting:
            break
        best = max(fitting, key=lambda part: part.saved)
        labels = best.cut(labels, number)
        parts.remove(best)
        fresh, number = (best.macro, number), number + 1
    return labels


def _most_transitions(labels: Int64[Tensor, " frames"], task: Task) -> int:
    return int(transition_counts(labels, task.lengths).max())


def pays(scores: CandidateScores) -> bool:
    """Whether a policy can run a segmentation, and gains more by it than a standard error."""
    return scores.runnable and scores.gain > standard_error(scores.alone - scores.causal)


@dataclass(frozen=True, eq=False)
class _Part:
    """A macro-action, and how it would be cut."""

    macro: int
    saved: float  # nats, of all its frames; 0 where cutting it does not pay
    second: Bool[Tensor, " frames"]  # of all frames, those of its second half

    def cut(self, labels: Int64[Tensor, " frames"], number: int) -> Int64[Tensor, " frames"]:
        """The labels, with this number for the second half."""
        return torch.where(self.second, number, labels)


def _parted(
    data: SortedLevels, task: Task, labels: Int64[Tensor, " frames"], macro: int, search: Halving
) -> _Part:
    """How the search would cut a macro-action, each of its segments once at most."""
    own = [one for one in macro_segments(labels, task.lengths) if one.macro == macro]
    frames, second = labels == macro, torch.zeros_like(labels, dtype=torch.bool)
    lengths = torch.tensor([one.stop - one.start for one in own])
    groups = task.groups[torch.tensor([one.trajectory for one in own])]
    if int(lengths.max()) < 2 or len(groups.unique()) < 2:
        return _Part(macro, 0.0, second)
    given = {"lengths": lengths, "groups": groups, "macros": 2, "max_transitions": 1}
    found = search(*part_of(data, task, frames, **given))
    scores = found.kept.scores
    second[frames] = found.kept.labels == found.kept.used[-1]
    worth = len(found.kept.used) == 2 and pays(scores)
    return _Part(macro, scores.gain * int(frames.sum()) * worth, second)
