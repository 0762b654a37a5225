"""The search for a segmentation: the alternation from many starts, and left-out data on what it found.

The objective has many local optima, so the alternation starts from many seeded initial segmentations side by
side, on a few dozen random columns a round; those of fewer macro-actions are among them, since Q is the most
that a segmentation may have.
"""

from collections.abc import Callable
from dataclasses import replace

import torch
from jaxtyping import Int64
from torch import Tensor

from dpmacro.boosting.learners.stumps import StumpLearner
from dpmacro.boosting.loop import Boosting, Round
from dpmacro.discovery.alternation import Alternated, alternate, pooled
from dpmacro.discovery.candidates import Candidate, Task, distinct, score_candidates
from dpmacro.discovery.criteria import best_candidate
from dpmacro.discovery.refinement import recut, simplified
from dpmacro.discovery.result import Discovery
from dpmacro.discovery.settings import SearchSettings
from dpmacro.discovery.starts import (
    Evidence,
    Moments,
    action_events,
    chained,
    feature_peaks,
    initial_segmentations,
    linear_alternation,
    principal,
    random_cuts,
    vector_starts,
)
from dpmacro.features.levels import SortedLevels

__all__ = ["adopt", "discover"]

PEAKS = 2  # candidates a restart cut at feature peaks, of classes and with two macro-actions; else fewer
COMPONENTS = 12
TABLE = 2**23  # scores that stand in memory together


def discover(
    data: SortedLevels,
    task: Task,
    settings: SearchSettings,
    restarts: int,
    shrinkage: float,
    on_round: Callable[[Round], None] = lambda _: None,
) -> Discovery:
    """Find candidate segmentations and score them on left-out data.

    Args:
        data: levels of every frame.
        task: the actions, Q and S.
        settings: see there.
        restarts: initial segmentations.
        shrinkage: factor in (0, 1] on every weak hypothesis.
        on_round: called after every boosting round.
    """
    paper = settings.criterion == "loss"
    tasks = [task] if settings.starts == "random" else _smaller(task)
    search = _raced if task.actions.ndim == 2 and settings.starts != "random" else _alternated
    parts = [search(data, one, settings, restarts, shrinkage, on_round) for one in tasks]
    alternated = pooled(parts)
    if paper:
        least = alternated.labels[alternated.loss[-1].argmin()]
        return Discovery(task, alternated, tuple(score_candidates(data, task, least[None], on_round)), 0)
    candidates = _scored(data, task, alternated, settings, restarts, on_round)
    return Discovery(task, alternated, tuple(candidates), best_candidate([one.scores for one in candidates]))


def adopt(
    data: SortedLevels,
    task: Task,
    labels: Int64[Tensor, " frames"],
    on_round: Callable[[Round], None] = lambda _: None,
) -> Discovery:
    """Score a segmentation that is known already, in place of a search; `labels` are 0..Q-1."""
    [candidate] = score_candidates(data, task, labels[None], on_round)
    loss = torch.tensor([[float(candidate.scores.hindsight.sum())]])
    return Discovery(task, Alternated(labels[None], loss), (candidate,), 0)


def _alternated(
    data: SortedLevels,
    task: Task,
    settings: SearchSettings,
    restarts: int,
    shrinkage: float,
    on_round: Callable[[Round], None],
) -> Alternated:
    """The alternation from every initial segmentation, on random columns."""
    generator = torch.Generator().manual_seed(task.seed)
    bounds = restarts, task.macros, task.max_transitions, generator
    if settings.starts == "random":
        starts = random_cuts(task.lengths, *bounds)
    else:
        starts = initial_segmentations(data.levels, task.actions, task.lengths, *bounds)
    if task.order == "chain":
        starts = chained(starts, task.lengths, task.macros)
    return _boosted(data, task, starts, settings, shrinkage, generator, on_round)


def _raced(
    data: SortedLevels,
    task: Task,
    settings: SearchSettings,
    restarts: int,
    shrinkage: float,
    on_round: Callable[[Round], None],
) -> Alternated:
    """The alternation from the starts of vectors that did best in a short one."""
    generator = torch.Generator().manual_seed(task.seed)
    evidence = Evidence(
        task.actions.cpu(),
        principal(data.levels, COMPONENTS, generator),
        task.lengths,
        task.macros,
        task.max_transitions,
        task.order == "chain",
    )
    moments = Moments(evidence)
    starts = torch.cat(list(vector_starts(data.levels, evidence, moments, 2 * restarts, generator).values()))
    linear = linear_alternation(evidence, starts, moments)
    ended = linear.labels[linear.loss.argsort()]
    ended = ended[distinct(ended)][: (restarts + 1) // 2]
    raw = starts[torch.randperm(len(starts), generator=generator)[: restarts // 2]]
    entrants = torch.cat([ended, raw])
    short = replace(settings, rounds=25, warmup=3, drawn=24)
    parts = [
        _boosted(data, task, group, short, shrinkage, generator, on_round)
        for group in entrants.split(_at_a_time(task))
    ]
    raced = pooled(parts)
    order = raced.labels[raced.loss[-1].argsort()]
    survivors = order[distinct(order)][: max(restarts // 5, 1)]
    return _boosted(data, task, survivors, settings, shrinkage, generator, on_round)


def _at_a_time(task: Task) -> int:
    """Starts whose scores stand in memory together."""
    return max(TABLE // (task.actions.numel() * task.macros), 1)


def _boosted(
    data: SortedLevels,
    task: Task,
    starts: Int64[Tensor, "restarts frames"],
    settings: SearchSettings,
    shrinkage: float,
    generator: torch.Generator,
    on_round: Callable[[Round], None],
) -> Alternated:
    learner = StumpLearner(data, drawn=settings.drawn)
    targets, n_problems = task.loss.targets(task.actions), len(starts) * task.macros
    boosting = Boosting(learner, targets, n_problems, shrinkage, generator, loss=task.loss)
    warmup = min(settings.warmup, settings.rounds // 2)
    given = boosting, task.actions, task.lengths, starts, task.macros, task.max_transitions
    return alternate(*given, settings.rounds, warmup, "discover", on_round, order=task.order)


def _scored(
    data: SortedLevels,
    task: Task,
    alternated: Alternated,
    settings: SearchSettings,
    restarts: int,
    on_round: Callable[[Round], None],
) -> list[Candidate]:
    """Scores of what the alternation found, of cuts by rare actions and at feature peaks as they are, of what
    switch functions make of the best, and of the best of all with fewer macro-actions.

    The alternation knows no switch functions: it drifts away from cuts that can be recognised.
    """
    order = alternated.loss[-1].argsort()
    generator = torch.Generator().manual_seed(task.seed)
    bounds = task.macros, task.max_transitions
    events, n_peaks = alternated.labels[:0], restarts // 2
    if task.actions.ndim == 1:
        events = action_events(task.actions, task.lengths, restarts // 4, *bounds, generator)
        n_peaks = PEAKS * restarts
    peaks = [
        feature_peaks(
            data.levels,
            task.lengths,
            n_peaks // (smaller.macros - 1),
            smaller.macros,
            smaller.max_transitions,
            generator,
            task.actions,
        )
        for smaller in _smaller(task)
    ]
    others = torch.cat([events, *peaks])
    if task.order == "chain":
        others = chained(others, task.lengths, task.macros)
    labels = torch.cat([alternated.labels[order], others])
    scored = score_candidates(data, task, labels[distinct(labels)], on_round)
    if settings.switch_weight > 0 and task.n_groups > 1:
        scored = recut(scored, data, task, settings.switch_weight, on_round)
    return scored if task.order == "chain" else simplified(scored, data, task, on_round)


def _smaller(task: Task) -> list[Task]:
    """The task with 2, 3, ... macro-actions and so many transitions as they need, up to the whole."""
    if task.order == "chain":
        return [task]
    bound = task.max_transitions
    fewer = [replace(task, macros=n, max_transitions=min(n - 1, bound)) for n in range(2, task.macros)]
    return [*fewer, task]
