"""What encoders of one camera's images have in common."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any

import torch
from jaxtyping import Bool, UInt8
from torch import Tensor

from dpmacro.features.base import Seen, look

__all__ = ["CameraEncoder"]


@dataclass(frozen=True)
class CameraEncoder(ABC):
    """Columns of one camera, computed from an image and the one before it.

    Attributes:
        camera: its key.
        height, width: of its images, in pixels.
    """

    camera: str
    height: int
    width: int
    kind = "camera"  # a subclass has its own
    dtype = torch.int32
    lags = (0, 1)

    @property
    @abstractmethod
    def count(self) -> int:
        """The number of columns."""

    @property
    def keys(self) -> tuple[str, ...]:
        """The camera's."""
        return (self.camera,)

    @property
    def needs(self) -> dict[str, tuple[int, ...]]:
        """The image and the one before it."""
        return {self.camera: self.lags}

    @property
    def sees_pixels(self) -> Bool[Tensor, " columns"]:
        """All do."""
        device = next(iter(self.tensors().values())).device
        return torch.ones(self.count, dtype=torch.bool, device=device)

    @abstractmethod
    def tensors(self) -> dict[str, Tensor]:
        """What defines the columns beside `spec`."""

    def spec(self) -> dict[str, Any]:
        """The camera and the size of its images."""
        return {"kind": self.kind, "camera": self.camera, "height": self.height, "width": self.width}

    def looked_at(self, seen: Seen) -> tuple[UInt8[Tensor, "frames _ _ 3"], UInt8[Tensor, "frames _ _ 3"]]:
        """The images and those before them. Raises ValueError where one lacks or has another size."""
        now, before = (look(seen, lag, self.camera, (self.height, self.width, 3)) for lag in self.lags)
        return now, before
