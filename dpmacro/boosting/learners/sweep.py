"""The search for the best stump of every problem: a pass over all columns, and what ranks tell of theirs."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import reduce

import torch
from jaxtyping import Float, Float64, Int64, Shaped, UInt8
from torch import Tensor

from dpmacro.boosting.learners.base import HEAVIEST, overflow
from dpmacro.boosting.losses.base import Loss
from dpmacro.boosting.losses.classes import ExponentialLoss
from dpmacro.features.levels import LEVELS, SortedColumns, SortedLevels
from dpmacro.parallel import Ranks

__all__ = ["CLASSES", "Best", "lowest", "sweep"]

CACHED = 2**18  # histogram entries of a chunk of columns that stay in a core's cache
ON_DEVICE = 2**24  # likewise where a large chunk keeps the device busy
CLASSES = ExponentialLoss()


@dataclass(frozen=True)
class Best:
    """The best stump of every problem in some columns: what it leaves of the loss, and sums on its sides."""

    left: Float[Tensor, " problems"]
    columns: Int64[Tensor, " problems"]
    thresholds: UInt8[Tensor, " problems"]
    sides: Float[Tensor, "problems 2 rows entries"]  # below the threshold, then in all

    @classmethod
    def none(cls, row: Float[Tensor, "rows entries problems"]) -> "Best":
        """Of no columns; `row` is one of the loss's table."""
        shape = row.shape[2], 2, *row.shape[:2]
        nowhere = torch.zeros(shape[0], dtype=torch.int64, device=row.device)
        return cls(row.new_full(shape[:1], torch.inf), nowhere, nowhere.byte(), row.new_zeros(shape))

    @classmethod
    def among(cls, found: "list[Best]") -> "Best":
        """Of several the one that leaves least, and of equals that of the first column, for every problem."""
        left, columns = torch.stack([one.left for one in found]), torch.stack([one.columns for one in found])
        place = torch.where(left == left.amin(0), columns, torch.iinfo(columns.dtype).max).argmin(0)
        problems = torch.arange(len(place), device=place.device)
        thresholds, sides = (
            torch.stack([getattr(one, name) for one in found])[place, problems]
            for name in ("thresholds", "sides")
        )
        return cls(left[place, problems], columns[place, problems], thresholds, sides)

    @classmethod
    def side_by_side(cls, parts: "Sequence[Best]") -> "Best":
        """Those of some problems, then those of others."""
        names = ("left", "columns", "thresholds", "sides")
        return cls(*(torch.cat([getattr(one, name) for one in parts]) for name in names))

    def of_all(self, ranks: Ranks) -> "Best":
        """The best of what this is on every rank; moves a few numbers a problem."""
        if ranks.size == 1:
            return self
        own = [self.left, self.columns, self.thresholds, self.sides.flatten(1).T]
        told = ranks.gathered(torch.cat([one.double().reshape(-1, len(self.left)) for one in own]))
        return Best.among([self._unpacked(one) for one in told])

    def _unpacked(self, told: Float64[Tensor, "values problems"]) -> "Best":
        """What a rank has told, in the types and shapes of this."""
        sides = told[3:].T.to(self.sides.dtype).view_as(self.sides)
        return Best(told[0].to(self.left.dtype), told[1].long(), told[2].byte(), sides)


def sweep(
    data: SortedLevels,
    weights: Float[Tensor, "frames problems width"],
    responses: Shaped[Tensor, "frames #problems outputs"],
    loss: Loss = CLASSES,
    slack: Float[Tensor, " problems"] | None = None,
    bins: int = LEVELS,
) -> Iterator[
    tuple[
        SortedColumns,
        Float[Tensor, "columns bins rows entries problems"],
        Float[Tensor, "columns bins problems"],
    ]
]:
    """Every sorted column, a chunk at a time: the chunk, sums up to each threshold, and what each leaves.

    Sums are those of the loss's table, what is left is by its `split`; `slack` is 0 by default, and columns
    have `bins` at most. Raises ValueError where the rows sum to `HEAVIEST` or to no number.
    """
    rows = loss.table(weights, responses)
    table = rows.flatten(1)
    total = table.sum(0, dtype=torch.float64).to(table.dtype)
    if not bool((total.abs() < HEAVIEST).all()):  # nor where one is NaN
        raise ValueError(overflow(weights))
    slack = weights.new_zeros(weights.shape[1]) if slack is None else slack
    for chunk in data.chunks(_columns_at_a_time(table, bins), bins):
        below = _sums_up_to(chunk, table, total, loss.signed).unflatten(2, rows.shape[1:])
        yield chunk, below, loss.split(below, slack)


def _columns_at_a_time(table: Float[Tensor, "frames entries"], bins: int) -> int:
    """Columns whose histograms are in memory together."""
    room = CACHED if table.device.type == "cpu" else ON_DEVICE
    return min(max(room // (bins * table.shape[1]), 1), 128)


def _sums_up_to(
    chunk: SortedColumns,
    table: Float[Tensor, "frames entries"],
    total: Float[Tensor, " entries"],
    signed: bool,
) -> Float[Tensor, "columns bins entries"]:
    """Sums up to every bin: sorted frames are the bags' indices; the fullest bin gets what they leave.

    A column's sums are added up one after another, so they are the same in whatever chunk it is.
    """
    parts = (
        torch.nn.functional.embedding_bag(order, table, starts.flatten(), mode="sum")
        for order, starts in chunk.entries
    )
    below = reduce(Tensor.add_, parts).unflatten(0, chunk.thresholds.shape).cumsum_(1)
    rest = total - below[:, -1]
    if not signed:
        rest.clamp_(min=0)
    bins = torch.arange(below.shape[1], device=below.device)
    reached = (bins >= chunk.fullest[:, None]).to(below.dtype)
    return below.addcmul_(reached[:, :, None], rest[:, None])


def lowest(
    left: Float[Tensor, "columns bins problems"],
    below: Float[Tensor, "columns bins rows entries problems"],
    chunk: SortedColumns,
) -> Best:
    """The best of a chunk's columns."""
    place = left.flatten(0, 1).argmin(0)
    bins, problems = left.shape[1], torch.arange(len(place), device=place.device)
    column, bin_ = place // bins, place % bins
    pairs = below[column, bin_, :, :, problems], below[column, -1, :, :, problems]
    return Best(
        left[column, bin_, problems],
        chunk.columns[column],
        chunk.thresholds[column, bin_],
        torch.stack(pairs, 1),
    )
