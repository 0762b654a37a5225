"""Rectangles: sums of colours over random rectangles of the image, computed from integral images."""

import itertools
from dataclasses import dataclass
from functools import cached_property

import torch
from jaxtyping import Float, Int32, Int64
from torch import Tensor

from dpmacro.features.base import CHUNK_FRAMES, Seen, frames_last, input_name
from dpmacro.features.encoders.camera import CameraEncoder

__all__ = ["Rectangles"]

# The channels of rectangles in terms of R, G, B of the image and R, G, B of the one before it.
CHANNEL_NAMES = ("R", "G", "B", "change of R", "change of G", "change of B", "R - G", "2B - R - G")
CHANNELS = torch.tensor(
    [
        [1, 0, 0, 0, 0, 0],
        [0, 1, 0, 0, 0, 0],
        [0, 0, 1, 0, 0, 0],
        [1, 0, 0, -1, 0, 0],
        [0, 1, 0, 0, -1, 0],
        [0, 0, 1, 0, 0, -1],
        [1, -1, 0, 0, 0, 0],
        [-1, -1, 2, 0, 0, 0],
    ]
)


@dataclass(frozen=True)
class Rectangles(CameraEncoder):
    """Sums over seeded random rectangles of one channel, half of the columns differences of two.

    The channels are R, G, B, their differences to the previous image, and two opponent colours, R - G and
    2B - R - G. The two rectangles of a difference share size and channel, so an integer sum orders frames
    exactly as the mean would.

    Boxes are channel, top, left, height, width; the second box of a plain sum has no area.
    """

    first: Int32[Tensor, "columns 5"]
    second: Int32[Tensor, "columns 5"]
    kind = "rectangles"

    @classmethod
    def draw(
        cls, camera: str, height: int, width: int, count: int, generator: torch.Generator
    ) -> "Rectangles":
        """`count` random rectangles: sides log-uniform from 1 pixel to the whole image, places uniform."""

        def uniform(high: Tensor | int) -> Tensor:
            return (torch.rand(count, generator=generator, dtype=torch.float64) * high).long()

        def side(limit: int) -> Tensor:
            exponent = torch.rand(count, generator=generator, dtype=torch.float64)
            return (float(limit) ** exponent).round().long().clamp(1, limit)

        channel, tall, wide = uniform(len(CHANNELS)), side(height), side(width)

        def place() -> Tensor:
            top, left = uniform(height - tall + 1), uniform(width - wide + 1)
            return torch.stack([channel, top, left, tall, wide], 1).to(torch.int32)

        first, second = place(), place()
        second[: count - count // 2, 3:] = 0
        return cls(camera, height, width, first, second)

    @property
    def count(self) -> int:
        """The number of columns."""
        return len(self.first)

    def values(self, seen: Seen) -> Int32[Tensor, "columns frames"]:
        """Sums over the pixels of one rectangle, or of one minus another."""
        images, previous = self.looked_at(seen)
        rows, factors, starts = (part.to(images.device) for part in self._corners)
        result = torch.empty(self.count, len(images), dtype=torch.int32, device=images.device)
        for start in range(0, len(images), CHUNK_FRAMES):
            chunk = slice(start, start + CHUNK_FRAMES)
            sums = _integral_images(images[chunk], previous[chunk], factors.dtype)
            result[:, chunk] = torch.nn.functional.embedding_bag(
                rows, sums, starts, mode="sum", per_sample_weights=factors
            )
        return result

    def select(self, columns: Int64[Tensor, " selected"]) -> "Rectangles":
        """Just these columns, in this order."""
        columns = columns.to(self.first.device)
        return Rectangles(self.camera, self.height, self.width, self.first[columns], self.second[columns])

    def footprint(self, weights: Float[Tensor, "rows columns"]) -> dict[str, Float[Tensor, "rows _ _"]]:
        """Every column's weight spread evenly over its one or two boxes.

        A box adds to four corners, of which two running sums make its area.
        """
        size = self.height + 1, self.width + 1
        corners = torch.zeros(len(weights), size[0] * size[1], dtype=torch.float64, device=weights.device)
        boxes = torch.stack([self.first, self.second]).to(weights.device).long()
        area = (boxes[..., 3] * boxes[..., 4]).sum(0)
        each = weights.double() / area.clamp(min=1)
        for top, left, tall, wide in (part[:, 1:].unbind(1) for part in boxes):
            for y, x, sign in ((0, 0, 1), (0, wide, -1), (tall, 0, -1), (tall, wide, 1)):
                corners.index_add_(1, (top + y) * size[1] + left + x, sign * each)
        return {self.camera: corners.view(-1, *size).cumsum(1).cumsum(2)[:, :-1, :-1].clamp_(min=0)}

    def names(self) -> list[str]:
        """The channel, the camera, and size and places of the boxes in pixels from the upper left corner."""
        camera, result = input_name(self.camera), []
        for (channel, top, left, tall, wide), other in zip(
            self.first.tolist(), self.second.tolist(), strict=True
        ):
            name = f"rectangle in {camera}: {CHANNEL_NAMES[channel]} of {wide}x{tall} at ({left}, {top})"
            result.append(f"{name} minus at ({other[2]}, {other[1]})" if other[3] * other[4] else name)
        return result

    def tensors(self) -> dict[str, Tensor]:
        """The boxes of the columns."""
        return {"first": self.first, "second": self.second}

    @cached_property
    def _corners(self) -> tuple[Tensor, Tensor, Tensor]:
        """Rows of `_integral_images` with their factors, concatenated, and where each column's begin.

        A rectangle's sum is that of four corners in each colour that its channel is made of.
        """
        rows, factors = [], []
        colours = torch.arange(CHANNELS.shape[1])
        for boxes, sign in ((self.first.cpu().long(), 1), (self.second.cpu().long(), -1)):
            channel, top, left, tall, wide = boxes.unbind(1)
            mixture = sign * CHANNELS[channel] * (tall * wide > 0)[:, None]
            bottom, right = top + tall, left + wide
            for y, x, corner in ((top, left, 1), (top, right, -1), (bottom, left, -1), (bottom, right, 1)):
                rows.append((y * (self.width + 1) + x)[:, None] * len(colours) + colours)
                factors.append(corner * mixture)
        row, factor = torch.cat(rows, 1), torch.cat(factors, 1)
        used = factor != 0
        starts = torch.nn.functional.pad(used.sum(1).cumsum(0), (1, 0))[:-1]
        return row[used], factor[used].to(_exact(self.height * self.width)), starts


def _exact(area: int) -> torch.dtype:
    """A floating-point type in which sums of corners are exact whatever their order.

    A corner is at most 255 * area. In the column with the most terms, a difference of two rectangles of
    2B - R - G, those of one sign add up to 16 corners.
    """
    return torch.float32 if 16 * 255 * area < 2**24 else torch.float64


def _integral_images(images: Tensor, previous: Tensor, dtype: torch.dtype) -> Tensor:
    """Sums over all pixels above and left of a corner, [(y * (width + 1) + x) * 6 + colour, frames].

    Frames last: a running sum then adds whole rows of them, in float since `embedding_bag` wants that.
    """
    n_frames, height, width, _ = images.shape
    if n_frames == 1 or images.is_cuda:
        colours = torch.cat([images, previous], 3).permute(1, 2, 3, 0)
        sums = colours.cumsum(0, dtype=dtype).cumsum(1)
        return torch.nn.functional.pad(sums, (0, 0, 0, 0, 1, 0, 1, 0)).flatten(0, 2)
    sums = torch.empty(height + 1, width + 1, 6, n_frames, dtype=dtype, device=images.device)
    sums[0] = 0
    sums[:, 0] = 0
    inner = sums[1:, 1:]
    inner[:, :, :3] = frames_last(images).view(height, width, 3, n_frames)
    inner[:, :, 3:] = frames_last(previous).view(height, width, 3, n_frames)
    for lines in (inner, inner.transpose(0, 1)):
        for before, line in itertools.pairwise(lines):  # `cumsum` walks across the rows, ten times slower
            line += before
    return sums.flatten(0, 2)
