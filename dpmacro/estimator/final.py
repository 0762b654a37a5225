"""From what a search found to a result: the final fit, and its labels scored on left-out data."""

from collections.abc import Callable
from dataclasses import replace

import torch
from jaxtyping import Int64
from torch import Tensor

from dpmacro.boosting.loop import Round
from dpmacro.discovery.candidates import confidence
from dpmacro.discovery.criteria import equally_good
from dpmacro.discovery.result import Discovery
from dpmacro.discovery.search import adopt
from dpmacro.discovery.task import Task
from dpmacro.estimator.result import DPBoostResult
from dpmacro.estimator.settling import FinalFit, settle
from dpmacro.features.levels import SortedLevels
from dpmacro.segmentation.segments import transition_counts

__all__ = ["finished"]


def finished(
    data: SortedLevels,
    task: Task,
    discovery: Discovery | None,
    fit: FinalFit,
    on_round: Callable[[Round], None] = lambda _: None,
) -> DPBoostResult:
    """Classifiers and switch functions of the candidate to keep, and how sure left-out data is of it.

    Args:
        data: levels of every frame.
        task: what is to be explained.
        discovery: candidates, one of which is to be kept; None for one macro-action everywhere.
        fit: what the final fit learns with. Where the changes of the candidate cannot be recognised, its
            switch functions have no say in the segmentation. Nor have they where actions are vectors and
            what they make of it explains left-out actions worse than the candidate does.
        on_round: called after every boosting round.
    """
    labels, bound, runnable = torch.zeros(len(task.actions), dtype=torch.int64), 0, False
    if discovery is not None:
        labels = discovery.kept.labels.unique(return_inverse=True)[1]
        bound, runnable = discovery.kept.transitions(task.lengths), discovery.kept.scores.runnable
    apart = replace(fit, weight=0.0, switches=replace(fit.switches, aligned=False))
    if not runnable or fit.weight == 0:
        fit = apart
    elif discovery is not None:  # switch functions charge nats, and so the training loss is to be in nats
        fit = replace(fit, weight=fit.weight * task.loss.per_nat(discovery.kept.scale))
    bounded = replace(task.numbered_as(labels), max_transitions=bound)

    asked = task.vectors and fit.weight > 0

    def explains(found: Int64[Tensor, " frames"]) -> bool:
        return not asked or _explains(_judged(data, task, found, on_round), discovery)

    settled = settle(fit, bounded, labels, on_round, explains)
    final = None if settled is None else _judged(data, task, settled.labels, on_round)
    if settled is None or (asked and not _explains(final, discovery)):
        settled = settle(apart, bounded, labels, on_round)
        assert settled is not None, "whatever it ends with was wanted"
        final = _judged(data, task, settled.labels, on_round)
    sure = torch.ones(len(labels))
    if final is not None:
        sure = confidence(final.kept, final.task, settled.labels)
    return DPBoostResult(
        settled.labels,
        sure,
        settled.loss,
        task.loss,
        settled.classifiers,
        settled.switches,
        settled.terms,
        settled.max_transitions,
        task.order,
        settled.unsettled,
        None,
        discovery,
        final,
    )


def _judged(
    data: SortedLevels,
    task: Task,
    labels: Int64[Tensor, " frames"],
    on_round: Callable[[Round], None],
) -> Discovery | None:
    """What left-out data says of labels 0..Q-1, each used; None where they are one macro-action."""
    if int(labels.max()) == 0:
        return None
    used = int(transition_counts(labels, task.lengths).max())
    own = replace(task.numbered_as(labels), max_transitions=used)
    return adopt(data, own, labels, on_round)


def _explains(final: Discovery | None, discovery: Discovery | None) -> bool:
    """Whether labels explain left-out actions as well as the candidate that they were made of."""
    if discovery is None:
        return True
    if final is None:
        return False
    return 1 in equally_good([discovery.kept.scores.hindsight, final.kept.scores.hindsight])
