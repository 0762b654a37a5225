"""What LeRobotDataset would give ACT at every frame, put together from images that are decoded once.

LeRobotDataset makes some 200 items a second on a core, which would take a twentieth of the training's time,
and keeps a second copy of the dataset in Hugging Face's cache.
"""

from collections.abc import Iterator

import numpy as np
import torch
from jaxtyping import Float32, Int64, UInt8
from torch import Tensor

from dpmacro.data.demonstrations import Demonstrations

__all__ = ["ACTION", "IMAGE", "PADDED", "STATE", "Chunks", "as_seen"]

IMAGE, STATE, ACTION, PADDED = "observation.images.avatar", "observation.state", "action", "action_is_pad"


class Chunks:
    """What LeRobotDataset gives a policy at a frame: the image, and the actions from there on, one-hot.

    Args:
        demonstrations: M actions are known.
        size: actions at a frame. Past its trajectory's end the last one is repeated and marked as padding.
    """

    def __init__(self, demonstrations: Demonstrations, size: int):
        self.images = torch.from_numpy(demonstrations.images)
        self.actions = torch.eye(len(demonstrations.action_names))[torch.from_numpy(demonstrations.actions)]
        ends = np.cumsum(demonstrations.lengths)
        self.last = torch.from_numpy(np.repeat(ends - 1, demonstrations.lengths))
        self.offsets = torch.arange(size)

    def __len__(self) -> int:
        return len(self.last)

    def batch(self, frames: Int64[Tensor, " batch"]) -> dict[str, Tensor]:
        """Images [batch, 3, height, width] in 0..1, actions [batch, size, M], padding [batch, size]."""
        wanted, last = frames[:, None] + self.offsets, self.last[frames][:, None]
        return {
            IMAGE: as_seen(self.images[frames]),
            STATE: torch.zeros(len(frames), 0),
            ACTION: self.actions[wanted.minimum(last)],
            PADDED: wanted > last,
        }

    def batches(self, size: int, generator: torch.Generator) -> Iterator[dict[str, Tensor]]:
        """Batches without end: every frame once, in random order, then anew."""
        while True:
            for frames in torch.randperm(len(self), generator=generator).split(size):
                yield self.batch(frames)

    def statistics(self) -> dict[str, dict[str, Tensor]]:
        """Mean and standard deviation, of every colour [3, 1, 1] and of every action [M]."""
        shares = torch.stack([self.images[..., k].flatten().bincount(minlength=256) for k in range(3)])
        shares, levels = shares / shares.sum(1, keepdim=True), torch.arange(256) / 255
        means = shares @ levels
        deviations = (shares * (levels - means[:, None]) ** 2).sum(1).sqrt()
        return {
            IMAGE: {"mean": means.reshape(3, 1, 1), "std": deviations.reshape(3, 1, 1)},
            ACTION: {"mean": self.actions.mean(0), "std": self.actions.std(0)},
        }


def as_seen(images: UInt8[Tensor, "*batch height width 3"]) -> Float32[Tensor, "*batch 3 height width"]:
    """Images as LeRobot's policies take them, channels first, in 0..1."""
    return images.movedim(-1, -3).float() / 255
