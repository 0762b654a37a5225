"""Of many demonstrations some are enough to search: which they are, and what they say of the others.

Every start, every candidate and every rule that chooses among them costs time for each frame. What is found
in a few dozen whole trajectories is found in more, so a search runs on some drawn at random. The labels of
the others are those of least cost under classifiers of the ones that were searched; the final fit, which
labels all of them anew, sees every frame.
"""

from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Int64
from torch import Tensor

from dpmacro.boosting.learners.stumps import StumpLearner
from dpmacro.boosting.loop import Boosting
from dpmacro.discovery.task import Task
from dpmacro.features.levels import SortedLevels
from dpmacro.segmentation.recursion import segment

__all__ = ["Field", "drawn_of", "extended", "field_of", "given_field"]

FRAMES = 6_000  # that a search is run on at least,
TRAJECTORIES = 20  # and so many trajectories,
MOST = 24_000  # but no more once there are so many frames
ROUNDS = 60  # of the classifiers that label the others
STEP = 0.3
COLUMNS = 48  # random ones searched a round
CHUNK = 2**14  # frames scored at a time


@dataclass(frozen=True)
class Field:
    """What a search runs on: all data, or some whole trajectories of it."""

    data: SortedLevels
    task: Task
    drawn: Bool[Tensor, " trajectories"] | None  # of all trajectories; None where all are


def field_of(data: SortedLevels, task: Task) -> Field:
    """All trajectories, or random ones until there are enough of them and of their frames.

    Those with given labels are drawn first. The draw depends on the task's seed and lengths alone, so tasks
    that differ in Q, S or order have the same field.
    """
    shown = None
    if task.given is not None:
        shown = torch.tensor([bool(part.any()) for part in task.known.held.split(task.lengths.tolist())])
    drawn = drawn_of(task.lengths, task.seed, shown)
    if bool(drawn.all()):
        return Field(data, task, None)
    frames = drawn.repeat_interleave(task.lengths)
    parts = {"lengths": task.lengths[drawn], "groups": task.groups[drawn]}
    return Field(*_part(data, task, frames, **parts), drawn)


def given_field(data: SortedLevels, task: Task) -> Field:
    """The frames whose labels are given, whatever trajectories they are of."""
    return Field(*_part(data, task, task.known.held), None)


def extended(
    data: SortedLevels,
    task: Task,
    field: Field,
    labels: Int64[Tensor, " some"],
    max_transitions: int | None = None,
) -> Int64[Tensor, " frames"]:
    """Labels of all frames, as classifiers of a field's `labels` want them within the bounds.

    `max_transitions` takes the place of the task's where the order is free and no label is given. No frame
    gets a macro-action that has none in the field, and labels that are given stay.
    """
    generator = torch.Generator().manual_seed(task.seed)
    used, own = labels.unique(return_inverse=True)
    learner = StumpLearner(field.data, drawn=COLUMNS)
    targets = task.loss.targets(field.task.actions)
    boosting = Boosting(learner, targets, len(used), STEP, generator, loss=task.loss)
    held = torch.nn.functional.one_hot(own, len(used)).float().to(learner.device)
    for _ in range(ROUNDS):
        boosting.round(held)
    strong, targets = boosting.strong(), task.loss.targets(task.actions)
    strong, chunks = StumpLearner(data, drawn=COLUMNS).shown(strong, data.n_frames, CHUNK)
    parts = zip(chunks, targets.split(CHUNK), strict=True)
    costs = torch.cat([task.loss.terms(strong.scores(frames), wanted).sum(2) for frames, wanted in parts])
    bound = task.max_transitions if max_transitions is None else max_transitions
    if task.given is None and task.order == "free":
        return used[segment(costs, task.lengths, bound).labels.cpu()]
    whole = costs.new_full((len(costs), task.macros), float(costs.max()) + 1)
    whole[:, used.to(costs.device)] = costs
    return segment(task.held(whole), task.lengths, task.max_transitions, order=task.order).labels.cpu()


def drawn_of(
    lengths: Int64[Tensor, " trajectories"], seed: int, first: Bool[Tensor, " trajectories"] | None = None
) -> Bool[Tensor, " trajectories"]:
    """Which trajectories of these lengths a search looks at; those that `first` names before the others."""
    order = torch.randperm(len(lengths), generator=torch.Generator().manual_seed(seed))
    if first is not None:
        order = torch.cat([order[first[order]], order[~first[order]]])
    before = lengths[order].cumsum(0) - lengths[order]
    wanted = (before < FRAMES) | ((torch.arange(len(order)) < TRAJECTORIES) & (before < MOST))
    drawn = torch.zeros(len(order), dtype=torch.bool)
    drawn[order[wanted]] = True
    return drawn


def _part(
    data: SortedLevels, task: Task, frames: Bool[Tensor, " frames"], **others: Tensor
) -> tuple[SortedLevels, Task]:
    """Data and task of some frames."""
    places = frames.nonzero()[:, 0]
    part = data.like(data.levels[:, places.to(data.levels.device)])
    given = None if task.given is None else task.given[places]
    actions = task.actions[places.to(task.actions.device)]
    return part, replace(task, actions=actions, given=given, **others)
