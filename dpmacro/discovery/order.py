"""Do demonstrations go through the same stages in the same order? Linear models tell within seconds."""

from dataclasses import dataclass, replace

import torch

from dpmacro.discovery.fields import field_of
from dpmacro.discovery.starts import Moments, evidence_of, linear_alternation, vector_starts
from dpmacro.discovery.task import Task
from dpmacro.features.levels import SortedLevels

__all__ = ["Order", "order_of"]

ALLOWANCE = 0.06  # by which one order for all may explain less, as a share of the loss in free order
STARTS = 32


@dataclass(frozen=True)
class Order:
    """What one order for all demonstrations costs: errors of linear models, each dimension's variance 1."""

    chain: float  # mean squared error a frame with 0, 1, ..., S in every demonstration
    free: float  # and with any order

    @property
    def chosen(self) -> str:
        """`chain` where it explains about as much as any order does, else `free`."""
        return "chain" if self.chain <= (1 + ALLOWANCE) * self.free else "free"


def order_of(data: SortedLevels, task: Task) -> Order:
    """The least error of the linear alternation with one order for all demonstrations, and without.

    Either begins at starts of all kinds. Where there are many trajectories both are on some of them. The
    task's actions are vectors, its Q and S those up to which an order is wanted.
    """
    losses = {}
    for order in ("chain", "free"):
        generator = torch.Generator().manual_seed(task.seed)
        bound = task.macros - 1 if order == "chain" else task.max_transitions
        field = field_of(data, replace(task, order=order, max_transitions=bound))
        evidence = evidence_of(field.data, field.task, generator)
        moments = Moments(evidence)
        kinds = vector_starts(field.data, evidence, moments, STARTS, generator)
        starts = torch.cat(list(kinds.values()))
        losses[order] = float(linear_alternation(evidence, starts, moments).loss.min())
    return Order(**losses)
