"""Rows along time that timelines are made of: pictures, strips of classes, lines of numbers."""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int, UInt8
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.patches import Rectangle

from dpmacro.figures.style import FAINT, INK, PALETTE, WIDTH, faded, ink_on, one_line

__all__ = [
    "STRIP",
    "THUMBNAILS",
    "Line",
    "changes",
    "class_names",
    "draw_line",
    "draw_strip",
    "draw_thumbnails",
    "true_name",
    "write_names",
]

THUMBNAILS = 12
LETTER = 0.1  # inches, of a bold one
STRIP = 0.82 * WIDTH  # inches, of the longest demonstration
LEAST, MOST = 1.0, 4.0  # standard deviations that a line's row spans in each direction
TINT = 0.22  # of a macro-action's colour behind a line


@dataclass(frozen=True)
class Line:
    """One number of a vector along time.

    Attributes:
        name: of its row.
        values: in standard deviations off the mean of all frames of the dataset.
        tall: whether its row is twice as tall as others.
    """

    name: str
    values: Float[np.ndarray, " frames"]
    tall: bool = False

    def part(self, frames: slice) -> "Line":
        """The same number along some of the frames."""
        return replace(self, values=self.values[frames])


def draw_thumbnails(axis: Axes, images: UInt8[np.ndarray, "frames height width 3"]) -> None:
    """Pictures side by side, each over the frames it stands for and taken from their middle."""
    edges = np.linspace(0, len(images), min(THUMBNAILS, len(images)) + 1)
    for start, end in itertools.pairwise(edges):
        gap = 0.02 * (end - start)
        extent = (start + gap, end - gap, 0.0, 1.0)
        axis.imshow(images[int((start + end) / 2)], extent=extent, aspect="auto", interpolation="nearest")


def draw_strip(
    axis: Axes,
    values: Int[np.ndarray, " frames"],
    colours: Sequence[str],
    bottom: float,
    height: float,
    confidence: Float[np.ndarray, " frames"] | None = None,
) -> None:
    """A bar in the values' colours; one that confidence shades has an outline, as it may be white."""
    if confidence is None:
        starts, ends = _stretches(values)
        shades = _rgb(values[starts], colours)
        widths = ends - starts
        axis.bar(starts, height, widths, bottom, align="edge", color=shades, linewidth=0, antialiased=False)
        return
    extent = (0, len(values), bottom, bottom + height)
    shades = faded(_rgb(values, colours), confidence)
    axis.imshow(shades[None], extent=extent, aspect="auto", interpolation="nearest")
    outline = Rectangle((0, bottom), len(values), height, fill=False, edgecolor="#999999", linewidth=0.6)
    axis.add_patch(outline)


def write_names(
    axis: Axes,
    values: Int[np.ndarray, " frames"],
    colours: Sequence[str],
    names: Mapping[int, str],
    confidence: Float[np.ndarray, " frames"] | None = None,
) -> None:
    """The value's name, or else its number, in every stretch of a strip of height 1 that has room for it."""
    shades = _rgb(values, colours)
    if confidence is not None:
        shades = faded(shades, confidence)
    for start, end in zip(*_stretches(values), strict=True):
        number = int(values[start])
        name = one_line(names.get(number, ""))
        room = (end - start) / len(values) * STRIP / LETTER - 2
        text = next((text for text in (name, str(number)) if 0 < len(text) <= room), "")
        middle = (start + end) / 2
        shade = shades[int(middle)]
        behind = {"facecolor": shade, "edgecolor": "none", "pad": 1.0}  # over the lines of change points
        axis.text(
            middle,
            0.5,
            text,
            color=ink_on(shade),
            ha="center",
            va="center",
            weight="bold",
            bbox=behind if confidence is None else None,
            zorder=5,
        )


def draw_line(axis: Axes, line: Line, labels: Int[np.ndarray, " frames"]) -> None:
    """A line between the axis's 0 and 1, its zero in grey, pale macro-actions behind it.

    A row spans its own numbers, and at least `LEAST` standard deviations to both sides, lest a tremor fill
    it; numbers beyond `MOST` are cut off.
    """
    values = np.clip(line.values, -MOST, MOST)
    low, high = min(float(values.min()), -LEAST), max(float(values.max()), LEAST)
    draw_strip(axis, labels, PALETTE, 0.0, 1.0, np.full(len(labels), TINT))
    scaled = 0.08 + 0.84 * (values - low) / (high - low)
    zero = 0.08 + 0.84 * -low / (high - low)
    axis.axhline(zero, color=FAINT, linewidth=0.8)
    steps = np.arange(len(values) + 1)
    axis.plot(steps, np.append(scaled, scaled[-1]), color=INK, linewidth=1.0, drawstyle="steps-post")


def class_names(truth: Int[np.ndarray, " frames"], names: Sequence[str]) -> dict[int, str]:
    """The name of every class that occurs, its number where it has none."""
    return {
        number: names[number] if 0 <= number < len(names) else str(number)
        for number in np.unique(truth).tolist()
    }


def true_name(truth_name: str | None) -> str:
    """What the row of true classes is called."""
    return f"true {truth_name or 'class'}"


def changes(values: Int[np.ndarray, " frames"]) -> Int[np.ndarray, " changes"]:
    """The first frame after each change."""
    return np.flatnonzero(np.diff(values)) + 1


def _stretches(values: Int[np.ndarray, " frames"]) -> tuple[np.ndarray, np.ndarray]:
    """First frames of the stretches of equal values, and the ones after their last."""
    edges = np.concatenate([[0], changes(values), [len(values)]])
    return edges[:-1], edges[1:]


def _rgb(values: Int[np.ndarray, " frames"], colours: Sequence[str]) -> Float[np.ndarray, "frames 3"]:
    return np.array([to_rgb(colour) for colour in colours])[values % len(colours)]
