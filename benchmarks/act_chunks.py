"""What LeRobotDataset would give ACT at every frame, put together from images that are decoded once.

LeRobotDataset makes some 200 items a second on a core, which would take a twentieth of the training's time,
and keeps a second copy of the dataset in Hugging Face's cache.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, Float32, Int64, UInt8
from torch import Tensor

from dpmacro.data.demonstrations import Demonstrations

__all__ = [
    "ACTION",
    "IMAGE",
    "PADDED",
    "STATE",
    "WORLD_STATE",
    "Chunks",
    "StateChunks",
    "as_seen",
    "of_state",
]

IMAGE, STATE, ACTION, PADDED = "observation.images.avatar", "observation.state", "action", "action_is_pad"
WORLD_STATE = "observation.environment_state"


class Chunks:
    """What LeRobotDataset gives a policy at a frame: the image, and the actions from there on, one-hot.

    Attributes:
        actions: [frames, M], one-hot.

    Args:
        demonstrations: M actions are known.
        size: actions at a frame. Past its trajectory's end the last one is repeated and marked as padding.
    """

    def __init__(self, demonstrations: Demonstrations, size: int):
        self.actions = self._actions(demonstrations)
        self._see(demonstrations)
        ends = np.cumsum(demonstrations.lengths)
        self.last = torch.from_numpy(np.repeat(ends - 1, demonstrations.lengths))
        self.offsets = torch.arange(size)

    def __len__(self) -> int:
        return len(self.last)

    def batch(self, frames: Int64[Tensor, " batch"]) -> dict[str, Tensor]:
        """What is seen, as `seen` has it, actions [batch, size, M] and padding [batch, size]."""
        wanted, last = frames[:, None] + self.offsets, self.last[frames][:, None]
        return {
            **self.seen(frames),
            ACTION: self.actions[wanted.minimum(last)],
            PADDED: wanted > last,
        }

    def batches(self, size: int, generator: torch.Generator) -> Iterator[dict[str, Tensor]]:
        """Batches without end: every frame once, in random order, then anew."""
        while True:
            for frames in torch.randperm(len(self), generator=generator).split(size):
                yield self.batch(frames)

    def features(self) -> dict[str, Any]:
        """What ACT's configuration says of what is seen."""
        from lerobot.configs.types import FeatureType, PolicyFeature

        return {IMAGE: PolicyFeature(FeatureType.VISUAL, (3, *self.images.shape[1:3]))}

    def seen(self, frames: Int64[Tensor, " batch"]) -> dict[str, Tensor]:
        """Images [batch, 3, height, width] in 0..1."""
        return {IMAGE: as_seen(self.images[frames]), STATE: torch.zeros(len(frames), 0)}

    def statistics(self) -> dict[str, dict[str, Tensor]]:
        """Mean and standard deviation, of every colour [3, 1, 1] and of every action [M]."""
        shares = torch.stack([self.images[..., k].flatten().bincount(minlength=256) for k in range(3)])
        shares, levels = shares / shares.sum(1, keepdim=True), torch.arange(256) / 255
        means = shares @ levels
        deviations = (shares * (levels - means[:, None]) ** 2).sum(1).sqrt()
        return {
            IMAGE: {"mean": means.reshape(3, 1, 1), "std": deviations.reshape(3, 1, 1)},
            ACTION: _statistics(self.actions),
        }

    def agreement(self, predicted: Float[Tensor, "frames M"], taken: Float[Tensor, "frames M"]) -> float:
        """Share of frames at which the predicted action is the one taken, in 0..1."""
        return float((predicted.argmax(1) == taken.argmax(1)).float().mean())

    def _actions(self, demonstrations: Demonstrations) -> Float32[Tensor, "frames M"]:
        return torch.eye(len(demonstrations.action_names))[torch.from_numpy(demonstrations.actions)]

    def _see(self, demonstrations: Demonstrations) -> None:
        self.images = torch.from_numpy(demonstrations.images)


class StateChunks(Chunks):
    """Likewise of vectors: the state of the robot and of its world, and actions of M numbers.

    ACT's `observation.state` is the robot's own, the first `own` numbers of the state of the demonstrations;
    `observation.environment_state` is all of it.
    """

    def __init__(self, demonstrations: Demonstrations, size: int, own: int):
        self.own = own
        super().__init__(demonstrations, size)

    def features(self) -> dict[str, Any]:
        from lerobot.configs.types import FeatureType, PolicyFeature

        return {
            STATE: PolicyFeature(FeatureType.STATE, (self.own,)),
            WORLD_STATE: PolicyFeature(FeatureType.ENV, (self.states.shape[1],)),
        }

    def seen(self, frames: Int64[Tensor, " batch"]) -> dict[str, Tensor]:
        """The robot's state [batch, own], and the whole of it [batch, dims]."""
        return of_state(self.states[frames], self.own)

    def statistics(self) -> dict[str, dict[str, Tensor]]:
        """Mean and standard deviation of every number of states and actions."""
        return {
            name: _statistics(values)
            for name, values in (of_state(self.states, self.own) | {ACTION: self.actions}).items()
        }

    def agreement(self, predicted: Float[Tensor, "frames M"], taken: Float[Tensor, "frames M"]) -> float:
        """Share of the actions' variance that predictions explain, 1 at most."""
        return float(1 - (predicted - taken).square().sum() / (taken - taken.mean(0)).square().sum())

    def _actions(self, demonstrations: Demonstrations) -> Float32[Tensor, "frames M"]:
        return torch.from_numpy(demonstrations.actions).float()

    def _see(self, demonstrations: Demonstrations) -> None:
        self.states = torch.from_numpy(demonstrations.observations[STATE]).float()


def of_state(state: Float32[Tensor, "batch dims"], own: int) -> dict[str, Tensor]:
    """What ACT sees of states whose first `own` numbers are the robot's."""
    return {STATE: state[:, :own], WORLD_STATE: state}


def as_seen(images: UInt8[Tensor, "*batch height width 3"]) -> Float32[Tensor, "*batch 3 height width"]:
    """Images as LeRobot's policies take them, channels first, in 0..1."""
    return images.movedim(-1, -3).float() / 255


def _statistics(values: Float32[Tensor, "frames dims"]) -> dict[str, Tensor]:
    return {"mean": values.mean(0), "std": values.std(0)}
