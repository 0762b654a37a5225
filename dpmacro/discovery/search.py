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

from dpmacro.boosting.loop import Round
from dpmacro.discovery.alternation import Alternated, pooled
from dpmacro.discovery.candidates import Candidate, Task, distinct, score_candidates
from dpmacro.discovery.criteria import best_candidate
from dpmacro.discovery.race import boosted, boosted_in_turn, raced
from dpmacro.discovery.refinement import recut, simplified
from dpmacro.discovery.result import Discovery
from dpmacro.discovery.settings import SearchSettings
from dpmacro.discovery.starts import (
    action_events,
    chained,
    feature_peaks,
    initial_segmentations,
    random_cuts,
)
from dpmacro.features.levels import SortedLevels

__all__ = ["adopt", "discover"]

EVERY = 4  # macro-actions up to which every number of them is searched
PEAKS = 2  # candidates a restart cut at feature peaks, of classes and with two macro-actions; else fewer
VECTOR_SHRINKAGE = 0.3  # of the alternation, at least
SHARE = 4  # of the restarts, for numbers of macro-actions below Q where actions are vectors: one in so many


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
    if task.vectors and settings.starts != "random":
        parts = [
            _raced(
                data, one, settings, restarts if one is task else -(-restarts // SHARE), shrinkage, on_round
            )
            for one in tasks
        ]
    else:
        parts = [_alternated(data, one, settings, restarts, shrinkage, on_round) for one in tasks]
    alternated = pooled(parts)
    if paper:
        least = alternated.labels[alternated.loss[-1].argmin()]
        return Discovery(task, alternated, tuple(score_candidates(data, task, least[None], on_round)), 0)
    candidates = _scored(data, task, alternated, settings, restarts, on_round)
    return Discovery(
        task, alternated, tuple(candidates), best_candidate([one.scores for one in candidates], task.vectors)
    )


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
    return boosted(data, task, starts, settings, shrinkage, generator, on_round)


def _raced(
    data: SortedLevels,
    task: Task,
    settings: SearchSettings,
    restarts: int,
    shrinkage: float,
    on_round: Callable[[Round], None],
) -> Alternated:
    """The alternation from the starts of vectors that win a race; `shrinkage` is that of classes.

    Squared errors fall slowly: with the steps of classes the losses that are compared would be those of
    classifiers that know little yet, and prefer what is explained first.
    """
    survivors = raced(data, task, restarts, on_round)
    return boosted_in_turn(data, task, survivors, settings, max(shrinkage, VECTOR_SHRINKAGE), on_round)


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
    if not task.vectors:
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
    """The task with 2, 3, ... macro-actions and so many transitions as they need, up to the whole.

    Of more than `EVERY` macro-actions a few numbers below serve for all.
    """
    if task.order == "chain":
        return [task]
    bound = task.max_transitions
    sizes = range(2, task.macros) if task.macros <= EVERY else sorted({2, EVERY, (task.macros + 1) // 2})
    return [*(replace(task, macros=n, max_transitions=min(n - 1, bound)) for n in sizes), task]
