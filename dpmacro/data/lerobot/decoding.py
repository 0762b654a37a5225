"""Stored pictures -> RGB arrays, on all cores: images in blocks, videos by runs from key frames.

A video's frame is stored as brightness and two differences of colour, and RGB is a linear function of these.
Where frames are to be shrunk, the three planes are, and RGB is computed of few pixels. That takes half the
time, and comes nearer to the exact mean than libav's own conversion, which rounds down.
"""

import os
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
from jaxtyping import Float32, Float64, Int64, UInt8

from dpmacro.data.images import DatasetError
from dpmacro.data.lerobot.boxes import check_tables
from dpmacro.data.lerobot.headers import MOST_PIXELS, most_pixels, stated_size

__all__ = [
    "Clip",
    "Film",
    "Picture",
    "decode_image",
    "decode_videos",
    "in_threads",
    "probe_image",
    "probe_video",
    "scan_video",
]

RUN = 400  # frames that a thread decodes at a time, at least: opening the file and seeking take a few
LEVELS = 255  # the brightest
Put = Callable[[int, np.ndarray, tuple[int, int] | None], None]
Sized = Callable[[int, int], tuple[int, int]]

# What libav takes frames for unless it is told more, and LeRobot does not tell it: ITU-R BT.601, brightness
# from 16 to 235 or, in formats with a j, from 0 to 255.
OFFSETS, FULL_OFFSETS = (16, 128, 128), (0, 128, 128)
WEIGHTS = np.array([[255 / 219, 0, 1.596027], [255 / 219, -0.391762, -0.812968], [255 / 219, 2.017232, 0]])
FULL_WEIGHTS = np.array([[1, 0, 1.402], [1, -0.344136, -0.714136], [1, 1.772, 0]])
DEPTH_FORMATS = ("gray9", "gray10", "gray12", "gray14", "gray16")  # of libav, with or without byte order


@dataclass(frozen=True)
class Picture:
    """How a camera's pictures are stored: their size in pixels, and whether they hold depths, not colours."""

    height: int
    width: int
    depth: bool


@dataclass(frozen=True)
class Film:
    """The frames of a video file, in the order in which they are shown.

    Attributes:
        path: of the file.
        stamps: time stamp of each, in units of the stream.
        seconds: the same in seconds.
        keys: number of the key frame that each hangs on.
    """

    path: Path
    stamps: Int64[np.ndarray, " frames"]
    seconds: Float64[np.ndarray, " frames"]
    keys: Int64[np.ndarray, " frames"]

    def nearest(self, seconds: Float64[np.ndarray, " wanted"]) -> Int64[np.ndarray, " wanted"]:
        """Number of the frame nearest to each time; the earlier of two as near."""
        after = np.searchsorted(self.seconds, seconds).clip(1, max(len(self.seconds) - 1, 1))
        pairs = np.stack([after - 1, np.minimum(after, len(self.seconds) - 1)])
        return pairs[np.abs(self.seconds[pairs] - seconds).argmin(0), np.arange(len(seconds))]


@dataclass(frozen=True)
class Clip:
    """Frames wanted of a film: number `numbers[k]` at `places[k]`; numbers ascend, repeats allowed."""

    film: Film
    numbers: Int64[np.ndarray, " frames"]
    places: Int64[np.ndarray, " frames"]

    def runs(self) -> list["Clip"]:
        """Parts from a key frame on, of RUN frames or more or up to a gap as long, for threads to decode."""
        keys, starts = self.film.keys[self.numbers], [0]
        for place in np.flatnonzero(np.diff(keys)) + 1:
            long = self.numbers[place] - self.numbers[starts[-1]] >= RUN
            if long or self.numbers[place] - self.numbers[place - 1] > RUN:
                starts.append(int(place))
        ends = [*starts[1:], len(self.numbers)]
        return [
            Clip(self.film, self.numbers[start:end], self.places[start:end])
            for start, end in zip(starts, ends, strict=True)
        ]


def in_threads(work: Callable[[Any], None], pieces: Iterable[Any]) -> None:
    """Call `work` for every piece, on all cores; the first error ends it."""
    pool = ThreadPoolExecutor(
        len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    )
    try:
        for done in [pool.submit(work, piece) for piece in pieces]:
            done.result()
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


def decode_image(content: Any) -> UInt8[np.ndarray, "height width 3"] | None:
    """The RGB image of PNG or JPEG bytes, or of pixels; None where they are damaged."""
    if content is None or isinstance(content, np.ndarray):
        return _as_rgb(content)
    image = _decoded(content, cv2.IMREAD_COLOR)
    return None if image is None else cv2.cvtColor(image, cv2.COLOR_BGR2RGB)


def probe_image(content: Any) -> Picture | None:
    """How an encoded image, or one of pixels, is stored; None where it is damaged."""
    if content is None or isinstance(content, np.ndarray):
        if content is not None and content.ndim == 2 and content.size and content.max() > LEVELS:
            return Picture(content.shape[0], content.shape[1], True)
        rgb = _as_rgb(content)
        return None if rgb is None else Picture(rgb.shape[0], rgb.shape[1], False)
    image = _decoded(content, cv2.IMREAD_UNCHANGED)
    if image is None:
        return None
    return Picture(image.shape[0], image.shape[1], image.dtype != np.uint8 and image.ndim == 2)


def _decoded(content: Any, mode: int) -> np.ndarray | None:
    """A PNG or JPEG file as OpenCV decodes it; None where it is neither, is damaged, or too large."""
    width, height = stated_size(content) or (0, 0)
    if not 0 < width * height <= MOST_PIXELS:
        return None
    try:
        return cv2.imdecode(np.frombuffer(content, np.uint8), mode)
    except cv2.error:
        return None


def _as_rgb(pixels: np.ndarray | None) -> UInt8[np.ndarray, "height width 3"] | None:
    """Grey levels, RGB, or RGB and alpha, from 0 to LEVELS, as RGB; None for anything else."""
    if pixels is None or not pixels.size or pixels.min() < 0 or pixels.max() > LEVELS:
        return None
    levels = pixels[..., None] if pixels.ndim == 2 else pixels
    if levels.shape[2] not in (1, 3, 4):
        return None
    colours = levels[..., :3].astype(np.uint8)
    return np.repeat(colours, 3, axis=2) if levels.shape[2] == 1 else np.ascontiguousarray(colours)


def _open_video(path: Path, new: bool = False) -> Any:
    """The container of a video file; what it holds on entering, DatasetError where there is none.

    A file that is `new` has its tables checked.
    """
    if not path.is_file():
        raise DatasetError(f"{path}: is missing; the dataset is half-copied or half-written")
    if new:
        check_tables(path)
    most = most_pixels(path.stat().st_size)
    bounds = {"max_pixels": str(most)}  # of what frames themselves say, before there is memory for one
    av.logging.set_libav_level(av.logging.FATAL)  # errors are raised; libav would write its own lines, too
    # A path as it is may be taken for a protocol; titles in a file may be in no encoding, and are not read.
    container = av.open(f"file:{path}", metadata_errors="ignore", options=bounds)
    if not container.streams.video:
        container.close()
        raise DatasetError(f"{path}: holds no video; record the dataset again")
    stream = container.streams.video[0]
    if stream.codec_context is None or not stream.time_base:
        container.close()
        raise DatasetError(f"{path}: holds a video of no known codec or clock; record the dataset again")
    width, height = stream.codec_context.width, stream.codec_context.height
    if not 0 < width * height <= most:  # libav has 0 where there are too many
        container.close()
        raise DatasetError(f"{path}: is {width}x{height}; of a file of its size 1 to {most} pixels are read")
    stream.codec_context.options = bounds
    return container


def probe_video(path: Path) -> Picture:
    """How a video file is stored; DatasetError where it is missing or damaged."""
    try:
        with _open_video(path, new=True) as container:
            codec = container.streams.video[0].codec_context
            return Picture(codec.height, codec.width, (codec.pix_fmt or "").startswith(DEPTH_FORMATS))
    except av.FFmpegError as error:
        raise _damaged(path, error) from error


def scan_video(path: Path) -> Film:
    """The frames that a file lists; nothing is decoded. Raises DatasetError as `probe_video` does."""
    stamps, keys = [], []
    try:
        with _open_video(path, new=True) as container:
            stream = container.streams.video[0]
            unit = float(stream.time_base)
            for packet in container.demux(stream):
                if packet.pts is not None and not packet.is_discard:
                    stamps.append(packet.pts)
                    if packet.is_keyframe:
                        keys.append(packet.pts)
    except av.FFmpegError as error:
        raise _damaged(path, error) from error
    if not stamps:
        raise DatasetError(f"{path}: holds no frame; record the dataset again")
    shown = np.unique(np.array(stamps, np.int64))
    of_keys = np.flatnonzero(np.isin(shown, keys))
    hang_on = np.concatenate([[0], of_keys])[np.searchsorted(of_keys, np.arange(len(shown)), "right")]
    return Film(path, shown, shown * unit, hang_on)


def decode_videos(runs: Sequence[Clip], put: Put, sized: Sized) -> None:
    """Call `put` with every frame wanted, from several threads at once.

    Args:
        runs: the frames, in parts of clips for a thread each.
        put: takes the place, the RGB image and, where that is shrunk already, the frame's height and width.
        sized: the width and height wanted of a frame of some width and height.

    Raises DatasetError where a file lacks a frame or is damaged.
    """
    in_threads(lambda run: _decode(run, put, sized), runs)


def _decode(run: Clip, put: Put, sized: Sized) -> None:
    film = run.film
    wanted: dict[int, list[int]] = {}
    for stamp, place in zip(film.stamps[run.numbers].tolist(), run.places.tolist(), strict=True):
        wanted.setdefault(stamp, []).append(place)
    try:
        # Seeking by time may land on a later key frame where frames are stored in another order than shown.
        for start in (int(film.stamps[film.keys[run.numbers[0]]]), None):
            with _open_video(film.path) as container:
                _decode_from(container, start, wanted, put, sized)
            if not wanted:
                return
    except av.FFmpegError as error:
        raise _damaged(film.path, error) from error
    place = wanted[min(wanted)][0]
    raise DatasetError(f"{film.path}: lists frame {place} but lacks it; record the dataset again")


def _decode_from(
    container: Any, start: int | None, wanted: dict[int, list[int]], put: Put, sized: Sized
) -> None:
    """Put the wanted frames, and forget them, from the key frame at `start` on; None for the file's first."""
    stream = container.streams.video[0]
    stream.codec_context.thread_count = 1  # runs keep all cores busy
    if start is not None:
        container.seek(start, stream=stream, backward=True, any_frame=False)
    last, first = max(wanted), True
    for frame in container.decode(stream):
        if first and start is not None and frame.pts is not None and frame.pts > min(wanted):
            return
        first = False
        places = wanted.pop(frame.pts, None) if frame.pts is not None else None
        if places is not None:
            size = sized(frame.width, frame.height)
            image = _shrunk(frame, size)
            stored = None if image is None else (frame.height, frame.width)
            image = frame.to_ndarray(format="rgb24") if image is None else image
            for place in places:
                put(place, image, stored)
        if not wanted or (frame.pts is not None and frame.pts > last):
            return


def _shrunk(frame: Any, size: tuple[int, int]) -> UInt8[np.ndarray, "height width 3"] | None:
    """The RGB image of a frame by means over areas; None unless it is at least halved, in usual colours."""
    to_rgb = _TO_RGB.get(frame.format.name)
    if to_rgb is None or 2 * size[0] > frame.width or 2 * size[1] > frame.height:
        return None
    planes: list[np.ndarray] = [
        np.frombuffer(plane, np.uint8).reshape(plane.height, plane.line_size)[:, : plane.width]
        for plane in frame.planes
    ]
    if frame.width % 2 == frame.height % 2 == 0:  # a fast path of OpenCV, which leaves a quarter to the other
        half = frame.width // 2, frame.height // 2
        planes[0] = cv2.resize(planes[0], half, interpolation=cv2.INTER_AREA)
    small = [cv2.resize(plane, size, interpolation=cv2.INTER_AREA) for plane in planes]
    return cv2.transform(cv2.merge(small), to_rgb)


def _affine(weights: np.ndarray, offsets: Sequence[int]) -> Float32[np.ndarray, "3 4"]:
    return np.concatenate([weights, -weights @ np.array(offsets)[:, None]], axis=1).astype(np.float32)


_TO_RGB = {f"yuv{kind}p": _affine(WEIGHTS, OFFSETS) for kind in ("420", "422", "444")}
_TO_RGB |= {f"yuvj{kind}p": _affine(FULL_WEIGHTS, FULL_OFFSETS) for kind in ("420", "422", "444")}


def _damaged(path: Path, error: av.FFmpegError) -> DatasetError:
    return DatasetError(f"{path}: cannot be decoded ({error.strerror}); record the dataset again")
