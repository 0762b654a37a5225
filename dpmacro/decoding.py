"""Stored pictures -> RGB arrays: encoded images on all cores, video files from their start."""

import os
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import av
import cv2
import numpy as np
from jaxtyping import UInt8

GIB = 2**30
DECODE_BLOCK = 256  # frames a thread decodes at a time: few enough to balance, enough to hide the hand-over


class DatasetError(ValueError):
    """A dataset that cannot be read, or not as demonstrations: one line with folder, value and remedy."""


@dataclass(frozen=True)
class Sight:
    """How images are held.

    Attributes:
        size: width and height that they are shrunk to, by the mean over areas; None for as they are stored.
        memory: GiB that all of them may take; None for any.
    """

    size: tuple[int, int] | None = None
    memory: float | None = None

    def of(self, image: UInt8[np.ndarray, "height width 3"], name: str) -> UInt8[np.ndarray, "h w 3"]:
        """An image as it is held. Raises DatasetError, with `name`, where it is smaller than `size`."""
        height, width = image.shape[:2]
        if self.size is None or self.size == (width, height):
            return image
        if self.size[0] > width or self.size[1] > height:
            raise DatasetError(
                f"{name}: images are {width}x{height}, image_size is {list(self.size)}: ask for smaller ones"
            )
        return cv2.resize(image, self.size, interpolation=cv2.INTER_AREA)

    def room(
        self, n_frames: int, first: UInt8[np.ndarray, "h w 3"], name: str
    ) -> UInt8[np.ndarray, "n h w 3"]:
        """An array for all images, `first` being one of them. Raises DatasetError where it is too large."""
        height, width = first.shape[:2]
        if self.memory is not None and n_frames * first.nbytes > self.memory * GIB:
            raise DatasetError(
                f"{name}: {n_frames} images of {width}x{height} take {n_frames * first.nbytes / GIB:.1f} GiB "
                f"and memory_limit is {self.memory:g}: shrink them, like --dataset.image_size=[128,96]"
            )
        return np.empty((n_frames, *first.shape), np.uint8)


def decode_images(
    encoded: np.ndarray, name: str, sight: Sight
) -> tuple[UInt8[np.ndarray, "frames h w 3"], tuple[int, int]]:
    """RGB images from PNG or JPEG bytes [frames], and the height and width that they are stored with.

    Raises DatasetError, with `name`, for one that is damaged or of another size, and what `sight` raises.
    """

    def decode(frame: int) -> np.ndarray:
        content = np.frombuffer(encoded[frame] or b"", np.uint8)
        image = cv2.imdecode(content, cv2.IMREAD_COLOR) if content.size else None
        if image is None:
            raise DatasetError(f"{name}: the image of frame {frame} is damaged; record the dataset again")
        return cv2.cvtColor(image, cv2.COLOR_BGR2RGB)

    first = decode(0)
    images = sight.room(len(encoded), sight.of(first, name), name)

    def decode_block(start: int) -> None:
        for frame in range(start, min(start + DECODE_BLOCK, len(encoded))):
            image = decode(frame)
            if image.shape != first.shape:
                raise DatasetError(
                    f"{name}: frame {frame} is {image.shape}, the first {first.shape}; resize it"
                )
            images[frame] = sight.of(image, name)

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        list(pool.map(decode_block, range(0, len(encoded), DECODE_BLOCK)))
    return images, first.shape[:2]


def decode_video(path: Path, fps: int, last: int) -> Iterator[tuple[int, np.ndarray]]:
    """(number, RGB image) of the frames 0..last of a video file, numbered by their time stamps."""
    if not path.is_file():
        raise DatasetError(f"{path}: is missing; the dataset is half-copied or half-written")
    try:
        with av.open(str(path)) as container:
            container.streams.video[0].thread_type = "AUTO"
            for frame in container.decode(video=0):
                number = round(frame.time * fps)
                yield number, frame.to_ndarray(format="rgb24")
                if number >= last:
                    return
    except av.FFmpegError as error:
        raise DatasetError(
            f"{path}: cannot be decoded ({error.strerror}); record the dataset again"
        ) from error
