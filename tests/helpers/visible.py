"""Levels whose change of rule can be seen, for tests of what judges segmentations."""

import torch

from dpmacro.boosting.learners.stumps import StumpLearner
from dpmacro.discovery.candidates import Task
from dpmacro.features.levels import SortedLevels


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
    return Task(actions, lengths, groups, int(actions.max()) + 1, macros, bound, seed=0)


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
