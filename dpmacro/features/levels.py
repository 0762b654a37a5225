"""Quantised feature columns with their frames sorted by level: what an exact search over stumps reads."""

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Int32, Int64, UInt8
from torch import Tensor

from dpmacro.parallel import Shares

__all__ = ["LEVELS", "SortedColumns", "SortedLevels"]

LEVELS = 256  # a level is a byte
PART = 64  # columns that a thread sorts at a time


@dataclass(frozen=True)
class SortedColumns:
    """Columns side by side, in bins: one for every level that some frame of a column has, ascending.

    The fullest bin of a column lists no frames: what it weighs is what the others leave, so a search need
    not read it.
    """

    columns: Int64[Tensor, " columns"]  # their numbers
    order: Int32[Tensor, " entries"]  # frame numbers by ascending level, column after column
    starts: Int32[Tensor, "columns bins"]  # a bin's first entry; bins that a column lacks are empty
    thresholds: UInt8[Tensor, "columns bins"]  # the level of a bin
    fullest: Int64[Tensor, " columns"]  # the bin that lists no frames


@dataclass(frozen=True)
class SortedLevels:
    """The levels of every column and, for the columns that are sorted, the frames in their order.

    Where ranks train together each has its share of the columns, and searches those.
    """

    shares: Shares
    levels: UInt8[Tensor, "own frames"]
    is_sorted: bool  # whether all columns are, not just some that were taken, or none
    columns: Int64[Tensor, " sorted"]  # which of the own are sorted, ascending
    order: Int32[Tensor, " entries"]
    ends: Int64[Tensor, " sorted"]  # where a column's entries end; on the CPU
    starts: Int32[Tensor, "sorted bins"]  # a bin's first entry within its column
    thresholds: UInt8[Tensor, "sorted bins"]
    counts: Int64[Tensor, " sorted"]  # a column's bins; on the CPU
    fullest: Int64[Tensor, " sorted"]
    kinds: Int64[Tensor, " count"] | None = None  # of columns of all ranks; draws are shared among them

    @classmethod
    def build(
        cls,
        levels: UInt8[Tensor, "own frames"],
        columns: Int64[Tensor, " sorted"] | None = None,
        kinds: Int64[Tensor, " count"] | None = None,
        shares: Shares | None = None,
    ) -> "SortedLevels":
        """Sort all columns, or just `columns`, once; the rounds of all problems share the result.

        `levels` are those of this rank's columns by `shares`; of all columns where there are none.

        The processor sorts wherever the levels are: NumPy sorts bytes by radix, several times faster than
        by comparison, in threads side by side.
        """
        shares = shares or Shares(len(levels))
        chosen = shares.own if columns is None else columns.cpu()
        source = (
            (levels if columns is None else levels[shares.places(chosen).to(levels.device)]).cpu().numpy()
        )
        histograms = np.empty((len(source), LEVELS), np.int32)
        parts = [range(k, min(k + PART, len(source))) for k in range(0, len(source), PART)]

        def count(part: range) -> None:
            for k in part:
                histograms[k] = np.bincount(source[k], minlength=LEVELS)

        def sort(part: range) -> None:
            for k in part:
                by_level = source[k].argsort(kind="stable")
                low = histograms[k, : full_levels[k]].sum()
                high = low + histograms[k, full_levels[k]]
                entries = order[ends[k] - len(by_level) + high - low : ends[k]]
                entries[:low], entries[low:] = by_level[:low], by_level[high:]

        with ThreadPoolExecutor(torch.get_num_threads()) as threads:
            list(threads.map(count, parts))
            full_levels = histograms.argmax(1)
            ends = (source.shape[1] - histograms.max(1)).cumsum(dtype=np.int64)
            order = np.empty(ends[-1] if len(ends) else 0, np.int32)
            list(threads.map(sort, parts))
        starts, thresholds, counts, fullest = _bins(histograms, full_levels)
        device = levels.device
        return cls(
            shares,
            levels,
            columns is None,
            chosen.to(device),
            torch.from_numpy(order).to(device),
            torch.from_numpy(ends),
            torch.from_numpy(starts).to(device),
            torch.from_numpy(thresholds).to(device),
            torch.from_numpy(counts),
            torch.from_numpy(fullest).to(device),
            kinds,
        )

    @property
    def n_columns(self) -> int:
        """The number of feature columns of all ranks, sorted or not."""
        return self.shares.count

    @property
    def n_frames(self) -> int:
        """The number of frames."""
        return self.levels.shape[1]

    @classmethod
    def unsorted(
        cls,
        levels: UInt8[Tensor, "own frames"],
        kinds: Int64[Tensor, " count"] | None = None,
        shares: Shares | None = None,
    ) -> "SortedLevels":
        """No column sorted yet, which saves four bytes a level: `take` sorts what it takes."""
        return cls.build(levels, torch.arange(0), kinds, shares)

    def like(self, levels: UInt8[Tensor, "own others"], sort: bool | None = None) -> "SortedLevels":
        """The same columns of other frames; sorted if these are, or as `sort` says."""
        build = self.build if (self.is_sorted if sort is None else sort) else self.unsorted
        return build(levels, kinds=self.kinds, shares=self.shares)

    def rows(self, columns: Int64[Tensor, " some"]) -> UInt8[Tensor, "some frames"]:
        """Levels of any columns, also of those that other ranks hold."""
        return self.shares.rows(self.levels, columns.to(self.levels.device))

    def above(
        self, columns: Int64[Tensor, " some"], thresholds: UInt8[Tensor, " some"]
    ) -> Bool[Tensor, "some frames"]:
        """Whether the levels of any columns are above a threshold each."""
        return self.shares.above(self.levels, columns, thresholds)

    def drawn(self, count: int, generator: torch.Generator) -> Int64[Tensor, " drawn"]:
        """Numbers of `count` columns drawn at random, ascending; as many of every kind as far as they go.

        A few dozen numbers of a state tell more than thousands of columns of pixels, among which they would
        hardly ever be drawn.
        """
        order = torch.randperm(self.n_columns, generator=generator)
        if self.kinds is not None:
            of_kind = torch.nn.functional.one_hot(self.kinds[order])
            order = order[(of_kind.cumsum(0) * of_kind).sum(1).argsort(stable=True)]
        return order[:count].sort().values

    def take(self, columns: Int64[Tensor, " taken"]) -> "SortedLevels":
        """Just these columns, ascending, sorted now where they are not; a rank takes those of its own."""
        columns = columns[self.shares.held(columns)]
        if not self.is_sorted:
            assert len(self.columns) == 0, "taken from what was taken"
            return self.build(self.levels, columns, shares=self.shares)
        cpu = self.shares.places(columns.cpu())
        places = cpu.to(self.columns.device)
        sizes = self.ends.diff(prepend=self.ends.new_zeros(1))[cpu]
        firsts = (self.ends[cpu] - sizes).tolist()
        slices = [
            self.order[first : first + size] for first, size in zip(firsts, sizes.tolist(), strict=True)
        ]
        return SortedLevels(
            self.shares,
            self.levels,
            False,
            columns.to(self.columns.device),
            torch.cat(slices) if slices else self.order[:0],
            sizes.cumsum(0),
            self.starts[places],
            self.thresholds[places],
            self.counts[cpu],
            self.fullest[places],
        )

    def chunks(self, size: int, most: int = LEVELS) -> Iterator[SortedColumns]:
        """The sorted columns, `size` at a time, with no more bins than the chunk needs, and `most` at most.

        Where a column has more, bins side by side are taken together, as many for each but the last; the
        threshold of such a bin is the highest level in it.
        """
        for first in range(0, len(self.columns), size):
            part = slice(first, first + size)
            ends, counts = self.ends[part], self.counts[part]
            offset = int(self.ends[first - 1]) if first else 0
            width = int(counts.max())
            before = torch.nn.functional.pad(ends[:-1] - offset, (1, 0)).to(torch.int32)
            starts, thresholds, fullest = (
                self.starts[part, :width],
                self.thresholds[part, :width],
                self.fullest[part],
            )
            if width > most:
                together = (-(-counts // most)).to(starts.device)[:, None]
                firsts = torch.arange(most, device=starts.device) * together
                lasts = torch.minimum(firsts + together, counts.to(starts.device)[:, None]) - 1
                ended = firsts > lasts
                listed = (ends.diff(prepend=torch.tensor([offset]))).to(starts.device)[:, None]
                starts = torch.where(ended, listed, starts.gather(1, firsts.clamp(max=width - 1)))
                starts = starts.to(torch.int32)
                thresholds = thresholds.gather(1, lasts.clamp(min=0))
                fullest = fullest // together[:, 0]
            yield SortedColumns(
                self.columns[part],
                self.order[offset : int(ends[-1])],
                starts + before.to(starts.device)[:, None],
                thresholds,
                fullest,
            )


def _bins(
    histograms: np.ndarray, full_levels: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Starts, thresholds, number of bins and place of the fullest bin, from frames per column and level."""
    present = histograms > 0
    rows = np.arange(len(histograms))
    listed = histograms.copy()
    listed[rows, full_levels] = 0
    ends = listed.cumsum(1, dtype=np.int32)
    by_presence = (~present).argsort(1, kind="stable")  # levels that have frames first, ascending
    lacking = ~np.take_along_axis(present, by_presence, 1)
    starts = np.take_along_axis(ends - listed, by_presence, 1)
    starts = np.where(lacking, ends[:, -1:], starts)
    fullest = present.cumsum(1)[rows, full_levels] - 1
    return starts, by_presence.astype(np.uint8), present.sum(1), fullest
