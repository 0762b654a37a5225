"""What turns observations into feature columns, and which frame comes before another.

The same code serves training and acting. A value is computed exactly, or by one rounding, from a frame and
frames before it: it does not depend on the batch, the device or the order of summation.
"""

from collections.abc import Mapping
from typing import Any, Protocol, runtime_checkable

import torch
from jaxtyping import Bool, Float, Int64, Num, UInt8
from torch import Tensor

__all__ = [
    "CHUNK_FRAMES",
    "Encoder",
    "Observation",
    "Seen",
    "frame_bytes",
    "frames_before",
    "frames_lagged",
    "frames_last",
    "input_name",
    "look",
]

CHUNK_FRAMES = 64  # images computed at a time: what is computed of them stays in the processor's cache

# Keyed as LeRobot keys it, frames first: images uint8 [frames, height, width, 3], states float32
# [frames, dimensions], "task_index" int64 [frames].
Observation = Mapping[str, Tensor]
Seen = Mapping[int, Observation]  # by lag: what was seen that many frames back


@runtime_checkable
class Encoder(Protocol):
    """Computes feature columns from what a frame and frames before it show."""

    kind: str

    @property
    def needs(self) -> dict[str, tuple[int, ...]]:
        """For every key that it looks at, how many frames back it looks, ascending from 0."""
        ...

    @property
    def keys(self) -> tuple[str, ...]:
        """The keys that it looks at."""
        ...

    @property
    def lags(self) -> tuple[int, ...]:
        """How many frames back it looks at any key, ascending from 0."""
        ...

    @property
    def count(self) -> int:
        """The number of columns."""
        ...

    @property
    def dtype(self) -> torch.dtype:
        """Of the values: int32, float32 or, for both side by side, float64."""
        ...

    @property
    def sees_pixels(self) -> Bool[Tensor, " columns"]:
        """Whether each column looks at pixels: where memory is short, random ones of those are left out."""
        ...

    def values(self, seen: Seen) -> Num[Tensor, "columns frames"]:
        """Every column of every frame, feature-major, from `seen[lag][key]` of all that it `needs`.

        Raises ValueError where a key is missing or not of the size that the columns are for.
        """
        ...

    def select(self, columns: Int64[Tensor, " selected"]) -> "Encoder":
        """The encoder of just these columns, in this order."""
        ...

    def footprint(self, weights: Float[Tensor, "rows columns"]) -> dict[str, Float[Tensor, "rows _ _"]]:
        """By camera, weights of columns, 0 or more, spread evenly over the pixels that each sees; float64.

        Cameras are those of `needs`; what a column without pixels weighs is nowhere.
        """
        ...

    def names(self) -> list[str]:
        """A name for every column, for people."""
        ...

    def spec(self) -> dict[str, Any]:
        """What defines the columns beside `tensors`, for JSON; `encoder_from` reads both back."""
        ...

    def tensors(self) -> dict[str, Tensor]:
        """The tensors that define the columns, for a file."""
        ...


def frames_lagged(lengths: Int64[Tensor, " trajectories"], lag: int) -> Int64[Tensor, " frames"]:
    """The number of the frame `lag` before each frame, or of its trajectory's first where there is none.

    Every length is 1 at least.
    """
    firsts = (lengths.cumsum(0) - lengths).repeat_interleave(lengths)
    return torch.maximum(torch.arange(len(firsts), device=lengths.device) - lag, firsts)


def frames_before(lengths: Int64[Tensor, " trajectories"]) -> Int64[Tensor, " frames"]:
    """The number of the frame before each frame of a trajectory; the first frame is its own predecessor."""
    return frames_lagged(lengths, 1)


def frames_last(
    images: UInt8[Tensor, "frames height width 3"],
) -> UInt8[Tensor, "values frames"]:
    """Images with their values flattened, row by row, pixel by pixel, and the frames along the last axis."""
    return images.reshape(len(images), -1).T.contiguous()


def frame_bytes(observation: Observation) -> int:
    """Bytes of one frame of everything seen."""
    return sum(value[:1].numel() * value.element_size() for value in observation.values())


def look(seen: Seen, lag: int, key: str, shape: tuple[int, ...]) -> Tensor:
    """What was seen of a key `lag` frames back. Raises ValueError where it lacks or has another shape."""
    observation = seen.get(lag, {})
    if key not in observation:
        raise ValueError(
            f"{key} of {lag} frames back is missing: there is {', '.join(observation) or 'none'}"
        )
    value = observation[key]
    if tuple(value.shape[1:]) != shape:
        found, wanted = ("x".join(map(str, size)) or "1" for size in (value.shape[1:], shape))
        raise ValueError(f"{key} is {found}: the columns are for {wanted}")
    return value


def input_name(key: str) -> str:
    """A key's name for people: "front" of observation.images.front, "state" of observation.state."""
    return key.removeprefix("observation.").removeprefix("images.")
