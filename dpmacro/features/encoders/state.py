"""The state: its values, how they changed, and how far they are apart."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import torch
from jaxtyping import Bool, Float, Float32, Int32, Int64
from torch import Tensor

from dpmacro.features.base import Seen, look

__all__ = ["State"]

CHUNK_VALUES = 2**20  # values computed at a time: what is computed of them takes little beside the result
NONE = -1  # nothing is subtracted


@dataclass(frozen=True)
class State:
    """Values of a vector of numbers, and their differences to others or to themselves some frames before.

    Column k of frame n is x_n[i], x_n[i] - x_{n-lag}[i] or x_n[i] - x_n[j], in float32: one subtraction,
    which no device and no batch rounds differently.

    Attributes:
        key: of the vector, "observation.state" say.
        dimensions: the names of the vector's dimensions.
        table: for every column i, then j or -1 for none, then lag.
    """

    key: str
    dimensions: tuple[str, ...]
    table: Int32[Tensor, "columns 3"]
    kind = "state"
    dtype = torch.float32

    @classmethod
    def make(
        cls,
        key: str,
        dimensions: Sequence[str],
        window: int,
        pairs: int,
        generator: torch.Generator,
        kept: Sequence[int] | None = None,
    ) -> "State":
        """All values, then their changes over 1 frame, over `window` frames, then differences of two values.

        Args:
            key: of the vector.
            dimensions: the names of its D dimensions.
            window: frames of the longer change, 2 at least.
            pairs: at most so many differences of two dimensions; drawn at random where there are more.
            generator: draws them.
            kept: the dimensions 0..D-1 that columns are made of, those that vary; None for all.

        Raises ValueError for a window below 2, for negative `pairs` and for dimensions that do not exist.
        """
        if window < 2:
            raise ValueError(
                f"the window is {window} frames: the change over 1 frame is there already, give 2"
            )
        if pairs < 0:
            raise ValueError(f"the number of pairs is {pairs}: give 0 for none")
        wrong = [dim for dim in kept or () if not 0 <= dim < len(dimensions)]
        if wrong:
            raise ValueError(f"{key} has no dimension {wrong[0]}: it has 0..{len(dimensions) - 1}")
        used = torch.arange(len(dimensions)) if kept is None else torch.tensor(kept, dtype=torch.int64)
        two = used[torch.combinations(torch.arange(len(used)), 2)].reshape(-1, 2)
        if len(two) > pairs:
            two = two[torch.randperm(len(two), generator=generator)[:pairs].sort().values]

        def rows(first: Tensor, second: Tensor | int, lag: int) -> Tensor:
            second = second if isinstance(second, Tensor) else torch.full_like(first, second)
            return torch.stack([first, second, torch.full_like(first, lag)], 1)

        minuend, subtrahend = two.unbind(1)
        table = [
            rows(used, NONE, 0),
            rows(used, used, 1),
            rows(used, used, window),
            rows(minuend, subtrahend, 0),
        ]
        return cls(key, tuple(dimensions), torch.cat(table).to(torch.int32))

    @property
    def count(self) -> int:
        """The number of columns."""
        return len(self.table)

    @property
    def keys(self) -> tuple[str, ...]:
        """The vector's."""
        return (self.key,)

    @cached_property
    def lags(self) -> tuple[int, ...]:
        """0 and the frames that columns are changes over."""
        return tuple(sorted({0, *self.table[:, 2].tolist()}))

    @property
    def needs(self) -> dict[str, tuple[int, ...]]:
        """All lags of the vector."""
        return {self.key: self.lags}

    @property
    def sees_pixels(self) -> Bool[Tensor, " columns"]:
        """None does."""
        return torch.zeros(self.count, dtype=torch.bool, device=self.table.device)

    def values(self, seen: Seen) -> Float32[Tensor, "columns frames"]:
        """In the units of the vector."""
        shape = (len(self.dimensions),)
        vectors = [look(seen, lag, self.key, shape).to(torch.float32) for lag in self.lags]
        first, second = (rows.to(vectors[0].device) for rows in self._rows)
        n_frames = len(vectors[0])
        result = torch.empty(self.count, n_frames, dtype=torch.float32, device=vectors[0].device)
        size = max(CHUNK_VALUES // max(self.count, 1), 1)
        for start in range(0, n_frames, size):
            chunk = slice(start, start + size)
            parts = [vector[chunk].T for vector in vectors]
            numbers = torch.cat([*parts, torch.zeros_like(parts[0][:1])])
            result[:, chunk] = numbers[first] - numbers[second]
        return result

    def select(self, columns: Int64[Tensor, " selected"]) -> "State":
        """Just these columns, in this order."""
        return State(self.key, self.dimensions, self.table[columns.to(self.table.device)])

    def footprint(self, weights: Float[Tensor, "rows columns"]) -> dict[str, Float[Tensor, "rows _ _"]]:
        """None: there are no pixels."""
        return {}

    def names(self) -> list[str]:
        """The dimension's name, alone, with the frames of its change, or minus another's."""
        return [self._name(*row) for row in self.table.tolist()]

    def spec(self) -> dict[str, Any]:
        """The key and the names of its dimensions."""
        return {"kind": self.kind, "key": self.key, "dimensions": list(self.dimensions)}

    def tensors(self) -> dict[str, Tensor]:
        """The table of the columns."""
        return {"table": self.table}

    def _name(self, first: int, second: int, lag: int) -> str:
        name = self.dimensions[first]
        if second == NONE:
            return name
        if lag:
            return f"{name}, change over {lag} frame{'s' if lag > 1 else ''}"
        return f"{name} - {self.dimensions[second]}"

    @cached_property
    def _rows(self) -> tuple[Int64[Tensor, " columns"], Int64[Tensor, " columns"]]:
        """What is subtracted from what: places among the vectors of all lags one after another, then 0."""
        first, second, lag = self.table.long().unbind(1)
        size = len(self.dimensions)
        place = torch.searchsorted(torch.tensor(self.lags, device=lag.device), lag.contiguous())
        return first, torch.where(second == NONE, size * len(self.lags), place * size + second)
