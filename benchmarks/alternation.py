"""DPBoost's round, its boosting and its segmentation, against the baseline's round."""

import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import torch
from matrices import Matrix
from plan import Plan, settled
from report import Row
from stumps import EXACT, as_levels

from dpmacro.boosting.learners.stumps import SortedLevels, StumpLearner
from dpmacro.boosting.loop import Boosting
from dpmacro.boosting.losses.classes import class_targets
from dpmacro.discovery.starts import random_cuts
from dpmacro.segmentation.recursion import segment

__all__ = ["MACROS", "alternating", "rows"]

MACROS = (1, 2, 4, 8)
SHRINKAGE = 0.1


def rows(plan: Plan) -> Iterator[Row]:
    """Q = 1, 2, 4, 8 on the recorded demonstrations, relabelled every round."""
    for kind in (kind for kind in plan.matrices if kind != "random"):
        if (found := plan.matrix(kind)) is None:
            continue
        matrix, case = found
        baseline = plan.attempt("stumps.ours", matrix=matrix, option=EXACT, rounds=plan.rounds)
        for macros in MACROS:
            ours = plan.attempt("alternation.alternating", matrix=matrix, macros=macros, rounds=plan.rounds)
            if ours is None or baseline is None:
                continue
            seconds, name = settled(ours["seconds"]), "baseline's round"
            yield Row("dpboost", f"{case}, Q = {macros}", seconds, name, settled(baseline["seconds"]))
            yield plan.memory(f"{case}, Q = {macros}", ours, "baseline", baseline)
            if macros > 1:
                share = f"{case}, Q = {macros}, share of the segmentation"
                yield Row("dpboost", share, settled(ours["segmenting"]), "the whole round", seconds)


def alternating(matrix: str, macros: int, rounds: int) -> dict[str, Any]:
    """Seconds of every round of the alternation on a saved matrix, and of the segmentation in it.

    S = Q - 1; the first labels are random cuts. With Q = 1 there is nothing to segment.
    """
    data = Matrix.load(matrix)
    actions = torch.from_numpy(np.array(data.actions))
    lengths = torch.from_numpy(np.array(data.lengths))
    generator = torch.Generator().manual_seed(0)
    learner = StumpLearner(SortedLevels.build(as_levels(data.features)))
    targets = class_targets(actions, data.n_classes)
    boosting = Boosting(learner, targets, macros, SHRINKAGE, generator)
    labels = random_cuts(lengths, 1, macros, macros - 1, generator)[0]
    seconds, segmenting = [], []
    for _ in range(rounds):
        start = time.perf_counter()
        boosting.round(torch.nn.functional.one_hot(labels, macros).float())
        costs = boosting.losses()
        boosted = time.perf_counter()
        if macros > 1:
            labels = segment(costs, lengths, macros - 1).labels
        end = time.perf_counter()
        seconds.append(end - start)
        segmenting.append(end - boosted)
    return {"seconds": seconds, "segmenting": segmenting}
