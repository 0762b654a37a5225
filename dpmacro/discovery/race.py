"""Which starts of vectors are worth a whole alternation? Many short ones tell, side by side.

The alternation ends near where it starts, and a start costs little beside an alternation. So all kinds of
starts, and what the alternation with linear models makes of them, run a short boosted alternation with large
steps, and the few of least loss go on. Labels are held for its first half: relabelled earlier, by classifiers
that know next to nothing, the best starts lose their lead.
"""

from collections.abc import Callable

import torch
from jaxtyping import Int64
from torch import Tensor

from dpmacro.boosting.crossfit import pace_of
from dpmacro.boosting.learners.stumps import StumpLearner
from dpmacro.boosting.loop import Boosting, Round
from dpmacro.discovery.alternation import Alternated, alternate, pooled
from dpmacro.discovery.fields import extended, given_field
from dpmacro.discovery.settings import SearchSettings
from dpmacro.discovery.starts.linear import Moments, linear_alternation
from dpmacro.discovery.starts.vectors import evidence_of, vector_starts
from dpmacro.discovery.task import Task
from dpmacro.features.levels import SortedLevels
from dpmacro.segmentation.segments import distinct
from dpmacro.utils.stages import stage

__all__ = ["boosted", "boosted_in_turn", "raced", "taught"]

RACE = SearchSettings(rounds=20, warmup=10, drawn=24)
STEP = 0.5  # shrinkage of the race
SURVIVING = 5  # restarts for every segmentation that goes on
TABLE = 2**24  # scores that stand in memory together


@stage
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
    learner = StumpLearner(data, drawn=settings.drawn, bins=pace_of(task.actions).bins)
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


@stage
def raced(
    data: SortedLevels,
    task: Task,
    restarts: int,
    on_round: Callable[[Round], None] = lambda _: None,
) -> Int64[Tensor, "survivors frames"]:
    """Where the best of many short alternations ended and where they began, distinct ones, the best first.

    They begin at `restarts` starts of all kinds, and where the linear alternation ended with least loss from
    those, half as many. The race may lead a start on or astray, so of the winners both ends go on, one for
    every `SURVIVING` restarts.
    """
    generator = torch.Generator().manual_seed(task.seed)
    evidence = evidence_of(data, task, generator)
    moments = Moments(evidence)
    kinds = vector_starts(data, evidence, moments, restarts, generator)
    starts = torch.cat(list(kinds.values()))
    linear = linear_alternation(evidence, starts, moments)
    ended = linear.labels[linear.loss.argsort()]
    entrants = task.kept_to(torch.cat([starts, ended[distinct(ended)][: restarts // 2]]))
    entrants = torch.cat([taught(data, task), entrants])
    entrants = entrants[distinct(entrants)]
    found = boosted_in_turn(data, task, entrants, RACE, STEP, on_round)
    order = found.loss[-1].argsort()
    both = torch.stack([found.labels[order], entrants[order]], 1).flatten(0, 1)
    return both[distinct(both)][: max(restarts // SURVIVING, 1)]


def taught(data: SortedLevels, task: Task) -> Int64[Tensor, "starts frames"]:
    """All frames as classifiers of those with given labels want them: one start, or none without labels."""
    if task.given is None or not bool(task.known.held.any()):
        return torch.zeros(0, len(task.actions), dtype=torch.int64)
    return extended(data, task, given_field(data, task), task.given[task.known.held])[None]
