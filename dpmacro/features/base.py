"""What turns frames into feature columns, and which frame comes before another.

The same code serves training and acting. A value is an exact integer computed from a frame and the frame
before it: it does not depend on the batch, the device or the order of summation.
"""

from typing import Protocol, runtime_checkable

import torch
from jaxtyping import Float, Int32, Int64, UInt8
from torch import Tensor

__all__ = ["CHUNK_FRAMES", "Encoder", "frames_before", "frames_last"]

CHUNK_FRAMES = 64  # frames computed at a time: what is computed of them stays in the processor's cache


@runtime_checkable
class Encoder(Protocol):
    """Computes feature columns from a frame's image and the image before it."""

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

    def select(self, columns: Int64[Tensor, " selected"]) -> "Encoder":
        """The encoder of just these columns, in this order."""
        ...

    def footprint(self, weights: Float[Tensor, "rows columns"]) -> Float[Tensor, "rows height width"]:
        """Weights of columns, 0 or more, spread evenly over the pixels that each looks at; float64."""
        ...

    def tensors(self) -> dict[str, Tensor]:
        """What defines the columns, for a file; `features_from` reads it back."""
        ...


def frames_before(lengths: Int64[Tensor, " trajectories"]) -> Int64[Tensor, " frames"]:
    """The number of the frame before each frame of a trajectory; the first frame is its own predecessor."""
    before = torch.arange(int(lengths.sum()), device=lengths.device) - 1
    before[lengths.cumsum(0) - lengths] += 1
    return before


def frames_last(
    images: UInt8[Tensor, "frames height width 3"],
) -> UInt8[Tensor, "values frames"]:
    """Images with their values flattened, row by row, pixel by pixel, and the frames along the last axis."""
    return images.reshape(len(images), -1).T.contiguous()
