"""The search for a segmentation: the alternation from many starts, and left-out data on what it found.

The objective has many local optima, so the alternation starts from many seeded initial segmentations side by
side, on a few dozen random columns a round. Q is the most macro-actions that a segmentation may have: of
classes those of fewer are among the starts. Of vectors, where one more always explains a little more, they
are made of the best that is found, two macro-actions made one.
"""

from collections.abc import Callable
from dataclasses import replace

import torch
from jaxtyping import Int64
from torch import Tensor

from dpmacro.boosting.loop import Round
from dpmacro.discovery.alternation import Alternated, pooled
from dpmacro.discovery.candidates import Candidate, score_candidates
from dpmacro.discovery.criteria import best_candidate
from dpmacro.discovery.fields import Field, extended, field_of
from dpmacro.discovery.race import boosted, boosted_in_turn, raced, taught
from dpmacro.discovery.refinement import recut, simplified
from dpmacro.discovery.result import Discovery
from dpmacro.discovery.settings import SearchSettings
from dpmacro.discovery.starts import (
    action_events,
    chained,
    evidence_of,
    feature_peaks,
    initial_segmentations,
    random_cuts,
    window_clusters,
)
from dpmacro.discovery.task import Task
from dpmacro.features.levels import SortedLevels
from dpmacro.segmentation.segments import distinct

__all__ = ["adopt", "discover", "spread"]

EVERY = 4  # macro-actions up to which every number of them is searched
PEAKS = 2  # candidates a restart cut at feature peaks, of classes and with two macro-actions; else fewer
VECTOR_SHRINKAGE = 0.3  # of the alternation, at least


def discover(
    data: SortedLevels,
    task: Task,
    settings: SearchSettings,
    restarts: int,
    shrinkage: float,
    on_round: Callable[[Round], None] = lambda _: None,
) -> Discovery:
    """Find candidate segmentations in a field of the trajectories and score them on left-out data.

    The paper's recipe sees all trajectories, and so does whoever asks for the least training loss.

    Args:
        data: levels of every frame.
        task: the actions, Q and S.
        settings: see there.
        restarts: initial segmentations.
        shrinkage: factor in (0, 1] on every weak hypothesis.
        on_round: called after every boosting round.
    """
    field = field_of(data, task) if settings.criterion == "left_out" else Field(data, task, None)
    data, task = field.data, field.task
    if field.drawn is not None:
        on_round = _without_labels(on_round)
    if task.vectors and settings.starts != "random":
        alternated = _raced(data, task, settings, restarts, shrinkage, on_round)
    else:
        tasks = [task] if settings.starts == "random" else _smaller(task)
        alternated = pooled(
            [_alternated(data, one, settings, restarts, shrinkage, on_round) for one in tasks]
        )
    if settings.criterion == "loss":
        least = alternated.labels[alternated.loss[-1].argmin()]
        return Discovery(task, alternated, tuple(score_candidates(data, task, least[None], on_round)), 0)
    candidates = _scored(data, task, alternated, settings, restarts, on_round)
    best = best_candidate([one.scores for one in candidates], task.vectors)
    return Discovery(task, alternated, tuple(candidates), best, field.drawn)


def spread(
    data: SortedLevels,
    task: Task,
    found: Discovery,
    settings: SearchSettings,
    on_round: Callable[[Round], None] = lambda _: None,
) -> Discovery:
    """What a search in some trajectories found, for all of them; as it is where it saw all.

    The segmentation to keep labels the others (`fields.extended`), with no more transitions than it has in
    any trajectory that was searched; that and what switch functions make of it are scored anew.
    """
    if found.drawn is None:
        return found
    bound = found.kept.transitions(found.task.lengths)
    labels = extended(data, task, field_of(data, task), found.kept.labels, bound)
    scored = score_candidates(data, task, labels[None], on_round)
    if settings.switch_weight > 0 and task.n_groups > 1:
        scored = recut(scored, data, task, settings.switch_weight, on_round)
    best = best_candidate([one.scores for one in scored], task.vectors)
    return Discovery(task, found.alternated, tuple(scored), best)


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


def _without_labels(on_round: Callable[[Round], None]) -> Callable[[Round], None]:
    """`on_round` told nothing of labels, which are of some trajectories only."""
    return lambda report: on_round(replace(report, labels=None))


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
        starts = initial_segmentations(data, task.actions, task.lengths, *bounds)
    if task.order == "chain":
        starts = chained(starts, task.lengths, task.macros)
    starts = torch.cat([taught(data, task), starts])
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
    """Scores of what the alternation found, of some starts as they are, of what switch functions make of the
    best, and of the best of all with fewer macro-actions.
    """
    order = alternated.loss[-1].argsort()
    others = _as_they_are(data, task, restarts)
    if task.order == "chain":
        others = chained(others, task.lengths, task.macros)
    labels = torch.cat([alternated.labels[order], taught(data, task), task.kept_to(others)])
    scored = score_candidates(data, task, labels[distinct(labels)], on_round)
    if settings.switch_weight > 0 and task.n_groups > 1:
        scored = recut(scored, data, task, settings.switch_weight, on_round)
    if task.order == "chain" or task.given is not None:  # macro-actions are then no fewer, and have names
        return scored
    return simplified(scored, data, task, on_round)


def _as_they_are(data: SortedLevels, task: Task, restarts: int) -> Int64[Tensor, "candidates frames"]:
    """Segmentations that are candidates without an alternation, which would drift away from them.

    The alternation knows no switch functions: it leaves cuts that can be recognised, by rare actions and at
    feature peaks. Of vectors it leaves clusters of windows for whatever explains a little more.
    """
    generator = torch.Generator().manual_seed(task.seed)
    bounds = task.macros, task.max_transitions
    if task.vectors:
        evidence = evidence_of(data, task, generator)
        own, n_peaks = window_clusters(evidence, restarts // 8, generator), restarts // 4
    else:
        own = action_events(task.actions, task.lengths, restarts // 4, *bounds, generator)
        n_peaks = PEAKS * restarts
    peaks = [
        feature_peaks(
            data,
            task.lengths,
            n_peaks // (smaller.macros - 1),
            smaller.macros,
            smaller.max_transitions,
            generator,
            task.actions,
        )
        for smaller in ([task] if task.vectors else _smaller(task))
    ]
    return torch.cat([own, *peaks])


def _smaller(task: Task) -> list[Task]:
    """The task with 2, 3, ... macro-actions and so many transitions as they need, up to the whole.

    Of more than `EVERY` macro-actions a few numbers below serve for all. A chain and given labels say how
    many there are.
    """
    if task.order == "chain" or task.given is not None:
        return [task]
    bound = task.max_transitions
    sizes = range(2, task.macros) if task.macros <= EVERY else sorted({2, EVERY, (task.macros + 1) // 2})
    return [*(replace(task, macros=n, max_transitions=min(n - 1, bound)) for n in sizes), task]
