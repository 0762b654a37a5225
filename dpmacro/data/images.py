"""How images are held in memory: their size, shrunk if need be, and how much they may take."""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import UInt8

from dpmacro.features.memory import GIB

__all__ = ["DatasetError", "FrameBuffer", "ImageTransform"]


class DatasetError(ValueError):
    """A dataset that cannot be read, or not as demonstrations: one line with folder, value and remedy."""


@dataclass(frozen=True)
class ImageTransform:
    """What is done to stored images before anything learns from them or acts on them.

    Sizes are (width, height) in pixels.

    Attributes:
        size: what images are shrunk to, by the mean over areas; None leaves them as they are stored.
        stored: the only size that stored images may have, that of a policy's training; None allows any.
        memory: GiB that all transformed images may take together; None allows any.
    """

    size: tuple[int, int] | None = None
    stored: tuple[int, int] | None = None
    memory: float | None = None

    def apply(
        self, image: UInt8[np.ndarray, "height width 3"], name: str
    ) -> UInt8[np.ndarray, "new_height new_width 3"]:
        """The transformed image. Raises DatasetError, beginning with `name`, for a size not allowed."""
        height, width = image.shape[:2]
        if self.stored is not None and self.stored != (width, height):
            raise DatasetError(
                f"{name}: images are {width}x{height}, the policy was trained on {_text(self.stored)}"
            )
        if self.size is None or self.size == (width, height):
            return image
        if self.size[0] > width or self.size[1] > height:
            raise DatasetError(
                f"{name}: images are {width}x{height}, image_size is {_text(self.size)}: ask for smaller ones"
            )
        return cv2.resize(image, self.size, interpolation=cv2.INTER_AREA)


class FrameBuffer:
    """All images of a dataset, filled in any order; memory is taken with the first.

    Args:
        count: how many.
        transform: what is done to each before it is held.
        name: for errors.
    """

    def __init__(self, count: int, transform: ImageTransform, name: str) -> None:
        self.count, self.transform, self.name = count, transform, name
        self._images: np.ndarray | None = None
        self._stored: tuple[int, ...] = ()

    def put(self, place: int, image: UInt8[np.ndarray, "height width 3"]) -> None:
        """Hold an image at `place`; of many threads the first call must have ended.

        Raises DatasetError where its size is not that of the others, not allowed, or memory does not do.
        """
        if self._images is None:
            self._stored, self._images = image.shape, self._room(self.transform.apply(image, self.name))
        if image.shape != self._stored:
            raise DatasetError(
                f"{self.name}: frame {place} is {image.shape}, others {self._stored}; resize it"
            )
        self._images[place] = self.transform.apply(image, self.name)

    @property
    def images(self) -> UInt8[np.ndarray, "frames height width 3"]:
        """All of them."""
        assert self._images is not None, "a dataset has frames"
        return self._images

    @property
    def stored_shape(self) -> tuple[int, int] | None:
        """Height and width before they were shrunk; None where they were not."""
        shape = self._stored[0], self._stored[1]
        return None if shape == self.images.shape[1:3] else shape

    def _room(self, first: np.ndarray) -> np.ndarray:
        need, (height, width) = self.count * first.nbytes / GIB, first.shape[:2]
        if self.transform.memory is not None and need > self.transform.memory:
            raise DatasetError(
                f"{self.name}: {self.count} images of {width}x{height} take {need:.2g} GiB, and there are "
                f"{self.transform.memory:.2g} for them: give more --planner.memory_limit, shrink them, like "
                f"--dataset.image_size='[{width // 2},{height // 2}]', or take fewer --dataset.episodes"
            )
        return np.empty((self.count, *first.shape), np.uint8)


def _text(size: tuple[int, int]) -> str:
    return "{}x{}".format(*size)
