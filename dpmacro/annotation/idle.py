"""Idle stretches: where a demonstration stands still for a second or more.

A second is still where no column moves more in it than its own noise explains, or than a small share of what
it moves in its fastest seconds. The noise is measured where a column is quietest: the second difference
x_{n-1} - 2 x_n + x_{n+1} of independent noise of deviation s has deviation sqrt(6) s, while that of a steady
motion is next to nothing. So noise is told from slow motion, which has no second difference of that size.
"""

import math

import numpy as np
from jaxtyping import Bool, Float, Int, Num
from numpy.lib.stride_tricks import sliding_window_view
from scipy.ndimage import maximum_filter1d, median_filter, minimum_filter1d

from dpmacro.data.demonstrations import Demonstrations
from dpmacro.utils.checks import as_number

__all__ = ["idle_frames", "moving_columns"]

SECONDS = 1.0  # that a stretch lasts at least
NOISES = 6.0  # deviations of a column's noise between its highest and lowest value in a still second
QUIETEST = 0.1  # share of the stretches by whose quietest the noise is measured
SHARE = 0.005  # of what a column moves in its fastest seconds
FASTEST = 0.99  # quantile of the seconds that counts as fastest: a glitch is faster
SMOOTHED = 0.2  # seconds over which medians are taken: what lasts less than half of that is a glitch
FEWEST = 5  # second differences by which the noise of a stretch is measured
GRID = 4  # rows and columns of the parts of an image
CHUNK = 256  # images at a time


def idle_frames(
    values: Num[np.ndarray, "frames columns"],
    lengths: Int[np.ndarray, " demonstrations"],
    fps: int | float,
    seconds: int | float = SECONDS,
) -> Bool[np.ndarray, " frames"]:
    """Whether each frame lies in a stretch of `seconds` or more in which no column moves.

    A demonstration that is shorter is idle as a whole or not at all. Adding a number to a column or scaling
    it changes nothing. A column says nothing where it is not finite; a frame that has no finite number is
    not idle, nor is a demonstration of one frame. Where something jumps in the middle of a rest, as a gripper
    that closes while the arm stands still, the frames before and after it are not idle.

    Args:
        values: what moves, demonstrations one after another: states, actions, or what images show.
        lengths: frames of every demonstration.
        fps: frames a second, above 0.
        seconds: above 0.

    Raises ValueError where lengths do not add up, or a number is out of range.
    """
    fps, seconds = as_number("fps", fps, above=0.0), as_number("seconds", seconds, above=0.0)
    if int(lengths.sum()) != len(values):
        raise ValueError(
            f"lengths add up to {int(lengths.sum())} frames but values have {len(values)}: make them agree"
        )
    if not values.shape[1] or not len(values):
        return np.zeros(len(values), bool)
    window = max(2, math.ceil(round(fps * seconds, 6)))
    ends = np.cumsum(lengths)
    parts = [slice(end - length, end) for end, length in zip(ends.tolist(), lengths.tolist(), strict=True)]
    known = np.isfinite(values)
    filled = [_filled(values[part].astype(np.float64), known[part]) for part in parts]
    medians = 2 * math.floor(fps * SMOOTHED / 2) + 1
    smooth = [median_filter(one, (medians, 1), mode="nearest") for one in filled]
    moved = [_moved(one, window) for one in smooth]
    allowed = _allowed(filled, moved, window, values.dtype)
    seen = np.split(known.any(1), ends[:-1])
    marked = []
    for one, own, shown in zip(moved, smooth, seen, strict=True):
        idle = _within(np.all(one <= allowed, axis=1), len(own)) & shown
        jumps = (np.abs(np.diff(own, axis=0)) > allowed).any(1) & idle[:-1] & idle[1:]
        idle[:-1] &= ~jumps
        idle[1:] &= ~jumps
        marked.append(_lasting(idle, min(window, len(idle))))
    return np.concatenate(marked)


def moving_columns(demonstrations: Demonstrations) -> Float[np.ndarray, "frames columns"]:
    """What tells whether anything moves in demonstrations: the columns for `idle_frames`.

    Those of all vectors that are seen, and of actions that are vectors: a gripper may close by a command
    alone while the arm stands still. Where there are neither, the brightness of parts of every camera's
    image. Actions that are classes tell nothing of rest: forward after forward is motion.
    """
    seen = [values for values in demonstrations.observations.values() if values.ndim == 2]
    columns = [*seen, *([demonstrations.actions] if demonstrations.vector else [])]
    if not columns:
        images = (demonstrations.observations[camera] for camera in demonstrations.cameras)
        columns = [_brightness(image) for image in images]
    if not columns:
        return np.zeros((int(demonstrations.lengths.sum()), 0))
    return np.concatenate(columns, 1)  # of their own type: its rounding is no motion


def _filled(
    values: Float[np.ndarray, "frames columns"], known: Bool[np.ndarray, "frames columns"]
) -> Float[np.ndarray, "frames columns"]:
    """What is not known as it was last, else as it is next, else 0."""
    if known.all():
        return values
    time = np.arange(len(values))[:, None]
    last = np.maximum.accumulate(np.where(known, time, -1), 0)
    source = np.where(last >= 0, last, known.argmax(0))
    return np.where(known.any(0), np.take_along_axis(np.where(known, values, 0), source, 0), 0)


def _moved(values: Float[np.ndarray, "frames columns"], window: int) -> Float[np.ndarray, "windows columns"]:
    """Highest less lowest value of every column in every `window` frames, or in all where they are fewer."""
    size = min(window, len(values))
    first = slice(size // 2, size // 2 + len(values) - size + 1)  # filters are centred
    highest, lowest = (fold(values, size, axis=0)[first] for fold in (maximum_filter1d, minimum_filter1d))
    return highest - lowest


def _allowed(
    values: list[Float[np.ndarray, "..."]],
    moved: list[Float[np.ndarray, "..."]],
    window: int,
    dtype: np.dtype,
) -> Float[np.ndarray, " columns"]:
    """How much every column may move in a still second."""
    fastest = np.quantile(np.concatenate(moved), FASTEST, axis=0)
    size = max(window - 2, FEWEST)
    quiet = [_roughness(one, size) for one in values if len(one) > 2]
    noise = np.quantile(np.concatenate(quiet), QUIETEST, axis=0) if quiet else np.zeros(len(fastest))
    precision = np.finfo(dtype).eps if np.issubdtype(dtype, np.floating) else 0
    rounding = precision * np.max([np.abs(one).max(0) for one in values], 0)
    return np.maximum(np.maximum(NOISES * noise, SHARE * fastest), 2 * rounding)


def _roughness(
    values: Float[np.ndarray, "frames columns"], size: int
) -> Float[np.ndarray, "windows columns"]:
    """Deviation of independent noise with the second differences of every `size` frames, or of all."""
    squares = np.diff(values, 2, axis=0) ** 2
    means = sliding_window_view(squares, min(size, len(squares)), 0).mean(-1)
    return np.sqrt(means / 6)


def _within(still: Bool[np.ndarray, " windows"], n_frames: int) -> Bool[np.ndarray, " frames"]:
    """The frames of the windows that are still."""
    edges = np.zeros(n_frames + 1, np.int64)
    starts = np.flatnonzero(still)
    edges[starts] += 1
    edges[starts + n_frames - len(still) + 1] -= 1
    return edges.cumsum()[:-1] > 0


def _lasting(marked: Bool[np.ndarray, " frames"], least: int) -> Bool[np.ndarray, " frames"]:
    """The stretches of `least` frames or more, and of two at least: one frame shows no rest."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], marked, [False]]).astype(np.int8)))
    starts, ends = edges[::2], edges[1::2]
    lasts = ends - starts >= max(least, 2)
    kept = np.zeros(len(marked), bool)
    for start, end in zip(starts[lasts].tolist(), ends[lasts].tolist(), strict=True):
        kept[start:end] = True
    return kept


def _brightness(images: Num[np.ndarray, "frames height width channels"]) -> Float[np.ndarray, "frames parts"]:
    """Mean of every part of a grid over each image."""
    rows, columns = (np.array_split(np.arange(size), min(GRID, size)) for size in images.shape[1:3])
    parts = []
    for first in range(0, len(images), CHUNK):
        grey = images[first : first + CHUNK].mean(3)
        parts.append(
            np.stack(
                [grey[:, r[0] : r[-1] + 1, c[0] : c[-1] + 1].mean((1, 2)) for r in rows for c in columns], 1
            )
        )
    return np.concatenate(parts)
