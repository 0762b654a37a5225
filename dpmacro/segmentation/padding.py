"""Ragged trajectories as padded batches, a portion at a time."""

from collections.abc import Iterator

import torch
from jaxtyping import Bool, Int64, Num
from torch import Tensor

__all__ = ["blocks_of", "frames_inside", "mirror", "pad"]

BLOCK = 2**17  # costs of so many frames and macro-actions stay in a core's cache


def blocks_of(
    costs: Num[Tensor, "frames macros"], lengths: Int64[Tensor, " trajectories"]
) -> Iterator[tuple[slice, Int64[Tensor, " part"]]]:
    """Trajectories in portions whose costs stay in a core's cache: their frames and their lengths."""
    size = max(1, BLOCK // (costs.shape[1] * int(lengths.max())))
    first = 0
    for part in lengths.split(size if costs.device.type == "cpu" else len(lengths)):
        yield slice(first, first := first + int(part.sum())), part


def frames_inside(lengths: Int64[Tensor, " trajectories"]) -> Bool[Tensor, "trajectories time"]:
    """Where padded trajectories hold a frame."""
    return torch.arange(int(lengths.max())) < lengths[:, None]


def pad(values: Num[Tensor, "frames ..."], inside: Tensor) -> Tensor:
    """Concatenated frames as [trajectories, ..., time], zeros after the end of each."""
    padded = values.new_zeros(*inside.shape, *values.shape[1:])
    padded[inside] = values
    return padded.movedim(1, -1).contiguous()


def mirror(lengths: Int64[Tensor, " trajectories"]) -> Int64[Tensor, " frames"]:
    """The frame that stands in each frame's place where every trajectory is walked backwards."""
    ends = lengths.cumsum(0)
    return (2 * ends - lengths - 1).repeat_interleave(lengths) - torch.arange(int(ends[-1]))
