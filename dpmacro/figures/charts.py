"""Training curves, success rates, and how the numbers of macro-actions and transitions were chosen."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, MaxNLocator, NullFormatter, NullLocator, PercentFormatter

from dpmacro.figures.style import GREYS, INK, PALETTE, WIDTH, bare, legend, one_line, plain, set_title
from dpmacro.metrics.success import wilson_interval

OUTCOME_COLOURS = {
    "success": "#009E73",
    "red_first": "#D55E00",
    "blue_never_reached": "#56B4E9",
    "red_never_reached": "#CC79A7",
}
CHOSEN: dict[str, Any] = {"marker": "o", "markersize": 15, "markerfacecolor": "none", "linestyle": ""}
LOGARITHMIC = 10  # times the least: costs beyond that would flatten the bend
DODGE = 0.07  # between the error bars of neighbouring lines


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
        _panel(axis, quantity, x_name)
    for axis in axes[len(panels) :]:
        axis.set_visible(False)
    legend(figure, list(colour_of.values()), list(colour_of))
    set_title(figure, title)
    return figure


def success_chart(outcomes: Mapping[str, Mapping[str, int]], title: str = "") -> Figure:
    """Success table and bars in one: a line for every planner, its runs split by outcome.

    Args:
        outcomes: planner's name -> outcome -> number of runs, with "success" among the outcomes. Whiskers
            are the 95% Wilson interval of the success rate. Outcomes without a colour of their own are grey.
        title: above all.
    """
    figure = Figure(figsize=(WIDTH, 1.5 + 0.55 * len(outcomes)), layout="constrained")
    axis = figure.subplots()
    there = {kind: GREYS[place % len(GREYS)] for place, kind in enumerate(_names(outcomes.values()))}
    colours = {kind: colour for kind, colour in OUTCOME_COLOURS.items() if kind in there}
    colours = colours | {kind: there[kind] for kind in there if kind not in colours}
    for row, counts in enumerate(outcomes.values()):
        runs, successes = sum(counts.values()), counts.get("success", 0)
        left = 0.0
        for kind, colour in colours.items():
            share = counts.get(kind, 0) / runs
            axis.barh(row, share, left=left, height=0.62, color=colour, edgecolor="white")
            left += share
        low, high = wilson_interval(successes, runs)
        rate = successes / runs
        axis.errorbar(rate, row, xerr=[[rate - low], [high - rate]], color=INK, capsize=5, linewidth=1.6)
        text = f"{successes} of {runs}   {rate:.0%}   ({low:.0%} to {high:.0%})"
        axis.text(1.02, row, text, va="center", color=INK)
    bare(axis)
    axis.tick_params(axis="both", length=0, labelleft=True, labelbottom=True)
    axis.set_yticks(range(len(outcomes)), [one_line(name) for name in outcomes])
    axis.set_ylim(len(outcomes) - 0.5, -0.5)
    axis.set_xlim(0, 1)
    axis.xaxis.set_major_formatter(PercentFormatter(1.0))
    axis.set_xlabel("share of runs, whiskers: 95% interval of the success rate")
    legend(figure, list(colours.values()), [kind.replace("_", " ") for kind in colours])
    set_title(figure, title)
    return figure


def learning_curve(
    lines: Mapping[str, Mapping[int, tuple[int, int]]],
    levels: Mapping[str, tuple[int, int]] | None = None,
    title: str = "",
) -> Figure:
    """Success rate over the number of demonstrations, a line for every planner, with 95% Wilson intervals.

    Args:
        lines: planner's name -> demonstrations -> (successes, runs).
        levels: name -> (successes, runs) of planners that learn from none, horizontal with their interval.
        title: above all.

    Raises ValueError where a planner has no point, or one of fewer than 1 demonstration.
    """
    for name, counts in lines.items():
        if min(counts, default=0) < 1:
            raise ValueError(f"{name} has points at {list(counts)}: give one or more, of 1 or more")
    levels = levels or {}
    figure = Figure(figsize=(WIDTH * 0.75, 4.6), layout="constrained")
    axis = figure.subplots()
    colours = _cycle(len(lines) + len(levels))
    for place, (colour, counts) in enumerate(zip(colours, lines.values(), strict=False)):
        numbers = sorted(counts)
        rates = np.array([counts[n][0] / counts[n][1] for n in numbers])
        ends = np.array([wilson_interval(*counts[n]) for n in numbers]).T
        x = np.array(numbers) * (1 + DODGE / 2) ** (place - (len(lines) - 1) / 2)
        style: dict[str, Any] = {"color": colour, "marker": "o", "markersize": 5, "linewidth": 1.8}
        axis.errorbar(x, rates, yerr=np.abs(ends - rates), capsize=4, **style)
    for colour, count in zip(colours[len(lines) :], levels.values(), strict=True):
        axis.axhline(count[0] / count[1], color=colour, linewidth=1.8, linestyle=(0, (4, 2)))
        axis.axhspan(*wilson_interval(*count), color=colour, alpha=0.12, linewidth=0)
    _panel(axis, "success rate, bars and band: 95% interval", "demonstrations")
    axis.set_xscale("log")
    axis.set_xticks(sorted({number for counts in lines.values() for number in counts}))
    axis.xaxis.set_major_formatter("{x:g}")
    axis.xaxis.set_minor_locator(NullLocator())
    axis.set_ylim(-0.02, 1.02)
    axis.yaxis.set_major_formatter(PercentFormatter(1.0))
    legend(figure, colours, [*lines, *levels])
    set_title(figure, title)
    return figure


def selection_chart(points: Sequence[Any], chosen: int | None = None, title: str = "") -> Figure:
    """How numbers of macro-actions Q and bounds on transitions S compare: what they gain, and what they used.

    Args:
        points: objects with `macros`, `max_transitions`, `gain` over one macro-action, its standard `error`,
            and `changes`, the transitions per trajectory that were used. With several bounds for some number
            of macro-actions there is a line for every number, over the bound; else one over Q.
        chosen: the place in `points` of the one to mark; None marks one macro-action, the line at 0.
        title: above all.

    Raises ValueError where there is no point.
    """
    if not points:
        raise ValueError("there are no points: give one at least")
    over_bound = len({point.macros for point in points}) < len(points)
    numbers = sorted({point.macros for point in points}) if over_bound else [None]

    def place(point: Any) -> float:
        if not over_bound:
            return float(point.macros)
        return point.max_transitions + (numbers.index(point.macros) - (len(numbers) - 1) / 2) * DODGE

    figure = Figure(figsize=(WIDTH, 4.2), layout="constrained")
    gains, changes = figure.subplots(1, 2)
    gains.axhline(0, color=INK, linewidth=2.6 if chosen is None else 1.0, linestyle=(0, (2, 1.5)))
    for colour, macros in zip(_cycle(len(numbers)), numbers, strict=True):
        line = sorted((point for point in points if macros in (None, point.macros)), key=place)
        x, style = [place(point) for point in line], {"color": colour, "marker": "o", "markersize": 5}
        errors = [point.error for point in line]
        gains.errorbar(x, [point.gain for point in line], yerr=errors, capsize=4, linewidth=1.8, **style)
        changes.plot(x, [point.changes for point in line], linewidth=1.8, **style)
    if chosen is not None:
        gains.plot(place(points[chosen]), points[chosen].gain, color=INK, **CHOSEN)
        changes.plot(place(points[chosen]), points[chosen].changes, color=INK, **CHOSEN)
    named = "bound S on transitions" if over_bound else "macro-actions Q"
    _panel(gains, "gain over one macro-action, nats a frame, left-out data" + _marked(chosen), named)
    _panel(changes, "transitions used per demonstration", named)
    changes.set_ylim(bottom=0)
    for axis in (gains, changes):
        axis.margins(x=0.08)
    if over_bound:
        legend(figure, _cycle(len(numbers)), [f"{macros} macro-actions" for macros in numbers])
    set_title(figure, title)
    return figure


def elbow(cost_by_bound: Float[np.ndarray, " bounds"], chosen: int | None = None, title: str = "") -> Figure:
    """Cost per frame of the best segmentation under every bound S = 0.. on transitions, `chosen` marked."""
    figure = Figure(figsize=(WIDTH * 0.6, 3.6), layout="constrained")
    axis = figure.subplots()
    axis.plot(cost_by_bound, color=PALETTE[0], marker="o", markersize=5, linewidth=1.8)
    if chosen is not None:
        axis.plot(chosen, cost_by_bound[chosen], color=INK, **CHOSEN)
    _panel(axis, "cost per frame" + _marked(chosen), "bound S on transitions in a demonstration")
    axis.margins(x=0.08)
    if cost_by_bound.min() > 0 and cost_by_bound.max() > LOGARITHMIC * cost_by_bound.min():
        axis.set_yscale("log")
        axis.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        axis.yaxis.set_major_formatter("{x:g}")
        axis.yaxis.set_minor_formatter(NullFormatter())
    set_title(figure, title)
    return figure


def _panel(axis: Axes, quantity: str, x_name: str) -> None:
    axis.set_title(one_line(quantity), fontsize=11, loc="left", color=INK)
    axis.set_xlabel(x_name)
    axis.xaxis.set_major_locator(MaxNLocator(6, integer=True, min_n_ticks=1))
    plain(axis)


def _marked(chosen: int | None) -> str:
    return "" if chosen is None else " (circle: chosen)"


def _cycle(count: int) -> list[str]:
    return [PALETTE[place % len(PALETTE)] for place in range(count)]


def _names(lines: Iterable[Mapping[str, Any]]) -> list[str]:
    return list(dict.fromkeys(name for panel in lines for name in panel))
