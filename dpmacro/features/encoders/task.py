"""The task that a demonstration is of: one column for each."""

from dataclasses import dataclass
from typing import Any

import torch
from jaxtyping import Bool, Float, Int32, Int64
from torch import Tensor

from dpmacro.features.base import Seen, look

__all__ = ["Task"]


@dataclass(frozen=True)
class Task:
    """Whether the task is that of the column, 1 or 0; of a task that no column is for, all are 0.

    Attributes:
        key: of the number of the task, "task_index".
        tasks: the number that each column is for.
    """

    key: str
    tasks: Int64[Tensor, " columns"]
    kind = "task"
    dtype = torch.int32
    lags = (0,)

    @classmethod
    def all(cls, count: int, key: str = "task_index") -> "Task":
        """A column for each task 0..count-1. Raises ValueError for less than one."""
        if count < 1:
            raise ValueError(f"the number of tasks is {count}: give 1 at least")
        return cls(key, torch.arange(count))

    @property
    def count(self) -> int:
        """The number of columns."""
        return len(self.tasks)

    @property
    def keys(self) -> tuple[str, ...]:
        """The number's."""
        return (self.key,)

    @property
    def needs(self) -> dict[str, tuple[int, ...]]:
        """The number, of the frame alone."""
        return {self.key: self.lags}

    @property
    def sees_pixels(self) -> Bool[Tensor, " columns"]:
        """None does."""
        return torch.zeros(self.count, dtype=torch.bool, device=self.tasks.device)

    def values(self, seen: Seen) -> Int32[Tensor, "columns frames"]:
        """1 for the task, 0 for others."""
        numbers = look(seen, 0, self.key, ())
        return (self.tasks.to(numbers.device)[:, None] == numbers).to(torch.int32)

    def select(self, columns: Int64[Tensor, " selected"]) -> "Task":
        """Just these columns, in this order."""
        return Task(self.key, self.tasks[columns.to(self.tasks.device)])

    def footprint(self, weights: Float[Tensor, "rows columns"]) -> dict[str, Float[Tensor, "rows _ _"]]:
        """None: there are no pixels."""
        return {}

    def names(self) -> list[str]:
        """The number of the task."""
        return [f"task {task}" for task in self.tasks.tolist()]

    def spec(self) -> dict[str, Any]:
        """The key."""
        return {"kind": self.kind, "key": self.key}

    def tensors(self) -> dict[str, Tensor]:
        """The tasks of the columns."""
        return {"tasks": self.tasks}
