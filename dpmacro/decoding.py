"""Stored pictures -> RGB arrays: encoded images on all cores, video files from their start."""

import os
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import av
import cv2
import numpy as np
from jaxtyping import UInt8

DECODE_BLOCK = 256  # frames a thread decodes at a time: few enough to balance, enough to hide the hand-over


class DatasetError(ValueError):
    """A dataset that cannot be read, or not as demonstrations: one line with folder, value and remedy."""


def decode_images(encoded: np.ndarray, name: str) -> UInt8[np.ndarray, "frames height width 3"]:
    """RGB images from PNG or JPEG bytes [frames]; DatasetError, with `name`, for one that is damaged."""

    def decode(frame: int) -> np.ndarray:
        content = np.frombuffer(encoded[frame] or b"", np.uint8)
        image = cv2.imdecode(content, cv2.IMREAD_COLOR) if content.size else None
        if image is None:
            raise DatasetError(f"{name}: the image of frame {frame} is damaged; record the dataset again")
        return cv2.cvtColor(image, cv2.COLOR_BGR2RGB)

    first = decode(0)
    images = np.empty((len(encoded), *first.shape), np.uint8)

    def decode_block(start: int) -> None:
        for frame in range(start, min(start + DECODE_BLOCK, len(encoded))):
            image = decode(frame)
            if image.shape != first.shape:
                raise DatasetError(
                    f"{name}: frame {frame} is {image.shape}, the first {first.shape}; resize it"
                )
            images[frame] = image

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        list(pool.map(decode_block, range(0, len(encoded), DECODE_BLOCK)))
    return images


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
