"""Pixels: the colours of every pixel and how they changed, the features of the DPBoost paper."""

from dataclasses import dataclass
from functools import cached_property

import torch
from jaxtyping import Float, Int32, Int64, UInt8
from torch import Tensor

from dpmacro.features.base import CHUNK_FRAMES, frames_last

__all__ = ["Pixels"]


@dataclass(frozen=True)
class Pixels:
    """The paper's features (Section V): RGB of the image, and its difference to the previous image.

    Place (channel * height + y) * width + x with channels R, G, B, dR, dG, dB: 18,432 of them at 64x48.
    """

    height: int
    width: int
    places: Int64[Tensor, " columns"]
    kind = "pixels"

    @classmethod
    def all(cls, height: int, width: int) -> "Pixels":
        """2 images x 3 colours x height x width columns."""
        return cls(height, width, torch.arange(6 * height * width))

    @property
    def count(self) -> int:
        """The number of columns."""
        return len(self.places)

    def values(
        self,
        images: UInt8[Tensor, "frames height width 3"],
        previous: UInt8[Tensor, "frames height width 3"],
    ) -> Int32[Tensor, "columns frames"]:
        """0..255 for a colour, -255..255 for a difference."""
        rows = self._rows.to(images.device)
        result = torch.empty(self.count, len(images), dtype=torch.int32, device=images.device)
        for start in range(0, len(images), CHUNK_FRAMES):
            chunk = slice(start, start + CHUNK_FRAMES)
            colours = frames_last(images[chunk]).to(torch.int16)
            changes = colours - frames_last(previous[chunk])
            result[:, chunk] = torch.cat([colours, changes]).index_select(0, rows)
        return result

    def select(self, columns: Int64[Tensor, " selected"]) -> "Pixels":
        """Just these columns, in this order."""
        return Pixels(self.height, self.width, self.places[columns.to(self.places.device)])

    def footprint(self, weights: Float[Tensor, "rows columns"]) -> Float[Tensor, "rows height width"]:
        """Every column's weight at its pixel, whatever the channel."""
        plane = self.height * self.width
        result = torch.zeros(len(weights), plane, dtype=torch.float64, device=weights.device)
        result.index_add_(1, (self.places % plane).to(weights.device), weights.double())
        return result.view(-1, self.height, self.width)

    def tensors(self) -> dict[str, Tensor]:
        """The places of the columns."""
        return {"places": self.places}

    @cached_property
    def _rows(self) -> Int64[Tensor, " columns"]:
        """The places in images of [height, width, colour], changes after colours."""
        plane = self.height * self.width
        channel, place = self.places // plane, self.places % plane
        return (channel // 3 * plane + place) * 3 + channel % 3
