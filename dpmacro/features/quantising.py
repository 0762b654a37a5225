"""Feature values to 256 levels, by cuts that the training frames choose."""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Int64, Num, UInt8
from torch import Tensor

from dpmacro.features.levels import LEVELS

__all__ = ["Quantiser"]

CHUNK_COLUMNS = 256
CHUNK_SEARCHES = 2**19  # values whose levels are searched together


@dataclass(frozen=True)
class Quantiser:
    """255 cuts per column that turn a value into a level: the number of cuts that are not above it."""

    cuts: Num[Tensor, "columns 255"]  # ascending

    @classmethod
    def fit(cls, values: Num[Tensor, "columns frames"], dtype: torch.dtype | None = None) -> "Quantiser":
        """Cuts from training values: half at even ranks, half at even distances between the extremes.

        They are of the values' type, or of `dtype`, which must hold the values exactly.

        Ranks spend levels where the values are; distances keep rare, extreme ones apart (a distant flag
        fills few frames).

        Raises ValueError where a value is not finite.
        """
        n_frames, half = values.shape[1], LEVELS // 2
        dtype = dtype or values.dtype
        steps = torch.arange(1, half + 1, device=values.device)
        cuts = []
        for chunk in values.split(CHUNK_COLUMNS):
            ordered = _sorted(chunk.to(dtype))
            low, high = ordered[:, :1].double(), ordered[:, -1:].double()
            if not torch.isfinite(high - low).all():
                raise ValueError("a feature column has values that are not finite: leave it out")
            even = low + (high - low) * steps / half
            even = even if dtype.is_floating_point else even.ceil()
            cuts.append(
                torch.cat([ordered[:, steps[:-1] * n_frames // half], even.to(dtype)], 1).sort(1).values
            )
        return cls(torch.cat(cuts))

    def levels(self, values: Num[Tensor, "columns frames"]) -> UInt8[Tensor, "columns frames"]:
        """The level 0..255 of every value; values may be of a type that the cuts' type holds exactly."""
        assert self.cuts.is_floating_point() or not values.is_floating_point(), "cuts would be too coarse"
        if values.shape[1] == 1:  # one operation for the frame that an environment waits for
            return torch.searchsorted(self.cuts, values.to(self.cuts.dtype), right=True, out_int32=True).to(
                torch.uint8
            )
        result = torch.empty(values.shape, dtype=torch.uint8, device=values.device)
        columns = max(1, CHUNK_SEARCHES // max(1, values.shape[1]))
        for start in range(0, len(values), columns):
            chunk = slice(start, start + columns)
            result[chunk] = _count_not_above(self.cuts[chunk], values[chunk].to(self.cuts.dtype))
        return result

    def select(self, columns: Int64[Tensor, " selected"]) -> "Quantiser":
        """Just these columns, in this order."""
        return Quantiser(self.cuts[columns.to(self.cuts.device)])


def _sorted(rows: Tensor) -> Tensor:
    """Every row ascending; NumPy sorts 20 times faster than PyTorch, which sorts indices along."""
    if rows.device.type == "cpu":
        return torch.from_numpy(np.sort(rows.numpy(), axis=1))
    return rows.sort(1).values


def _count_not_above(cuts: Tensor, values: Tensor) -> Tensor:
    """For every value the number of its row's 255 ascending cuts that are not above it.

    All binary searches take their eight steps together; `searchsorted` mispredicts a branch at most of them.
    """
    found = 128 * (cuts[:, 127:128] <= values).long()
    for step in (64, 32, 16, 8, 4, 2, 1):
        found.add_(cuts.gather(1, found + (step - 1)) <= values, alpha=step)
    return found
