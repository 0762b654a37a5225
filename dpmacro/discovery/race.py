"""Which starts of vectors are worth a whole alternation? Many short ones tell, side by side.

The alternation ends near where it starts, and a start costs little beside an alternation. So all kinds of
starts, and what the alternation with linear models makes of them, run a short boosted alternation with large
steps, and the few of least loss go on. Labels are held for its first half: relabelled earlier, by classifiers
that know next to nothing, the best starts lose their lead.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import torch
from jaxtyping import Int64
from torch import Tensor

from dpmacro.boosting.learners.base import Frames
from dpmacro.boosting.learners.stumps import StumpLearner
from dpmacro.boosting.loop import Boosting, Round
from dpmacro.discovery.alternation import Alternated, alternate, pooled
from dpmacro.discovery.candidates import Task, distinct
from dpmacro.discovery.settings import SearchSettings
from dpmacro.discovery.starts.linear import Moments, linear_alternation
from dpmacro.discovery.starts.vectors import evidence_of, vector_starts
from dpmacro.features.levels import SortedLevels
from dpmacro.segmentation.recursion import segment

__all__ = ["boosted", "boosted_in_turn", "field_of", "raced", "taught"]

RACE = SearchSettings(rounds=20, warmup=10, drawn=24)
STEP = 0.5  # shrinkage of the race
SURVIVING = 5  # restarts for every segmentation that goes on
TABLE = 2**24  # scores that stand in memory together
CELLS = 2**20  # scores of a start that is raced, and residuals' weights; of more frames some are drawn
CHUNK = 2**14  # frames scored at a time


@dataclass(frozen=True)
class Field:
    """What a race runs on: all data, or some whole trajectories of it."""

    data: SortedLevels
    task: Task
    whole: bool


def boosted(
    data: SortedLevels,
    task: Task,
    starts: Int64[Tensor, "restarts frames"],
    settings: SearchSettings,
    shrinkage: float,
    generator: torch.Generator,
    on_round: Callable[[Round], None] = lambda _: None,
) -> Alternated:
    """The alternation from these starts, on random columns."""
    learner = StumpLearner(data, drawn=settings.drawn)
    targets, n_problems = task.loss.targets(task.actions), len(starts) * task.macros
    boosting = Boosting(learner, targets, n_problems, shrinkage, generator, loss=task.loss)
    warmup = min(settings.warmup, settings.rounds // 2)
    given = boosting, task.actions, task.lengths, task.kept_to(starts), task.macros, task.max_transitions
    return alternate(*given, settings.rounds, warmup, "discover", on_round, order=task.order, keep=task.held)


def boosted_in_turn(
    data: SortedLevels,
    task: Task,
    starts: Int64[Tensor, "restarts frames"],
    settings: SearchSettings,
    shrinkage: float,
    on_round: Callable[[Round], None] = lambda _: None,
) -> Alternated:
    """`boosted`, so many starts at a time as fit into memory; all get the same columns, by the seed."""
    size = max(TABLE // (task.actions.numel() * task.macros), 1)
    parts = []
    for some in starts.split(size):
        generator = torch.Generator().manual_seed(task.seed)
        parts.append(boosted(data, task, some, settings, shrinkage, generator, on_round))
    return pooled(parts)


def raced(
    data: SortedLevels,
    task: Task,
    restarts: int,
    on_round: Callable[[Round], None] = lambda _: None,
) -> Int64[Tensor, "survivors frames"]:
    """Where the best of many short alternations ended and where they began, distinct ones, the best first.

    They begin at `restarts` starts of all kinds, and where the linear alternation ended with least loss from
    those, half as many. The race may lead a start on or astray, so of the winners both ends go on, one for
    every `SURVIVING` restarts. Where there are many frames the race is on whole trajectories drawn at
    random, and fewer survive; classifiers of each label the rest.
    """
    generator = torch.Generator().manual_seed(task.seed)
    field = field_of(data, task, generator)
    evidence = evidence_of(field.data.levels, field.task, generator)
    moments = Moments(evidence)
    kinds = vector_starts(field.data.levels, evidence, moments, restarts, generator)
    starts = torch.cat(list(kinds.values()))
    linear = linear_alternation(evidence, starts, moments)
    ended = linear.labels[linear.loss.argsort()]
    entrants = field.task.kept_to(torch.cat([starts, ended[distinct(ended)][: restarts // 2]]))
    entrants = torch.cat([taught(field.data, field.task), entrants])
    entrants = entrants[distinct(entrants)]
    found = boosted_in_turn(field.data, field.task, entrants, RACE, STEP, on_round)
    order = found.loss[-1].argsort()
    both = torch.stack([found.labels[order], entrants[order]], 1).flatten(0, 1)
    share = SURVIVING if field.whole else SURVIVING * -(-data.n_frames // _most(task))
    survivors = both[distinct(both)][: max(restarts // share, 1)]
    if field.whole:
        return survivors
    return torch.stack([_extended(data, task, field, labels) for labels in survivors])


def taught(data: SortedLevels, task: Task) -> Int64[Tensor, "starts frames"]:
    """All frames as classifiers of those with given labels want them: one start, or none without labels."""
    if task.given is None or not bool(task.known.held.any()):
        return torch.zeros(0, len(task.actions), dtype=torch.int64)
    held = task.known.held.nonzero()[:, 0]
    frames = held.to(data.levels.device)
    some = replace(task, actions=task.actions[frames], given=None)
    field = Field(SortedLevels.unsorted(data.levels[:, frames]), some, False)
    return _extended(data, task, field, task.given[held])[None]


def _most(task: Task) -> int:
    """Frames that a race is run on."""
    return max(CELLS // (task.macros * (task.actions.shape[1] + 1)), 1)


def field_of(data: SortedLevels, task: Task, generator: torch.Generator) -> Field:
    """All trajectories, or random ones until they have `_most` frames, the last one whole."""
    most = _most(task)
    if data.n_frames <= most:
        return Field(data, task, True)
    order = torch.randperm(len(task.lengths), generator=generator)
    count = int((task.lengths[order].cumsum(0) < most).sum()) + 1
    drawn = torch.zeros(len(task.lengths), dtype=torch.bool)
    drawn[order[:count]] = True
    if bool(drawn.all()):
        return Field(data, task, True)
    frames = drawn.repeat_interleave(task.lengths).nonzero()[:, 0].to(data.levels.device)
    known = None if task.given is None else task.given[frames.cpu()]
    parts = {"actions": task.actions[frames], "lengths": task.lengths[drawn], "groups": task.groups[drawn]}
    own = replace(task, **parts, given=known)
    return Field(SortedLevels.unsorted(data.levels[:, frames]), own, False)


def _extended(
    data: SortedLevels, task: Task, field: Field, labels: Int64[Tensor, " some"]
) -> Int64[Tensor, " frames"]:
    """All frames as classifiers of the labels of some want them, within the bounds."""
    generator = torch.Generator().manual_seed(task.seed)
    own = field.task
    learner = StumpLearner(field.data, drawn=RACE.drawn)
    boosting = Boosting(learner, own.loss.targets(own.actions), own.macros, STEP, generator, loss=own.loss)
    held = torch.nn.functional.one_hot(labels, own.macros).float().to(learner.device)
    for _ in range(RACE.rounds):
        boosting.round(held)
    strong, targets = boosting.strong(), task.loss.targets(task.actions)
    costs = torch.cat(
        [
            task.loss.terms(strong.scores(Frames(levels)), own_targets).sum(2)
            for levels, own_targets in zip(data.levels.split(CHUNK, 1), targets.split(CHUNK), strict=True)
        ]
    )
    return segment(task.held(costs), task.lengths, task.max_transitions, order=task.order).labels.cpu()
