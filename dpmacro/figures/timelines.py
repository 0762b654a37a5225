"""Demonstrations along time: what was seen, true classes, macro-actions and how sure they are, actions."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from jaxtyping import Float, Int, UInt8
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, MaxNLocator

from dpmacro.figures.strips import (
    STRIP,
    THUMBNAILS,
    Line,
    changes,
    class_names,
    draw_line,
    draw_strip,
    draw_thumbnails,
    true_name,
    write_names,
)
from dpmacro.figures.style import (
    ACTIONS,
    GREYS,
    INK,
    PALETTE,
    WIDTH,
    bare,
    legend,
    legend_height,
    macro_colour,
    one_line,
    set_title,
    shortened,
)

ROW, TALL = 0.36, 0.72  # inches, of rows of strips and lines
GAP = 0.06  # inches, between two rows
FRAME = 1.15  # inches, for the title and the frames' numbers
DEMONSTRATION, LEAST, MOST = 0.28, 1.1, 38.0  # inches, of one among all, and of all
LETTERS = 22  # of a row's name


@dataclass(frozen=True)
class _Row:
    name: str
    height: float  # inches
    draw: Callable[[Axes], None]  # within 0..1


def timeline(
    images: UInt8[np.ndarray, "frames height width 3"] | Mapping[str, UInt8[np.ndarray, "frames _ _ 3"]],
    labels: Int[np.ndarray, " frames"],
    actions: Int[np.ndarray, " frames"] | Sequence[Line],
    truth: Int[np.ndarray, " frames"] | None = None,
    title: str = "",
    action_names: Sequence[str] = (),
    truth_name: str | None = None,
    truth_classes: Sequence[str] = (),
    confidence: Float[np.ndarray, " frames"] | None = None,
) -> Figure:
    """One demonstration along time: what was seen, true classes, macro-actions found, actions taken.

    Found change points are drawn through every row, true ones dashed through the two that show them. Where
    `confidence`, 0..1, is low the macro-action's colour is pale.

    Args:
        images: of the only camera, or of each by its name; {} where there is none.
        labels: macro-action of every frame.
        actions: classes, or the numbers of vectors that are worth a row.
        truth: true class of every frame.
        title: above all.
        action_names: of classes.
        truth_name: the column of the truth.
        truth_classes: names of its classes 0..K-1.
        confidence: in every frame's label.
    """
    seen = images if isinstance(images, Mapping) else {"seen": images}
    classes = {} if truth is None else class_names(truth, truth_classes)
    rows = [
        _Row(
            name, STRIP / THUMBNAILS * shown.shape[1] / shown.shape[2], partial(draw_thumbnails, images=shown)
        )
        for name, shown in seen.items()
    ]
    if truth is not None:
        rows.append(_Row(true_name(truth_name), ROW, partial(_true_strip, truth=truth, classes=classes)))
    rows.append(_Row("macro-action", ROW, partial(_found_strip, labels, confidence, truth)))
    if isinstance(actions, np.ndarray):
        rows.append(_Row("action", ROW, lambda axis: draw_strip(axis, actions, ACTIONS, 0.0, 1.0)))
    else:
        rows += [
            _Row(line.name, TALL if line.tall else ROW, partial(draw_line, line=line, labels=labels))
            for line in actions
        ]
    colours, names = _meaning(actions, action_names, classes)
    heights = [row.height for row in rows]
    below = FRAME + legend_height(names, confidence is not None)
    size = WIDTH, sum(heights) + GAP * (len(rows) - len(seen)) + below
    figure = Figure(figsize=size, layout="constrained")
    axes = figure.subplots(len(rows), 1, sharex=True, height_ratios=heights, squeeze=False)[:, 0]
    for axis, row in zip(axes, rows, strict=True):
        bare(axis)
        text = shortened(one_line(row.name), LETTERS)
        axis.set_ylabel(text, rotation=0, ha="right", va="center", color=INK, labelpad=8)
        row.draw(axis)
        axis.vlines(changes(labels), 0, 1, color="black", linewidth=1.6)
        axis.set_ylim(0, 1)
    _count_frames(axes[-1], len(labels))
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
    macros = np.unique(labels).tolist()
    colours, names = [macro_colour(macro) for macro in macros], [f"macro-action {macro}" for macro in macros]
    for number, name in {} if truth is None else class_names(truth, truth_classes).items():
        colours.append(GREYS[number % len(GREYS)])
        names.append(f"{true_name(truth_name)} {number}" if name == str(number) else f"true: {name}")
    tall = min(max(DEMONSTRATION * len(lengths), LEAST), MOST)
    below = legend_height(names, confidence is not None)
    figure = Figure(figsize=(WIDTH, tall + FRAME + below), layout="constrained")
    axis = figure.subplots()
    ends = np.cumsum(lengths)
    for row, (start, end) in enumerate(zip(ends - lengths, ends, strict=True)):
        part = slice(start, end)
        sure = None if confidence is None else confidence[part]
        draw_strip(axis, labels[part], PALETTE, row - 0.4, 0.5 if truth is not None else 0.8, sure)
        if truth is not None:
            draw_strip(axis, truth[part], GREYS, row + 0.13, 0.27)
    bare(axis)
    axis.set_ylim(len(lengths) - 0.4, -0.6)
    axis.tick_params(axis="y", labelleft=True)
    axis.yaxis.set_major_locator(MaxNLocator(25, integer=True))
    if numbers is not None:
        of_row = {row: str(number) for row, number in enumerate(numbers)}
        axis.yaxis.set_major_formatter(FuncFormatter(lambda row, _: of_row.get(round(row), "")))
    axis.set_ylabel("demonstration")
    _count_frames(axis, int(lengths.max()))
    legend(figure, colours, names, confidence is not None)
    set_title(figure, title)
    return figure


def _count_frames(axis: Axes, count: int) -> None:
    axis.set_xlim(0, count)
    axis.tick_params(axis="x", bottom=True, labelbottom=True)
    axis.xaxis.set_major_locator(MaxNLocator(8, integer=True))
    axis.set_xlabel("frame")


def _true_strip(axis: Axes, truth: Int[np.ndarray, " frames"], classes: Mapping[int, str]) -> None:
    draw_strip(axis, truth, GREYS, 0.0, 1.0)
    write_names(axis, truth, GREYS, classes)
    _dashed(axis, truth)


def _found_strip(
    labels: Int[np.ndarray, " frames"],
    confidence: Float[np.ndarray, " frames"] | None,
    truth: Int[np.ndarray, " frames"] | None,
    axis: Axes,
) -> None:
    draw_strip(axis, labels, PALETTE, 0.0, 1.0, confidence)
    write_names(axis, labels, PALETTE, {}, confidence)
    if truth is not None:
        _dashed(axis, truth)


def _meaning(
    actions: Int[np.ndarray, " frames"] | Sequence[Line],
    action_names: Sequence[str],
    classes: Mapping[int, str],
) -> tuple[list[str], list[str]]:
    """The colours of a timeline's legend and what they mean: actions, and true classes that have names."""
    used = np.unique(actions).tolist() if isinstance(actions, np.ndarray) else []
    colours = [ACTIONS[action % len(ACTIONS)] for action in used]
    names = [action_names[action] if action < len(action_names) else f"action {action}" for action in used]
    if any(name != str(number) for number, name in classes.items()):
        colours += [GREYS[number % len(GREYS)] for number in classes]
        names += [f"{number}: {name}" for number, name in classes.items()]
    return colours, names


def _dashed(axis: Axes, truth: Int[np.ndarray, " frames"]) -> None:
    """True change points."""
    axis.vlines(changes(truth), 0, 1, color="black", linewidth=1.6, linestyle=(0, (2, 1.2)))
