"""Rows of pictures from runs, each framed in its macro-action's colour, captions round it."""

from collections.abc import Sequence
from dataclasses import dataclass
from textwrap import fill

import numpy as np
from jaxtyping import UInt8
from matplotlib.figure import Figure

from dpmacro.figures.style import GREYS, INK, macro_colour, one_line, set_title

ACROSS = 1.63  # inches, of a picture
BETWEEN = 0.1  # pictures
LEFT = 1.35  # room for a row's name
ABOVE, BELOW = 0.24, 0.3  # a row, for captions
TITLE = 0.4
LETTERS = 14  # in a line of a row's name
SMALL = 8


@dataclass(frozen=True)
class Still:
    """A picture of a run.

    Attributes:
        what, when: stand above it, left and right.
        state: stands below it.
        macro: macro-action that the frame is coloured by; grey where it is below 0.
    """

    view: UInt8[np.ndarray, "height width 3"]
    what: str
    when: str
    state: str
    macro: int


@dataclass(frozen=True)
class Strip:
    """A row: its name, what is written under that, and pictures from left to right."""

    name: str
    note: str
    stills: Sequence[Still]


def film_strips(strips: Sequence[Strip], title: str = "") -> Figure:
    """The rows below one another; all pictures have the width-to-height ratio of the first.

    Raises ValueError where there is no picture.
    """
    columns = max((len(strip.stills) for strip in strips), default=0)
    if columns == 0:
        raise ValueError(f"{len(strips)} rows without a picture: give one at least")
    shape = next(strip.stills[0].view.shape for strip in strips if strip.stills)
    tall = ACROSS * shape[0] / shape[1]
    row = ABOVE + tall + BELOW
    width = LEFT + columns * (ACROSS + BETWEEN)
    height = len(strips) * row + (TITLE if title else 0)
    figure = Figure(figsize=(width, height))
    for number, strip in enumerate(strips):
        bottom = (len(strips) - 1 - number) * row + BELOW
        _name(figure, strip, (bottom + tall) / height)
        for column, still in enumerate(strip.stills):
            left = LEFT + column * (ACROSS + BETWEEN)
            _draw(figure, still, (left / width, bottom / height, ACROSS / width, tall / height))
    if title:
        set_title(figure, title)
    return figure


def _name(figure: Figure, strip: Strip, top: float) -> None:
    """Name and note, hanging down from `top`, a share of the figure's height."""
    name = fill(strip.name, LETTERS)
    left = 0.1 / figure.get_figwidth()
    figure.text(left, top, name, va="top", fontsize=10, weight="bold", color=INK)
    lower = top - (0.19 * (name.count("\n") + 1) + 0.06) / figure.get_figheight()
    figure.text(left, lower, strip.note, va="top", fontsize=SMALL, color=INK, linespacing=1.5)


def _draw(figure: Figure, still: Still, place: tuple[float, float, float, float]) -> None:
    """One picture with its frame and captions; `place` is left, bottom, width, height in shares."""
    axis = figure.add_axes(place)
    axis.imshow(still.view, aspect="auto", interpolation="antialiased")
    axis.set(xticks=[], yticks=[])
    colour = GREYS[2] if still.macro < 0 else macro_colour(still.macro)
    axis.spines[:].set(color=colour, linewidth=4)
    axis.set_title(one_line(still.what), loc="left", fontsize=SMALL, pad=5, color=INK)
    axis.set_title(one_line(still.when), loc="right", fontsize=SMALL, pad=5, color=INK)
    axis.text(0, -0.05, still.state, transform=axis.transAxes, va="top", fontsize=SMALL, color=INK)
