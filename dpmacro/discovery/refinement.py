"""Rivals made of rivals: what switch functions make of the best, and the best with fewer macro-actions."""

import itertools
from collections.abc import Callable, Sequence

import torch
from jaxtyping import Int64
from torch import Tensor

from dpmacro.boosting.loop import Round
from dpmacro.discovery.candidates import Judged, Task, best_verdict, judge
from dpmacro.discovery.joint import resegmented
from dpmacro.features.levels import SortedLevels

__all__ = ["merged", "recut", "simplified"]

SWEEPS = 3  # in which switch functions cut
REFINED = 4  # rivals anew


def recut(
    judged: Sequence[Judged],
    data: SortedLevels,
    task: Task,
    weight: float,
    on_round: Callable[[Round], None] = lambda _: None,
) -> list[Judged]:
    """The rivals, and the best of them cut again with the costs of their switch functions, over and over.

    `weight` is how much the switch functions count beside the actions, above 0.
    """
    judged = list(judged)
    fresh = list(judged)
    for _ in range(SWEEPS):
        fresh.sort(key=lambda rival: (not rival.verdict.runnable, rival.verdict.causal_loss))
        chosen, fresh = fresh[:REFINED], fresh[REFINED:]
        again = _unknown([resegmented(rival, task, weight) for rival in chosen], judged)
        if not again:
            break
        found = judge(data, task, torch.stack(again), on_round)
        judged, fresh = judged + found, fresh + found
    return judged


def simplified(
    judged: Sequence[Judged],
    data: SortedLevels,
    task: Task,
    on_round: Callable[[Round], None] = lambda _: None,
) -> list[Judged]:
    """The rivals, and the best of them with two macro-actions made one, for as long as that is better.

    A macro-action more always lowers the training loss. On left-out data it has to pay for the changes into
    and out of it, which a planner may miss.
    """
    judged = list(judged)
    while True:
        best = best_verdict([rival.verdict for rival in judged])
        simpler = _unknown(merged(judged[best].labels), judged)
        if not simpler:
            return judged
        judged += judge(data, task, torch.stack(simpler), on_round)
        if best_verdict([rival.verdict for rival in judged]) == best:
            return judged


def merged(labels: Int64[Tensor, " frames"]) -> list[Int64[Tensor, " frames"]]:
    """Every segmentation in which two macro-actions are one, of two or more; numbered 0, 1, ... anew.

    None for two macro-actions: one alone is no segmentation.
    """
    used = labels.unique().tolist()
    if len(used) < 3:
        return []
    return [
        torch.where(labels == second, first, labels).unique(return_inverse=True)[1]
        for first, second in itertools.combinations(used, 2)
    ]


def _unknown(
    rivals: Sequence[Int64[Tensor, " frames"]], judged: Sequence[Judged]
) -> list[Int64[Tensor, " frames"]]:
    """Those that were not judged yet, each once."""
    known, fresh = [rival.labels for rival in judged], []
    for labels in rivals:
        if not any(torch.equal(labels, other) for other in known):
            known.append(labels)
            fresh.append(labels)
    return fresh
