"""Segmentations, training curves and success rates as pictures, without matplotlib's global state."""

import itertools
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Int, UInt8
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator, PercentFormatter

from dpmacro.files import replacing
from dpmacro.metrics import wilson_interval

# Okabe and Ito's colours, distinct under the common kinds of colour blindness; truth stands in greys.
PALETTE = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#56B4E9", "#D55E00", "#000000", "#F0E442")
GREYS = ("#D3D8DC", "#6B757E", "#A3ACB4", "#3D454C")
ACTIONS = ("#E8E4DA", "#56B4E9", "#D55E00", "#009E73", "#CC79A7", "#F0E442", "#0072B2", "#E69F00")
OUTCOME_COLOURS = {
    "success": "#009E73",
    "red_first": "#D55E00",
    "blue_never_reached": "#56B4E9",
    "red_never_reached": "#CC79A7",
}
INK = "#222222"
THUMBNAILS = 12
WIDTH = 12.0


def macro_colour(macro: int) -> str:
    """Colour of a macro-action as "#rrggbb", the same in every picture and video."""
    return PALETTE[macro % len(PALETTE)]


def timeline(
    images: UInt8[np.ndarray, "frames height width 3"],
    labels: Int[np.ndarray, " frames"],
    actions: Int[np.ndarray, " frames"],
    truth: Int[np.ndarray, " frames"] | None = None,
    title: str = "",
    action_names: Sequence[str] = (),
) -> Figure:
    """One demonstration along time: what was seen, true phase, macro-actions found, actions taken.

    Found change points are drawn through every row, true ones dashed through the two that show them.
    """
    strips: dict[str, tuple[np.ndarray, Sequence[str], bool]] = {
        "macro-action": (labels, PALETTE, True),
        "action": (actions, ACTIONS, False),
    }
    if truth is not None:
        strips = {"true phase": (truth, GREYS, True), **strips}
    thumbnail = WIDTH * 0.82 / THUMBNAILS * images.shape[1] / images.shape[2]
    figure = Figure(figsize=(WIDTH, thumbnail + 0.42 * len(strips) + 1.35), layout="constrained")
    heights = [thumbnail, *[0.36] * len(strips)]
    axes = figure.subplots(len(heights), 1, sharex=True, height_ratios=heights)
    _thumbnails(axes[0], images)
    _row_name(axes[0], "seen")
    for axis, (name, (values, colours, named)) in zip(axes[1:], strips.items(), strict=True):
        _strip(axis, values, colours, 0.0, 1.0, named)
        _row_name(axis, name)
        axis.set_ylim(0, 1)
    for axis in axes:
        axis.vlines(_changes(labels), 0, 1, color="black", linewidth=1.6)
    if truth is not None:
        for axis in axes[1:3]:
            axis.vlines(_changes(truth), 0, 1, color="black", linewidth=1.6, linestyle=(0, (2, 1.2)))
    axes[-1].set_xlim(0, len(images))
    axes[-1].tick_params(axis="x", bottom=True, labelbottom=True)
    axes[-1].set_xlabel("frame")
    used = np.unique(actions).tolist()
    names = [action_names[action] if action < len(action_names) else f"action {action}" for action in used]
    _legend(figure, [ACTIONS[action % len(ACTIONS)] for action in used], names)
    _title(figure, title)
    return figure


def timelines(
    labels: Int[np.ndarray, " frames"],
    lengths: Int[np.ndarray, " trajectories"],
    truth: Int[np.ndarray, " frames"] | None = None,
    title: str = "",
) -> Figure:
    """All demonstrations of a dataset, one below the other: macro-actions found, true phase under them."""
    figure = Figure(figsize=(WIDTH, min(1.5 + 0.28 * len(lengths), 40.0)), layout="constrained")
    axis = figure.subplots()
    ends = np.cumsum(lengths)
    for row, (start, end) in enumerate(zip(ends - lengths, ends, strict=True)):
        _strip(axis, labels[start:end], PALETTE, row - 0.4, 0.5 if truth is not None else 0.8)
        if truth is not None:
            _strip(axis, truth[start:end], GREYS, row + 0.13, 0.27)
    _bare(axis)
    axis.set_ylim(len(lengths) - 0.4, -0.6)
    axis.set_xlim(0, int(lengths.max()))
    axis.tick_params(axis="both", left=False, labelleft=True, bottom=True, labelbottom=True)
    axis.yaxis.set_major_locator(MaxNLocator(25, integer=True))
    axis.set_ylabel("demonstration")
    axis.set_xlabel("frame")
    macros = np.unique(labels).tolist()
    colours, names = [macro_colour(macro) for macro in macros], [f"macro-action {macro}" for macro in macros]
    for phase in [] if truth is None else np.unique(truth).tolist():
        colours.append(GREYS[phase % len(GREYS)])
        names.append(f"true phase {phase}")
    _legend(figure, colours, names)
    _title(figure, title)
    return figure


def curves(
    panels: Mapping[str, Mapping[str, Sequence[float]]], title: str = "", x_name: str = "round"
) -> Figure:
    """Training curves: a panel for every quantity, in it a named line for every run, one value a round."""
    columns = 2 if len(panels) == 4 else min(len(panels), 3)
    rows = -(-len(panels) // columns)
    figure = Figure(figsize=(WIDTH * columns / 3 + 1, 3.1 * rows + 0.5), layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False).ravel()
    colour_of = {name: PALETTE[i % len(PALETTE)] for i, name in enumerate(_names(panels.values()))}
    for axis, (quantity, lines) in zip(axes, panels.items(), strict=False):
        for name, values in lines.items():
            axis.plot(range(1, len(values) + 1), values, color=colour_of[name], linewidth=1.8)
        axis.set_title(quantity, fontsize=11, loc="left", color=INK)
        axis.set_xlabel(x_name)
        axis.xaxis.set_major_locator(MaxNLocator(6, integer=True))
        axis.grid(axis="y", color="#DDDDDD", linewidth=0.8)
        axis.set_axisbelow(True)
        axis.spines[["top", "right"]].set_visible(False)
    for axis in axes[len(panels) :]:
        axis.set_visible(False)
    _legend(figure, list(colour_of.values()), list(colour_of))
    _title(figure, title)
    return figure


def success_chart(outcomes: Mapping[str, Mapping[str, int]], title: str = "") -> Figure:
    """Success table and bars in one: a line for every planner, its runs split by outcome.

    Args:
        outcomes: planner's name -> outcome -> number of runs, with "success" among the outcomes. Whiskers
            are the 95% Wilson interval of the success rate.
        title: above all.
    """
    figure = Figure(figsize=(WIDTH, 1.5 + 0.55 * len(outcomes)), layout="constrained")
    axis = figure.subplots()
    kinds = [kind for kind in OUTCOME_COLOURS if any(kind in counts for counts in outcomes.values())]
    for row, counts in enumerate(outcomes.values()):
        runs, successes = sum(counts.values()), counts.get("success", 0)
        left = 0.0
        for kind in kinds:
            share = counts.get(kind, 0) / runs
            axis.barh(row, share, left=left, height=0.62, color=OUTCOME_COLOURS[kind], edgecolor="white")
            left += share
        low, high = wilson_interval(successes, runs)
        rate = successes / runs
        axis.errorbar(rate, row, xerr=[[rate - low], [high - rate]], color=INK, capsize=5, linewidth=1.6)
        text = f"{successes} of {runs}   {rate:.0%}   ({low:.0%} to {high:.0%})"
        axis.text(1.02, row, text, va="center", color=INK)
    _bare(axis)
    axis.tick_params(axis="both", length=0, labelleft=True, labelbottom=True)
    axis.set_yticks(range(len(outcomes)), list(outcomes))
    axis.set_ylim(len(outcomes) - 0.5, -0.5)
    axis.set_xlim(0, 1)
    axis.xaxis.set_major_formatter(PercentFormatter(1.0))
    axis.set_xlabel("share of runs, whiskers: 95% interval of the success rate")
    _legend(figure, [OUTCOME_COLOURS[kind] for kind in kinds], [kind.replace("_", " ") for kind in kinds])
    _title(figure, title)
    return figure


def save(figure: Figure, path: Path) -> None:
    """Write `figure` in the format of the path's suffix (.png, .svg, .pdf), whole or not at all."""
    with replacing(path) as temporary:
        figure.savefig(temporary, dpi=120)


def to_image(figure: Figure) -> UInt8[np.ndarray, "height width 3"]:
    """The figure's pixels, as TensorBoard's `add_image(..., dataformats="HWC")` takes them."""
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3].copy()


def _thumbnails(axis: Axes, images: UInt8[np.ndarray, "frames height width 3"]) -> None:
    """Pictures side by side, each over the frames it stands for and taken from their middle."""
    edges = np.linspace(0, len(images), min(THUMBNAILS, len(images)) + 1)
    for start, end in itertools.pairwise(edges):
        gap = 0.02 * (end - start)
        extent = (start + gap, end - gap, 0.0, 1.0)
        axis.imshow(images[int((start + end) / 2)], extent=extent, aspect="auto", interpolation="nearest")
    axis.set_ylim(0, 1)


def _strip(
    axis: Axes,
    values: Int[np.ndarray, " frames"],
    colours: Sequence[str],
    bottom: float,
    height: float,
    named: bool = False,
) -> None:
    """A bar for every stretch of equal values, with the value written in where there is room."""
    edges = np.concatenate([[0], _changes(values), [len(values)]])
    starts, widths, stretches = edges[:-1], np.diff(edges), values[edges[:-1]]
    shades = [colours[int(value) % len(colours)] for value in stretches]
    axis.bar(starts, height, widths, bottom, align="edge", color=shades, linewidth=0, antialiased=False)
    for start, width, value, shade in zip(starts, widths, stretches, shades, strict=True):
        if named and width > 0.03 * len(values):
            ink = "white" if np.dot(to_rgb(shade), (0.3, 0.59, 0.11)) < 0.55 else INK
            middle = (start + width / 2, bottom + height / 2)
            axis.text(*middle, str(value), color=ink, ha="center", va="center", weight="bold")


def _changes(values: Int[np.ndarray, " frames"]) -> Int[np.ndarray, " changes"]:
    return np.flatnonzero(np.diff(values)) + 1


def _names(lines: Iterable[Mapping[str, Sequence[float]]]) -> list[str]:
    return list(dict.fromkeys(name for panel in lines for name in panel))


def _bare(axis: Axes) -> None:
    axis.spines[:].set_visible(False)
    axis.tick_params(left=False, labelleft=False, bottom=False, labelbottom=False)


def _row_name(axis: Axes, name: str) -> None:
    _bare(axis)
    axis.set_ylabel(name, rotation=0, ha="right", va="center", color=INK, labelpad=8)


def _title(figure: Figure, title: str) -> None:
    figure.suptitle(title, x=0.01, ha="left", fontsize=13, weight="bold", color=INK)


def _legend(figure: Figure, colours: Sequence[str], names: Sequence[str]) -> None:
    handles = [Patch(color=colour, label=name) for colour, name in zip(colours, names, strict=True)]
    figure.legend(handles=handles, loc="outside lower center", ncols=min(len(names), 6), frameon=False)
