"""Levels whose change of macro-action can be seen, and switch functions made by hand."""

import torch

from dpmacro.boosting.learners.stumps import StumpLearner
from dpmacro.boosting.losses.classes import ExponentialLoss
from dpmacro.discovery.task import Task
from dpmacro.features.levels import SortedLevels
from dpmacro.switching.functions import SwitchFunctions


def visible_change(n=12, length=80):
    """Column 0 is high for three frames from the change on; column 1 decides before it, column 2 after."""
    generator = torch.Generator().manual_seed(0)
    levels = torch.randint(0, 120, (6, n * length), dtype=torch.uint8, generator=generator)
    truth = torch.zeros(n, length, dtype=torch.int64)
    for row, cut in enumerate(torch.randint(25, 55, (n,), generator=generator).tolist()):
        truth[row, cut:] = 1
        levels[0, row * length + cut : row * length + cut + 3] = 250
    truth = truth.flatten()
    actions = (levels[1 + truth, torch.arange(n * length)] > 60).long()
    return SortedLevels.build(levels), actions, torch.full((n,), length), truth


def task_of(actions, lengths, macros=2, bound=1, groups=None):
    groups = torch.arange(len(lengths)) if groups is None else groups
    return Task(actions, lengths, groups, ExponentialLoss(int(actions.max()) + 1), macros, bound, seed=0)


def trajectories(n=12, visible=True, seed=0):
    """Two macro-actions; where `visible`, column 0 is high at the change and for nine frames after it."""
    generator = torch.Generator().manual_seed(seed)
    labels, columns, lengths = [], [], []
    for _ in range(n):
        length = int(torch.randint(60, 90, (1,), generator=generator))
        cut = int(torch.randint(20, 40, (1,), generator=generator))
        part = torch.randint(0, 120, (6, length), dtype=torch.uint8, generator=generator)
        if visible:
            part[0, cut : cut + 10] = 200
        labels.append((torch.arange(length) >= cut).long())
        columns.append(part)
        lengths.append(length)
    learner = StumpLearner(SortedLevels.build(torch.cat(columns, 1)))
    return learner, torch.cat(labels), torch.tensor(lengths)


def functions_of(scores, pairs=((0, 1),), first=None, recognised=None, margins=None, left_out=True):
    """Switch functions with thresholds of 0 that say what is given.

    `scores` are [frames, switches]; margins are the scores, and trajectories start with 0, unless given.
    """
    first = torch.zeros(1, dtype=torch.int64) if first is None else first
    return SwitchFunctions(
        pairs=tuple(pairs),
        starts=tuple(first.unique().tolist()),
        thresholds=torch.zeros(len(pairs)),
        cues=(),
        recognised=torch.zeros(len(pairs)) if recognised is None else recognised,
        scores=scores,
        margins=scores if margins is None else margins,
        first=first,
        classifier=None,
        left_out=left_out,
    )
