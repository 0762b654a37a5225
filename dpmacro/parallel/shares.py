"""Which rank holds which feature column, and how ranks come by columns that others hold."""

from dataclasses import dataclass, field

import torch
from jaxtyping import Bool, Int64, Shaped, UInt8
from torch import Tensor

from dpmacro.parallel.ranks import ALONE, Ranks

__all__ = ["Shares"]

BYTE = 8  # bits


@dataclass(frozen=True)
class Shares:
    """Rank r of R holds the columns r, r + R, r + 2 R, ...: neighbours, which are alike, are shared out.

    Attributes:
        count: number of columns.
        ranks: among whom.
        own: the columns of this rank, ascending.
    """

    count: int
    ranks: Ranks = ALONE
    own: Int64[Tensor, " own"] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "own", torch.arange(self.count)[self.ranks.rank :: self.ranks.size])

    def held(self, columns: Int64[Tensor, " some"]) -> Bool[Tensor, " some"]:
        """Which of the columns this rank holds."""
        return columns % self.ranks.size == self.ranks.rank

    def places(self, columns: Int64[Tensor, " held"]) -> Int64[Tensor, " held"]:
        """Where columns that this rank holds are among its own."""
        return columns // self.ranks.size

    def rows(
        self, own: UInt8[Tensor, "own frames"], columns: Int64[Tensor, " some"]
    ) -> UInt8[Tensor, "some frames"]:
        """Any columns, on every rank, of which each has its `own`; moves as many bytes."""
        if self.ranks.size == 1:
            return own[columns]
        held = self.held(columns)
        found = own.new_zeros(len(columns), own.shape[1])
        found[held] = own[self.places(columns[held])]
        return self.ranks.summed(found)

    def above(
        self,
        own: UInt8[Tensor, "own frames"],
        columns: Int64[Tensor, " some"],
        thresholds: UInt8[Tensor, " some"],
    ) -> Bool[Tensor, "some frames"]:
        """Whether the levels of any columns are above a threshold each; moves a bit a frame and column."""
        if self.ranks.size == 1:
            return own[columns] > thresholds[:, None]
        held, n_frames = self.held(columns), own.shape[1]
        bits = own.new_zeros(len(columns), -(-n_frames // BYTE) * BYTE)
        bits[held, :n_frames] = (own[self.places(columns[held])] > thresholds[held, None]).to(bits.dtype)
        places = torch.arange(BYTE, dtype=torch.uint8, device=own.device)
        packed = (bits.unflatten(1, (-1, BYTE)) << places).sum(2, dtype=torch.uint8)
        found = self.ranks.summed(packed)
        return ((found[:, :, None] >> places) & 1).flatten(1)[:, :n_frames].bool()

    def whole(self, own: Shaped[Tensor, "own values"]) -> Shaped[Tensor, "count values"]:
        """A row for every column, on every rank, of which each has those of its own."""
        if self.ranks.size == 1:
            return own
        most = -(-self.count // self.ranks.size)
        padded = own.new_zeros(most, own.shape[1])
        padded[: len(own)] = own
        return self.ranks.gathered(padded).transpose(0, 1).flatten(0, 1)[: self.count]
