"""Small pictures of chosen frames, many in one file, within a budget of bytes."""

from base64 import b64encode
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Int, Int64, UInt8

from dpmacro.annotation.page.shown import Images

__all__ = ["BUDGET", "QUALITIES", "Sheet", "chosen_frames", "resized", "sprites"]

BUDGET = 18_000_000  # letters of all pictures on a page: 20 MB for 100 demonstrations, less all else there
USUAL = 100  # frames of a demonstration, and `A_SECOND` of longer ones
A_SECOND = 2
MOST = 2000  # frames of a demonstration
ON_A_SHEET = 100  # a browser decodes a whole sheet to show one frame of it
SIDES = (192, 160, 128, 96, 64, 48)  # pixels of the longer side, tried in this order
LETTERS_A_PIXEL = 0.1  # of photographs in WebP of good quality, in base64
SMALLEST = 24  # pixels of the longer side, of a picture alone that is too large at any quality
LEAST = 500  # letters that a picture is worth having from
QUALITIES = (70, 45, 25, 10)


@dataclass(frozen=True)
class Sheet:
    """Pictures of frames of one demonstration and camera, row by row in one image.

    Attributes:
        frames: of the demonstration, ascending.
        columns: pictures in a row.
        width, height: pixels of each picture.
        source: the image, WebP as a data URI.
    """

    frames: list[int]
    columns: int
    width: int
    height: int
    source: str


def chosen_frames(
    lengths: Int[np.ndarray, " demonstrations"],
    fps: float,
    n_cameras: int,
    frames: int | None = None,
    budget: int = BUDGET,
) -> list[Int64[np.ndarray, " _"]]:
    """The frames of every demonstration to show, evenly spread, the first and the last among them.

    Args:
        lengths: frames of the demonstrations.
        fps: frames a second.
        n_cameras: that look at every frame.
        frames: how many of a demonstration at most; by default 100, and two a second of longer ones.
        budget: letters of all pictures. Where it does not suffice, fewer frames are shown.

    Raises ValueError where `frames` is negative.
    """
    if frames is not None and frames < 0:
        raise ValueError(f"frames={frames}: give 0 or more pictures of a demonstration")
    usual = np.maximum(USUAL, lengths * A_SECOND / fps)
    wanted = np.minimum(lengths, np.minimum(MOST, usual if frames is None else frames)).astype(np.int64)
    afforded = budget / LEAST / max(n_cameras, 1)
    if wanted.sum() > afforded:
        wanted = np.floor(wanted * (afforded / wanted.sum())).astype(np.int64)
    return [
        np.unique(np.linspace(0, length - 1, count).round().astype(np.int64))
        for length, count in zip(lengths.tolist(), wanted.tolist(), strict=True)
    ]


def sprites(
    images: Images,
    lengths: Int[np.ndarray, " demonstrations"],
    chosen: Sequence[Int64[np.ndarray, " _"]],
    budget: int,
    camera: str = "camera",
) -> list[list[Sheet]]:
    """The sheets of every demonstration as one camera saw it; their sources are `budget` letters at most.

    Pictures are as large and as good as the budget allows. Where it does not allow poor ones, every second
    frame of a sheet is left out, and so on; a last one is made smaller. What is not needed of a sheet's share
    goes to those after it.

    Raises ValueError where an image is no RGB image of bytes of the others' size, or one is missing.
    """
    starts = np.cumsum(lengths) - lengths
    wanted = np.concatenate([start + frames for start, frames in zip(starts, chosen, strict=True)])
    rest, shrunk = len(wanted), resized(images, wanted.astype(np.int64), budget, camera)
    result: list[list[Sheet]] = []
    for frames in chosen:
        sheets = []
        for first in range(0, len(frames), ON_A_SHEET):
            part = frames[first : first + ON_A_SHEET].tolist()
            pictures = [next(shrunk) for _ in part]
            sheet = _fitting(part, pictures, budget * len(part) // rest)
            rest -= len(part)
            if sheet:
                budget -= len(sheet.source)
                sheets.append(sheet)
        result.append(sheets)
    return result


def resized(
    images: Images, wanted: Int64[np.ndarray, " chosen"], budget: int, camera: str
) -> Iterator[UInt8[np.ndarray, "height width 3"]]:
    """Every image wanted, at the size that the budget allows, as WebP; one after another.

    Raises ValueError where an image is no RGB image of bytes of the others' size, or one is missing.
    """
    size, stored, count = (0, 0), (), 0
    for image in images(wanted) if len(wanted) else ():
        if image.dtype != np.uint8 or image.ndim != 3 or image.shape[2] != 3 or 0 in image.shape:
            raise ValueError(f"{camera} has an image {image.dtype}{list(image.shape)}: give RGB of bytes")
        if not stored:
            size, stored = _size(image.shape[1], image.shape[0], budget / len(wanted)), image.shape
        if image.shape != stored:
            raise ValueError(f"{camera} has images {list(stored)} and {list(image.shape)}: give one size")
        count += 1
        yield cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    if count < len(wanted):
        raise ValueError(f"{camera} has {count} of the {len(wanted)} images asked for: give all of them")


def _size(width: int, height: int, letters: float) -> tuple[int, int]:
    """Width and height of pictures of so many letters each: of `SIDES` the largest, never enlarged."""
    for side in SIDES:
        scale = min(1.0, side / max(width, height))
        size = max(1, round(width * scale)), max(1, round(height * scale))
        if size[0] * size[1] * LETTERS_A_PIXEL <= letters:
            break
    return size


def _fitting(
    frames: list[int], pictures: list[UInt8[np.ndarray, "height width 3"]], letters: int
) -> Sheet | None:
    """A sheet whose source has so many letters at most, of all frames or of fewer; None where none fits."""
    while True:
        sheet = _tiled(pictures)
        columns = sheet.shape[1] // pictures[0].shape[1]
        for quality in QUALITIES:
            source = _webp(sheet, quality)
            if len(source) <= letters:
                height, width = pictures[0].shape[:2]
                return Sheet(frames, columns, width, height, source)
        if len(frames) > 1:
            frames, pictures = frames[::2], pictures[::2]
        elif max(pictures[0].shape) > SMALLEST:
            half = max(1, pictures[0].shape[1] // 2), max(1, pictures[0].shape[0] // 2)
            pictures = [cv2.resize(pictures[0], half, interpolation=cv2.INTER_AREA)]
        else:
            return None


def _tiled(pictures: list[UInt8[np.ndarray, "height width 3"]]) -> UInt8[np.ndarray, "rows columns 3"]:
    """Pictures row by row in one that is about as wide as high, black where there are none left."""
    count, (height, width) = len(pictures), pictures[0].shape[:2]
    columns = min(count, max(1, round((count * height / width) ** 0.5)))
    rows = -(-count // columns)
    tiles = np.zeros((rows * columns, height, width, 3), np.uint8)
    tiles[:count] = pictures
    return tiles.reshape(rows, columns, height, width, 3).swapaxes(1, 2).reshape(rows * height, -1, 3)


def _webp(image: UInt8[np.ndarray, "height width 3"], quality: int) -> str:
    done, encoded = cv2.imencode(
        ".webp", cv2.cvtColor(image, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_WEBP_QUALITY, quality]
    )
    if not done:
        raise ValueError(f"an image of {image.shape[1]}x{image.shape[0]}: OpenCV cannot write it as WebP")
    return f"data:image/webp;base64,{b64encode(encoded.tobytes()).decode()}"
