"""Which columns the classifiers rest on: bars for every macro-action."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine

from dpmacro.figures.style import INK, bare, faded, macro_colour, one_line, set_title, shortened

__all__ = ["column_bars"]

ACROSS = 3  # macro-actions side by side
SIDE = 4.0  # inches, of a macro-action
BAR = 0.23  # inches, with the space between two
LETTERS = 46  # of a bar's name
PALE = 0.38  # of the macro-action's colour: the name stands on it


def column_bars(
    weights: Sequence[Mapping[str, float]], names: Sequence[str] = (), title: str = "", most: int = 8
) -> Figure:
    """For every macro-action the columns that weigh most, as shares of the weight of all its columns.

    Args:
        weights: for every macro-action the weight, 0 or more, of every column by its name.
        names: stand above the bars, by default the numbers.
        title: above all.
        most: bars of a macro-action at most; what weighs nothing has none.

    Raises ValueError where there is no macro-action.
    """
    if not weights:
        raise ValueError("there are no weights: give those of one macro-action at least")
    across = min(len(weights), ACROSS)
    rows = -(-len(weights) // across)
    shares = [_largest(own, most) for own in weights]
    tall = max(1, *map(len, shares)) if shares else 1
    size = across * SIDE, rows * (tall * BAR + 0.42) + (0.4 if title else 0.05)
    figure = Figure(figsize=size, layout=ConstrainedLayoutEngine(w_pad=0.1))
    axes = figure.subplots(rows, across, squeeze=False).ravel()
    widest = max((share for own in shares for share in own.values()), default=1.0)
    for macro, (axis, own) in enumerate(zip(axes, shares, strict=False)):
        _bars(axis, own, macro_colour(macro), tall)
        axis.set_xlim(0, widest * 1.12)
        name = names[macro] if macro < len(names) else f"macro-action {macro}"
        axis.set_title(one_line(name), fontsize=10, loc="left", color=INK)
    for axis in axes[len(shares) :]:
        axis.set_visible(False)
    set_title(figure, title)
    return figure


def _bars(axis: Axes, shares: Mapping[str, float], colour: str, tall: int) -> None:
    """The largest on top, each with its name from the left and its share at the right."""
    bare(axis)
    axis.spines["left"].set(visible=True, color=colour, linewidth=5)
    pale = faded(np.array(to_rgb(colour)), np.array(PALE))
    axis.barh(range(len(shares)), list(shares.values()), height=0.82, color=pale)
    for row, (name, share) in enumerate(shares.items()):
        style: dict[str, Any] = {
            "va": "center",
            "fontsize": 8,
            "color": INK,
            "transform": axis.get_yaxis_transform(),
        }
        axis.text(0.025, row, shortened(one_line(name), LETTERS), **style)
        axis.text(1.0, row, f"{share:.0%}", ha="right", **style)
    if not shares:
        axis.text(0.025, 0, "none", va="center", fontsize=8, color=INK, transform=axis.get_yaxis_transform())
    axis.set_ylim(tall - 0.5, -0.5)


def _largest(weights: Mapping[str, float], most: int) -> dict[str, float]:
    """Shares of the weight in all, the largest first; ties in the order given."""
    total = sum(weights.values())
    order = sorted((name for name, weight in weights.items() if weight > 0), key=lambda name: -weights[name])
    return {name: weights[name] / total for name in order[:most]}
