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
BLOCK = 8192  # frames that are sorted together: what a search gathers of so many stays in a core's cache


@dataclass(frozen=True)
class SortedFrames:
    """Some frames side by side, sorted by their levels in every column; the fullest bin lists none."""

    order: Int32[Tensor, " entries"]  # frame numbers by ascending level, column after column
    ends: Int64[Tensor, " sorted"]  # where a column's entries end; on the CPU
    starts: Int32[Tensor, "sorted bins"]  # a bin's first entry within its column

    def take(self, places: Int64[Tensor, " taken"]) -> "SortedFrames":
        """Just the columns at these places, which are on the CPU."""
        sizes = self.ends.diff(prepend=self.ends.new_zeros(1))[places]
        firsts = (self.ends[places] - sizes).tolist()
        slices = [
            self.order[first : first + size] for first, size in zip(firsts, sizes.tolist(), strict=True)
        ]
        order = torch.cat(slices) if slices else self.order[:0]
        return SortedFrames(order, sizes.cumsum(0), self.starts[places.to(self.starts.device)])


@dataclass(frozen=True)
class SortedColumns:
    """Columns side by side, in bins: one for every level that some frame of a column has, ascending.

    The fullest bin of a column lists no frames: what it weighs is what the others leave, so a search need
    not read it. `entries` has, for each block of frames, their numbers by ascending level, column after
    column, and the place of every bin's first; bins that a column lacks are empty.
    """

    columns: Int64[Tensor, " columns"]  # their numbers
    entries: tuple[tuple[Int32[Tensor, " _"], Int32[Tensor, "columns bins"]], ...]
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
    blocks: tuple[SortedFrames, ...]
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
        device = levels.device
        source = (levels if columns is None else levels[shares.places(chosen).to(device)]).cpu().numpy()
        size = BLOCK if device.type == "cpu" else max(source.shape[1], 1)  # a GPU has fewer, larger caches
        blocks = [source[:, k : k + size] for k in range(0, source.shape[1], size)]
        histograms = np.empty((len(blocks), len(source), LEVELS), np.int32)
        parts = [range(k, min(k + PART, len(source))) for k in range(0, len(source), PART)]

        def count(part: range) -> None:
            for number, block in enumerate(blocks):
                for k in part:
                    histograms[number, k] = np.bincount(block[k], minlength=LEVELS)

        def sort(part: range) -> None:
            for number, block in enumerate(blocks):
                for k in part:
                    by_level = block[k].argsort(kind="stable")
                    low = histograms[number, k, : full_levels[k]].sum()
                    high = low + histograms[number, k, full_levels[k]]
                    entries = orders[number][ends[number, k] - len(by_level) + high - low : ends[number, k]]
                    np.add(by_level[:low], number * size, out=entries[:low], casting="same_kind")
                    np.add(by_level[high:], number * size, out=entries[low:], casting="same_kind")

        with ThreadPoolExecutor(torch.get_num_threads()) as threads:
            list(threads.map(count, parts))
            full_levels = histograms.sum(0).argmax(1)
            listed = histograms.sum(2, dtype=np.int64)
            listed -= histograms[:, np.arange(len(source)), full_levels]
            ends = listed.cumsum(1)
            orders = [np.empty(own[-1] if len(own) else 0, np.int32) for own in ends]
            list(threads.map(sort, parts))
        starts, thresholds, counts, fullest = _bins(histograms, full_levels)
        return cls(
            shares,
            levels,
            columns is None,
            chosen.to(device),
            tuple(
                SortedFrames(
                    torch.from_numpy(order).to(device),
                    torch.from_numpy(end),
                    torch.from_numpy(own).to(device),
                )
                for order, end, own in zip(orders, ends, starts, strict=True)
            ),
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
        return SortedLevels(
            self.shares,
            self.levels,
            False,
            columns.to(self.columns.device),
            tuple(block.take(cpu) for block in self.blocks),
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
            counts, fullest = self.counts[part], self.fullest[part]
            width = int(counts.max())
            thresholds, joined = self.thresholds[part, :width], None
            if width > most:
                joined = _Joined.of(counts, most, thresholds.device)
                thresholds = thresholds.gather(1, joined.lasts.clamp(min=0))
                fullest = fullest // joined.together[:, 0]
            entries = tuple(_entries(block, part, width, joined) for block in self.blocks)
            yield SortedColumns(self.columns[part], entries, thresholds, fullest)


@dataclass(frozen=True)
class _Joined:
    """Bins side by side that are taken together: how many of a column, and the first and last of each."""

    together: Int64[Tensor, "columns 1"]
    firsts: Int64[Tensor, "columns most"]
    lasts: Int64[Tensor, "columns most"]

    @classmethod
    def of(cls, counts: Int64[Tensor, " columns"], most: int, device: torch.device) -> "_Joined":
        """`most` of a column at most."""
        counts = counts.to(device)[:, None]
        together = -(-counts // most)
        firsts = torch.arange(most, device=device) * together
        return cls(together, firsts, torch.minimum(firsts + together, counts) - 1)


def _entries(
    block: SortedFrames, part: slice, width: int, joined: _Joined | None
) -> tuple[Int32[Tensor, " entries"], Int32[Tensor, "columns bins"]]:
    """What a block lists of some columns, and where every bin begins in it."""
    ends, starts = block.ends[part], block.starts[part, :width]
    offset = int(block.ends[part.start - 1]) if part.start else 0
    before = torch.nn.functional.pad(ends[:-1] - offset, (1, 0)).to(torch.int32)
    if joined is not None:
        listed = ends.diff(prepend=torch.tensor([offset])).to(starts.device)[:, None]
        found = starts.gather(1, joined.firsts.clamp(max=width - 1))
        starts = torch.where(joined.firsts > joined.lasts, listed, found).to(torch.int32)
    return block.order[offset : int(ends[-1])], starts + before.to(starts.device)[:, None]


def _bins(
    histograms: np.ndarray, full_levels: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Starts by block, thresholds, number of bins and the fullest, from frames by block and level."""
    present = histograms.sum(0) > 0
    rows = np.arange(len(present))
    listed = histograms.copy()
    listed[:, rows, full_levels] = 0
    ends = listed.cumsum(2, dtype=np.int32)
    by_presence = (~present).argsort(1, kind="stable")  # levels that have frames first, ascending
    lacking = ~np.take_along_axis(present, by_presence, 1)
    starts = np.take_along_axis(ends - listed, by_presence[None], 2)
    starts = np.where(lacking, ends[:, :, -1:], starts)
    fullest = present.cumsum(1)[rows, full_levels] - 1
    return starts, by_presence.astype(np.uint8), present.sum(1), fullest
