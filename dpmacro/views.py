"""Other views of the frames, for switch functions to learn from: in a mirror, and looking a little aside."""

from collections.abc import Callable
from functools import partial

import torch
from jaxtyping import UInt8
from torch import Tensor

__all__ = ["View", "mirrored", "other_views", "shifted"]

View = Callable[[UInt8[Tensor, "frames height width 3"]], UInt8[Tensor, "frames height width 3"]]


def mirrored(images: UInt8[Tensor, "frames height width 3"]) -> UInt8[Tensor, "frames height width 3"]:
    """The images with left and right exchanged."""
    return images.flip(2)


def shifted(
    images: UInt8[Tensor, "frames height width 3"], pixels: int
) -> UInt8[Tensor, "frames height width 3"]:
    """The images moved to the right by `pixels`, to the left if negative; what comes in repeats the edge."""
    width = images.shape[2]
    return images[:, :, (torch.arange(width, device=images.device) - pixels).clamp(0, width - 1)]


def other_views(mirror: bool, pixels: int) -> list[View]:
    """The mirror image, if asked for, and shifts by `pixels` to either side, if any."""
    aside: list[View] = [partial(shifted, pixels=-pixels), partial(shifted, pixels=pixels)]
    return [mirrored] * mirror + aside * (pixels > 0)
