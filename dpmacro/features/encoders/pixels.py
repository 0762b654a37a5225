"""Pixels: the colours of every pixel and how they changed, the features of the DPBoost paper."""

from dataclasses import dataclass
from functools import cached_property

import torch
from jaxtyping import Float, Int32, Int64
from torch import Tensor

from dpmacro.features.base import CHUNK_FRAMES, Seen, frames_last, input_name
from dpmacro.features.encoders.camera import CameraEncoder

__all__ = ["Pixels"]


@dataclass(frozen=True)
class Pixels(CameraEncoder):
    """The paper's features (Section V): RGB of the image, and its difference to the previous image.

    Place (channel * height + y) * width + x with channels R, G, B, dR, dG, dB: 18,432 of them at 64x48.
    """

    places: Int64[Tensor, " columns"]
    kind = "pixels"

    @classmethod
    def all(cls, camera: str, height: int, width: int) -> "Pixels":
        """2 images x 3 colours x height x width columns."""
        return cls(camera, height, width, torch.arange(6 * height * width))

    @property
    def count(self) -> int:
        """The number of columns."""
        return len(self.places)

    def values(self, seen: Seen) -> Int32[Tensor, "columns frames"]:
        """0..255 for a colour, -255..255 for a difference."""
        images, previous = self.looked_at(seen)
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
        return Pixels(self.camera, self.height, self.width, self.places[columns.to(self.places.device)])

    def footprint(self, weights: Float[Tensor, "rows columns"]) -> dict[str, Float[Tensor, "rows _ _"]]:
        """Every column's weight at its pixel, whatever the channel."""
        plane = self.height * self.width
        result = torch.zeros(len(weights), plane, dtype=torch.float64, device=weights.device)
        result.index_add_(1, (self.places % plane).to(weights.device), weights.double())
        return {self.camera: result.view(-1, self.height, self.width)}

    def names(self) -> list[str]:
        """The colour or its change, the camera, and the place in pixels from the upper left corner."""
        channels = ("R", "G", "B", "change of R", "change of G", "change of B")
        camera, plane, result = input_name(self.camera), self.height * self.width, []
        for place in self.places.tolist():
            y, x = divmod(place % plane, self.width)
            result.append(f"pixel in {camera}: {channels[place // plane]} at ({x}, {y})")
        return result

    def tensors(self) -> dict[str, Tensor]:
        """The places of the columns."""
        return {"places": self.places}

    @cached_property
    def _rows(self) -> Int64[Tensor, " columns"]:
        """The places in images of [height, width, colour], changes after colours."""
        plane = self.height * self.width
        channel, place = self.places // plane, self.places % plane
        return (channel // 3 * plane + place) * 3 + channel % 3
