"""How images are held in memory: their size, shrunk if need be, and how much they may take."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from threading import Lock

import cv2
import numpy as np
import torch
from jaxtyping import UInt8

from dpmacro.features.memory import GIB
from dpmacro.parallel import Ranks
from dpmacro.utils.checks import as_count, as_entries, as_number

__all__ = ["DatasetError", "FrameBuffer", "ImageTransform", "natural_size", "refuse_too_many"]

MOVED = 2**26  # bytes of images that ranks tell one another at a time
LARGEST = (128, 96)  # images of more pixels are shrunk, unless a size is asked for
USUAL = (64, 48)  # about as many pixels are kept of them


class DatasetError(ValueError):
    """A dataset that cannot be read, or not as demonstrations: one line with folder, value and remedy."""


def natural_size(width: int, height: int) -> tuple[int, int]:
    """The size that images are held in unless another is asked for: small ones as they are stored.

    Where there are more pixels than in 128x96, about as many as in 64x48 are kept, of the same aspect ratio,
    with even sides.
    """
    if width * height <= LARGEST[0] * LARGEST[1]:
        return width, height
    scale = (USUAL[0] * USUAL[1] / (width * height)) ** 0.5
    return max(2 * round(width * scale / 2), 2), max(2 * round(height * scale / 2), 2)


@dataclass(frozen=True)
class ImageTransform:
    """What is done to stored images before anything learns from them or acts on them.

    Sizes are (width, height) in pixels.

    Attributes:
        size: what images are shrunk to, by the mean over areas: one for all cameras, or one by the camera's
            name; `natural_size` where it is None or a camera is not named.
        stored: the only size that stored images may have, that of a policy's training, likewise for all
            cameras or by name; None allows any.
        memory: GiB that all transformed images may take together; None allows any.
    """

    size: tuple[int, int] | Mapping[str, tuple[int, int]] | None = None
    stored: tuple[int, int] | Mapping[str, tuple[int, int]] | None = None
    memory: float | None = None

    def __post_init__(self) -> None:
        for name, given in (("size", self.size), ("stored", self.stored)):
            for size in given.values() if isinstance(given, Mapping) else () if given is None else (given,):
                for side in as_entries(name, size, 2):
                    as_count(f"a side of {name}", side)
        if self.memory is not None:
            as_number("memory", self.memory, least=0.0)

    def of(self, camera: str) -> "ImageTransform":
        """What is done to the images of one camera."""
        size, stored = (
            one.get(camera) if isinstance(one, Mapping) else one for one in (self.size, self.stored)
        )
        return replace(self, size=size and (size[0], size[1]), stored=stored)

    def sized(self, width: int, height: int, name: str) -> tuple[int, int]:
        """The size of transformed images. Raises DatasetError, beginning with `name`, for one not allowed."""
        assert not isinstance(self.size, Mapping), "take the transform of one camera"
        assert not isinstance(self.stored, Mapping), "take the transform of one camera"
        if self.stored is not None and self.stored != (width, height):
            raise DatasetError(
                f"{name}: images are {width}x{height}, the policy was trained on {_text(self.stored)}"
            )
        size = natural_size(width, height) if self.size is None else self.size
        if size[0] > width or size[1] > height:
            raise DatasetError(
                f"{name}: images are {width}x{height}, image_size is {_text(size)}: ask for smaller ones"
            )
        return size

    def apply(
        self, image: UInt8[np.ndarray, "height width 3"], name: str
    ) -> UInt8[np.ndarray, "new_height new_width 3"]:
        """The transformed image. Raises DatasetError, beginning with `name`, for a size not allowed."""
        height, width = image.shape[:2]
        size = self.sized(width, height, name)
        return image if size == (width, height) else cv2.resize(image, size, interpolation=cv2.INTER_AREA)


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
        self._lock = Lock()

    def sized(self, width: int, height: int) -> tuple[int, int]:
        """The width and height that images of this width and height are held in."""
        return self.transform.sized(width, height, self.name)

    def put(
        self, place: int, image: UInt8[np.ndarray, "height width 3"], stored: tuple[int, int] | None = None
    ) -> None:
        """Hold an image at `place`; threads may call it side by side.

        `stored` is the height and width it had before it was shrunk to what `sized` says; None where it was
        not. Raises DatasetError where its size is not that of the others, not allowed, or memory does not do.
        """
        shape = image.shape if stored is None else (*stored, 3)
        with self._lock:
            if self._images is None:
                self._stored, self._images = shape, self._room(self._fit(image, stored))
        if shape != self._stored:
            raise DatasetError(f"{self.name}: frame {place} is {shape}, others {self._stored}; resize it")
        self._images[place] = self._fit(image, stored)

    def share(self, ranks: Ranks) -> None:
        """Let all ranks have the images that each has put: every place is filled by one of them.

        Raises DatasetError where their sizes differ.
        """
        shapes = [
            one
            for one in ranks.heard((self._stored, None if self._images is None else self._images.shape))
            if one[1] is not None
        ]
        if any(one != shapes[0] for one in shapes):
            raise DatasetError(f"{self.name}: images are {shapes[0][0]} and others not; resize them")
        if self._images is None:
            self._stored, self._images = shapes[0][0], np.zeros(shapes[0][1], np.uint8)
        each = max(MOVED // max(self._images[0].nbytes, 1), 1)
        for first in range(0, self.count, each):
            ranks.summed(torch.from_numpy(self._images[first : first + each]))

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

    def _fit(self, image: np.ndarray, stored: tuple[int, int] | None) -> np.ndarray:
        return image if stored is not None else self.transform.apply(image, self.name)

    def _room(self, first: np.ndarray) -> np.ndarray:
        height, width = first.shape[:2]
        refuse_too_many(self.name, self.count, [(width, height)], self.transform.memory)
        return np.zeros((self.count, *first.shape), np.uint8)


def refuse_too_many(name: str, count: int, sizes: Sequence[tuple[int, int]], memory: float | None) -> None:
    """Raise DatasetError where `count` images of every size (width, height) take more than `memory` GiB."""
    need = count * sum(3 * width * height for width, height in sizes) / GIB
    if memory is not None and need > memory:
        (width, height), several = (
            max(sizes),
            "" if len(sizes) == 1 else f" and of {len(sizes) - 1} cameras more",
        )
        raise DatasetError(
            f"{name}: {count} images of {width}x{height}{several} take {need:.2g} GiB, and there are "
            f"{memory:.2g} for them: give more --planner.memory_limit, shrink them, like "
            f"--dataset.image_size='[{width // 2},{height // 2}]', or take fewer --dataset.episodes"
        )


def _text(size: tuple[int, int]) -> str:
    return "{}x{}".format(*size)
