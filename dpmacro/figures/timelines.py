"""Demonstrations along time: what was seen, true classes, macro-actions and how sure they are, actions."""

import itertools
from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float, Int, UInt8
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.ticker import FuncFormatter, MaxNLocator

from dpmacro.figures.style import (
    ACTIONS,
    GREYS,
    INK,
    PALETTE,
    WIDTH,
    bare,
    faded,
    ink_on,
    legend,
    macro_colour,
    set_title,
)

THUMBNAILS = 12
LETTER = 0.1  # inches, of a bold one
STRIP = 0.82 * WIDTH  # inches, of the longest demonstration


def timeline(
    images: UInt8[np.ndarray, "frames height width 3"],
    labels: Int[np.ndarray, " frames"],
    actions: Int[np.ndarray, " frames"],
    truth: Int[np.ndarray, " frames"] | None = None,
    title: str = "",
    action_names: Sequence[str] = (),
    truth_name: str | None = None,
    truth_classes: Sequence[str] = (),
    confidence: Float[np.ndarray, " frames"] | None = None,
) -> Figure:
    """One demonstration along time: what was seen, true classes, macro-actions found, actions taken.

    Found change points are drawn through every row, true ones dashed through the two that show them. Where
    `confidence`, 0..1, is low the macro-action's colour is pale. `truth_name` is the column of the truth and
    `truth_classes` names its classes 0..K-1.
    """
    classes = {} if truth is None else _class_names(truth, truth_classes)
    rows = ["macro-action", "action"] if truth is None else [_true(truth_name), "macro-action", "action"]
    thumbnail = STRIP / THUMBNAILS * images.shape[1] / images.shape[2]
    figure = Figure(figsize=(WIDTH, thumbnail + 0.42 * len(rows) + 1.35), layout="constrained")
    heights = [thumbnail, *[0.36] * len(rows)]
    axes = figure.subplots(len(heights), 1, sharex=True, height_ratios=heights)
    _thumbnails(axes[0], images)
    for axis, name in zip(axes, ["seen", *rows], strict=True):
        bare(axis)
        axis.set_ylabel(name, rotation=0, ha="right", va="center", color=INK, labelpad=8)
    if truth is not None:
        _strip(axes[1], truth, GREYS, 0.0, 1.0)
        _write(axes[1], truth, GREYS, classes)
    _strip(axes[-2], labels, PALETTE, 0.0, 1.0, confidence)
    _write(axes[-2], labels, PALETTE, {}, confidence)
    _strip(axes[-1], actions, ACTIONS, 0.0, 1.0)
    for axis in axes:
        axis.vlines(_changes(labels), 0, 1, color="black", linewidth=1.6)
        axis.set_ylim(0, 1)
    if truth is not None:
        for axis in axes[1:3]:
            axis.vlines(_changes(truth), 0, 1, color="black", linewidth=1.6, linestyle=(0, (2, 1.2)))
    axes[-1].set_xlim(0, len(images))
    axes[-1].tick_params(axis="x", bottom=True, labelbottom=True)
    axes[-1].xaxis.set_major_locator(MaxNLocator(8, integer=True))
    axes[-1].set_xlabel("frame")
    used = np.unique(actions).tolist()
    colours = [ACTIONS[action % len(ACTIONS)] for action in used]
    names = [action_names[action] if action < len(action_names) else f"action {action}" for action in used]
    if any(name != str(number) for number, name in classes.items()):
        colours += [GREYS[number % len(GREYS)] for number in classes]
        names += [f"{number}: {name}" for number, name in classes.items()]
    legend(figure, colours, names, confidence is not None)
    set_title(figure, title)
    return figure


def timelines(
    labels: Int[np.ndarray, " frames"],
    lengths: Int[np.ndarray, " trajectories"],
    truth: Int[np.ndarray, " frames"] | None = None,
    title: str = "",
    truth_name: str | None = None,
    truth_classes: Sequence[str] = (),
    confidence: Float[np.ndarray, " frames"] | None = None,
    numbers: Sequence[int] | None = None,
) -> Figure:
    """All demonstrations of a dataset, one below the other: macro-actions found, true classes under them.

    Where `confidence`, 0..1, is low the macro-action's colour is pale. `numbers` are those of the
    demonstrations, by default 0, 1, ...
    """
    figure = Figure(figsize=(WIDTH, min(1.5 + 0.28 * len(lengths), 40.0)), layout="constrained")
    axis = figure.subplots()
    ends = np.cumsum(lengths)
    for row, (start, end) in enumerate(zip(ends - lengths, ends, strict=True)):
        part = slice(start, end)
        sure = None if confidence is None else confidence[part]
        _strip(axis, labels[part], PALETTE, row - 0.4, 0.5 if truth is not None else 0.8, sure)
        if truth is not None:
            _strip(axis, truth[part], GREYS, row + 0.13, 0.27)
    bare(axis)
    axis.set_ylim(len(lengths) - 0.4, -0.6)
    axis.set_xlim(0, int(lengths.max()))
    axis.tick_params(axis="both", left=False, labelleft=True, bottom=True, labelbottom=True)
    axis.yaxis.set_major_locator(MaxNLocator(25, integer=True))
    if numbers is not None:
        axis.yaxis.set_major_formatter(
            FuncFormatter(lambda row, _: str(numbers[round(row)]) if 0 <= row < len(numbers) else "")
        )
    axis.xaxis.set_major_locator(MaxNLocator(8, integer=True))
    axis.set_ylabel("demonstration")
    axis.set_xlabel("frame")
    macros = np.unique(labels).tolist()
    colours, names = [macro_colour(macro) for macro in macros], [f"macro-action {macro}" for macro in macros]
    for number, name in {} if truth is None else _class_names(truth, truth_classes).items():
        colours.append(GREYS[number % len(GREYS)])
        names.append(f"{_true(truth_name)} {number}" if name == str(number) else f"true: {name}")
    legend(figure, colours, names, confidence is not None)
    set_title(figure, title)
    return figure


def _true(truth_name: str | None) -> str:
    return f"true {truth_name or 'class'}"


def _class_names(truth: Int[np.ndarray, " frames"], names: Sequence[str]) -> dict[int, str]:
    """The name of every class that occurs, its number where it has none."""
    return {
        number: names[number] if 0 <= number < len(names) else str(number)
        for number in np.unique(truth).tolist()
    }


def _thumbnails(axis: Axes, images: UInt8[np.ndarray, "frames height width 3"]) -> None:
    """Pictures side by side, each over the frames it stands for and taken from their middle."""
    edges = np.linspace(0, len(images), min(THUMBNAILS, len(images)) + 1)
    for start, end in itertools.pairwise(edges):
        gap = 0.02 * (end - start)
        extent = (start + gap, end - gap, 0.0, 1.0)
        axis.imshow(images[int((start + end) / 2)], extent=extent, aspect="auto", interpolation="nearest")


def _strip(
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


def _write(
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
        room = (end - start) / len(values) * STRIP / LETTER - 2
        text = next((text for text in (names.get(number, ""), str(number)) if 0 < len(text) <= room), "")
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


def _stretches(values: Int[np.ndarray, " frames"]) -> tuple[np.ndarray, np.ndarray]:
    """First frames of the stretches of equal values, and the ones after their last."""
    edges = np.concatenate([[0], _changes(values), [len(values)]])
    return edges[:-1], edges[1:]


def _rgb(values: Int[np.ndarray, " frames"], colours: Sequence[str]) -> Float[np.ndarray, "frames 3"]:
    return np.array([to_rgb(colour) for colour in colours])[values % len(colours)]


def _changes(values: Int[np.ndarray, " frames"]) -> Int[np.ndarray, " changes"]:
    return np.flatnonzero(np.diff(values)) + 1
