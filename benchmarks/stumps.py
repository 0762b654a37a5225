"""Our boosting rounds, and the options of the learner that are measured beside the exact search."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from matrices import Matrix
from measure import peak_gib
from torch import Tensor

from dpmacro.boosting.learners.base import Frames, WeakLearner
from dpmacro.boosting.learners.stumps import StumpClassifier, StumpLearner
from dpmacro.boosting.loop import Boosting
from dpmacro.boosting.losses.classes import class_targets
from dpmacro.features.levels import SortedLevels
from dpmacro.features.quantising import Quantiser

__all__ = ["EXACT", "OPTIONS", "Option", "as_levels", "ours", "ours_until"]

SHRINKAGE = 0.1
EXACT = "exact"


@dataclass(frozen=True)
class Option:
    """A weak learner to measure; a row of the table comes from every entry of OPTIONS."""

    make: Callable[[Tensor], WeakLearner]
    """From levels [columns, frames]; what it prepares counts as binning."""
    period: int = 1
    """Rounds after which its cost repeats; seconds are means over so many."""


OPTIONS = {
    EXACT: Option(lambda levels: StumpLearner(SortedLevels.build(levels))),
    "reuse=5": Option(lambda levels: StumpLearner(SortedLevels.build(levels), reuse=5), period=5),
    "drawn=512": Option(lambda levels: StumpLearner(SortedLevels.unsorted(levels), drawn=512)),
}


def ours(matrix: str, option: str, rounds: int) -> dict[str, Any]:
    """The baseline's rounds on a saved matrix, as `peers` returns them, except that the accuracies are lists
    with an entry for every round and the seconds are means over the option's period, two periods at least.
    """
    data = Matrix.load(matrix)
    actions = torch.from_numpy(np.array(data.actions))
    clock = time.perf_counter()
    learner = OPTIONS[option].make(as_levels(data.features))
    binning = time.perf_counter() - clock
    boosting = _boosting(learner, actions, data.n_classes)
    base = torch.ones(len(actions), 1)
    seconds, training = [], []
    period = OPTIONS[option].period
    rounds = max(rounds // period, 2) * period
    for _ in range(rounds):
        clock = time.perf_counter()
        boosting.round(base)
        seconds.append(time.perf_counter() - clock)
        training.append(_share(boosting.scores[:, 0], actions))
    gib = peak_gib()
    held = _HeldOut(boosting, as_levels(data.held_features), data.held_actions)
    return {
        "gib": gib,
        "seconds": np.reshape(seconds, (-1, period)).mean(1).tolist(),
        "binning": binning,
        "rounds": rounds,
        "training_accuracy": training,
        "accuracy": [held.add(number) for number in range(rounds)],
    }


def ours_until(matrix: str, option: str, target: float, most: int, limit: float) -> dict[str, Any]:
    """Seconds from the uint8 matrix to the first round whose held-out accuracy is `target` or more.

    Quantising, sorting and the rounds are timed; looking at held-out frames is not. `reached` is False where
    `most` rounds, or those of `limit` seconds, do not get there; `accuracy` is then the best of them.
    """
    data = Matrix.load(matrix)
    actions = torch.from_numpy(np.array(data.actions))
    clock = time.perf_counter()
    values = as_levels(data.features)
    quantiser = Quantiser.fit(values)
    learner = OPTIONS[option].make(quantiser.levels(values))
    boosting = _boosting(learner, actions, data.n_classes)
    binning = total = time.perf_counter() - clock
    held = _HeldOut(boosting, quantiser.levels(as_levels(data.held_features)), data.held_actions)
    base = torch.ones(len(actions), 1)
    best = 0.0
    number = 0
    while best < target and number < most and total < limit:
        clock = time.perf_counter()
        boosting.round(base)
        total += time.perf_counter() - clock
        best = max(best, held.add(number))
        number += 1
    return {
        "seconds": total,
        "binning": binning,
        "rounds": number,
        "reached": best >= target,
        "training_accuracy": _share(boosting.scores[:, 0], actions),
        "accuracy": best,
    }


def as_levels(features: np.ndarray) -> Tensor:
    """Frames [frames, columns] as uint8 [columns, frames], a copy."""
    return torch.from_numpy(np.ascontiguousarray(features.T))


class _HeldOut:
    """Accuracy on held-out frames, a round added at a time."""

    def __init__(self, boosting: Boosting, levels: Tensor, actions: np.ndarray) -> None:
        self.boosting = boosting
        self.levels = levels
        self.actions = torch.from_numpy(np.array(actions))
        self.scores = torch.zeros(len(self.actions), boosting.scores.shape[2])

    def add(self, number: int) -> float:
        """The accuracy with round `number`, from 0, on top of those added before."""
        strong = self.boosting.strong()
        assert isinstance(strong, StumpClassifier)
        only = slice(number, number + 1)
        added = StumpClassifier(strong.columns[only], strong.thresholds[only], strong.votes[only])
        self.scores += added.scores(Frames(self.levels))[:, 0]
        return _share(self.scores, self.actions)


def _boosting(learner: WeakLearner, actions: Tensor, n_classes: int) -> Boosting:
    generator = torch.Generator().manual_seed(0)
    return Boosting(learner, class_targets(actions, n_classes), 1, SHRINKAGE, generator)


def _share(scores: Tensor, actions: Tensor) -> float:
    return float((scores.argmax(1) == actions).float().mean())
