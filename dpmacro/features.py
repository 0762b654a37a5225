"""Frames to quantised feature columns; the very same code serves training and acting.

Every feature is an integer sum over the eight channels of a frame and the frame before it, so a value
is exact: it does not depend on the batch, the device or the order of summation. Columns are quantised to
256 levels by cuts that the training frames choose.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol, runtime_checkable

import torch
from jaxtyping import Int32, Int64, Num, UInt8
from torch import Tensor

__all__ = [
    "FEATURES",
    "LEVELS",
    "FeatureSet",
    "Pixels",
    "Quantiser",
    "Rectangles",
    "features_from",
    "make_features",
    "previous_images",
]

LEVELS = 256
CHANNELS = 8
CHUNK_FRAMES = 32  # so many frames' integral images stay in the cache
CHUNK_COLUMNS = 256


@runtime_checkable
class FeatureSet(Protocol):
    """Numbers computed from a frame and the frame before it."""

    kind: str

    @property
    def count(self) -> int:
        """The number of columns."""
        ...

    def values(
        self,
        images: UInt8[Tensor, "frames height width 3"],
        previous: UInt8[Tensor, "frames height width 3"],
    ) -> Int32[Tensor, "columns frames"]:
        """Every column of every frame, feature-major, exact."""
        ...

    def select(self, columns: Int64[Tensor, " selected"]) -> "FeatureSet":
        """The feature set that holds just these columns, in this order."""
        ...

    def tensors(self) -> dict[str, Tensor]:
        """What defines the columns, for a file; `features_from` reads it back."""
        ...


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
        places = self.places.to(images.device)
        plane = self.height * self.width
        channel, place = places // plane, places % plane
        flat = place * 3 + channel % 3
        motion = (channel >= 3).to(torch.int32)[:, None]
        result = torch.empty(self.count, len(images), dtype=torch.int32, device=images.device)
        pairs = zip(images.split(CHUNK_FRAMES), previous.split(CHUNK_FRAMES), strict=True)
        for chunk, (now, before) in zip(result.split(CHUNK_FRAMES, 1), pairs, strict=True):
            old = before.flatten(1)[:, flat].T.to(torch.int32)
            chunk.copy_(now.flatten(1)[:, flat].T.to(torch.int32) - motion * old)
        return result

    def select(self, columns: Int64[Tensor, " selected"]) -> "Pixels":
        """Just these columns, in this order."""
        return Pixels(self.height, self.width, self.places[columns.to(self.places.device)])

    def tensors(self) -> dict[str, Tensor]:
        """The places of the columns."""
        return {"places": self.places}


@dataclass(frozen=True)
class Rectangles:
    """Sums over seeded random rectangles of one channel, half of the columns differences of two.

    The channels are R, G, B, their differences to the previous image, and two opponent colours, R - G and
    2B - R - G. The two rectangles of a difference share size and channel, so an integer sum orders frames
    exactly as the mean would.

    Boxes are channel, top, left, height, width; the second box of a plain sum has no area.
    """

    height: int
    width: int
    first: Int32[Tensor, "columns 5"]
    second: Int32[Tensor, "columns 5"]
    kind = "rectangles"

    @classmethod
    def draw(cls, height: int, width: int, count: int, generator: torch.Generator) -> "Rectangles":
        """`count` random rectangles: sides log-uniform from 1 pixel to the whole image, places uniform."""

        def uniform(high: Tensor | int) -> Tensor:
            return (torch.rand(count, generator=generator, dtype=torch.float64) * high).long()

        def side(limit: int) -> Tensor:
            exponent = torch.rand(count, generator=generator, dtype=torch.float64)
            return (float(limit) ** exponent).round().long().clamp(1, limit)

        channel, tall, wide = uniform(CHANNELS), side(height), side(width)

        def place() -> Tensor:
            top, left = uniform(height - tall + 1), uniform(width - wide + 1)
            return torch.stack([channel, top, left, tall, wide], 1).to(torch.int32)

        first, second = place(), place()
        second[: count - count // 2, 3:] = 0
        return cls(height, width, first, second)

    @property
    def count(self) -> int:
        """The number of columns."""
        return len(self.first)

    def values(
        self,
        images: UInt8[Tensor, "frames height width 3"],
        previous: UInt8[Tensor, "frames height width 3"],
    ) -> Int32[Tensor, "columns frames"]:
        """Sums over the pixels of one rectangle, or of one minus another."""
        corners, signs = self._corners
        corners = corners.to(images.device)
        result = torch.zeros(self.count, len(images), dtype=torch.int32, device=images.device)
        pairs = zip(images.split(CHUNK_FRAMES), previous.split(CHUNK_FRAMES), strict=True)
        for chunk, (now, before) in zip(result.split(CHUNK_FRAMES, 1), pairs, strict=True):
            integral = _integral_images(now, before)
            for corner, sign in zip(corners, signs, strict=True):
                chunk.add_(integral[corner], alpha=sign)
        return result

    def select(self, columns: Int64[Tensor, " selected"]) -> "Rectangles":
        """Just these columns, in this order."""
        columns = columns.to(self.first.device)
        return Rectangles(self.height, self.width, self.first[columns], self.second[columns])

    def tensors(self) -> dict[str, Tensor]:
        """The boxes of the columns."""
        return {"first": self.first, "second": self.second}

    @cached_property
    def _corners(self) -> tuple[Tensor, list[int]]:
        """Rows [8, columns] of the integral images and their signs: a rectangle's sum is four corners."""
        rows, signs = [], []
        for boxes, sign in ((self.first, 1), (self.second, -1)):
            channel, top, left, tall, wide = boxes.long().unbind(1)
            bottom, right = top + tall, left + wide
            for y, x, corner in ((top, left, 1), (top, right, -1), (bottom, left, -1), (bottom, right, 1)):
                rows.append((channel * (self.height + 1) + y) * (self.width + 1) + x)
                signs.append(sign * corner)
        return torch.stack(rows), signs


def _integral_images(images: Tensor, previous: Tensor) -> Tensor:
    """Sums over all pixels above and left of a corner, as [channel * corner, frames], frames last."""
    now = images.permute(3, 1, 2, 0).to(torch.int32)
    before = previous.permute(3, 1, 2, 0).to(torch.int32)
    red, green, blue = now
    channels = torch.stack([*now, *(now - before), red - green, 2 * blue - red - green])
    sums = channels.cumsum(1, dtype=torch.int32).cumsum(2, dtype=torch.int32)
    return torch.nn.functional.pad(sums, (0, 0, 1, 0, 1, 0)).flatten(0, 2)


@dataclass(frozen=True)
class Quantiser:
    """255 cuts per column that turn a value into a level: the number of cuts that are not above it."""

    cuts: Num[Tensor, "columns 255"]  # ascending

    @classmethod
    def fit(cls, values: Num[Tensor, "columns frames"]) -> "Quantiser":
        """Cuts from training values: half at even ranks, half at even distances between the extremes.

        Ranks spend levels where the values are; distances keep rare, extreme ones apart (a distant flag
        fills few frames).
        """
        n_frames, half = values.shape[1], LEVELS // 2
        steps = torch.arange(1, half + 1, device=values.device)
        cuts = []
        for chunk in values.split(CHUNK_COLUMNS):
            ordered = chunk.sort(1).values
            low, high = ordered[:, :1].double(), ordered[:, -1:].double()
            even = low + (high - low) * steps / half
            even = even if values.is_floating_point() else even.ceil()
            cuts.append(
                torch.cat([ordered[:, steps[:-1] * n_frames // half], even.to(values.dtype)], 1)
                .sort(1)
                .values
            )
        return cls(torch.cat(cuts))

    def levels(self, values: Num[Tensor, "columns frames"]) -> UInt8[Tensor, "columns frames"]:
        """The level 0..255 of every value."""
        result = torch.empty(values.shape, dtype=torch.uint8, device=values.device)
        chunks = zip(self.cuts.split(CHUNK_COLUMNS), values.split(CHUNK_COLUMNS), strict=True)
        for level, (cuts, value) in zip(result.split(CHUNK_COLUMNS), chunks, strict=True):
            level.copy_(torch.searchsorted(cuts, value.contiguous(), right=True, out_int32=True))
        return result

    def select(self, columns: Int64[Tensor, " selected"]) -> "Quantiser":
        """Just these columns, in this order."""
        return Quantiser(self.cuts[columns.to(self.cuts.device)])


FEATURES = {"rectangles": Rectangles, "pixels": Pixels}


def make_features(kind: str, height: int, width: int, count: int, generator: torch.Generator) -> FeatureSet:
    """The feature set of that name: "pixels", or "rectangles" with `count` of them drawn by `generator`.

    Raises ValueError for another name and for fewer than one rectangle.
    """
    if kind not in FEATURES:
        raise ValueError(f"features are {kind!r}: choose one of {', '.join(FEATURES)}")
    if kind == "pixels":
        return Pixels.all(height, width)
    if count < 1:
        raise ValueError(f"the number of rectangles is {count}: draw 1 at least")
    return Rectangles.draw(height, width, count, generator)


def features_from(kind: str, height: int, width: int, tensors: dict[str, Tensor]) -> FeatureSet:
    """The feature set that `FeatureSet.tensors` described."""
    return FEATURES[kind](height, width, **tensors)


def previous_images(
    images: UInt8[Tensor, "frames height width 3"], lengths: Int64[Tensor, " trajectories"]
) -> UInt8[Tensor, "frames height width 3"]:
    """The frame before each frame of a trajectory; the first frame is its own predecessor."""
    index = torch.arange(len(images), device=images.device) - 1
    starts = torch.nn.functional.pad(lengths.to(images.device).cumsum(0)[:-1], (1, 0))
    index[starts] += 1
    return images[index]
