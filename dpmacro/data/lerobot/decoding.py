"""Stored pictures -> RGB arrays: encoded images on all cores, video files from their start."""

import os
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import av
import cv2
import numpy as np
from jaxtyping import Int64

from dpmacro.data.images import DatasetError, FrameBuffer

DECODE_BLOCK = 256  # frames a thread decodes at a time: few enough to balance, enough to hide the hand-over


def decode_images(encoded: np.ndarray, places: Int64[np.ndarray, " frames"], buffer: FrameBuffer) -> None:
    """Put RGB images from PNG or JPEG bytes [frames] into their places.

    Raises DatasetError for one that is damaged, and what the buffer raises.
    """

    def put(frame: int) -> None:
        content = np.frombuffer(encoded[frame] or b"", np.uint8)
        image = cv2.imdecode(content, cv2.IMREAD_COLOR) if content.size else None
        if image is None:
            raise DatasetError(
                f"{buffer.name}: the image of frame {places[frame]} is damaged; record the dataset again"
            )
        buffer.put(int(places[frame]), cv2.cvtColor(image, cv2.COLOR_BGR2RGB))

    def put_block(start: int) -> None:
        for frame in range(start, min(start + DECODE_BLOCK, len(encoded))):
            put(frame)

    put(0)
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        list(pool.map(put_block, range(0, len(encoded), DECODE_BLOCK)))


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
