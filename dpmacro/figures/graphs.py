"""The transition graph: which macro-action follows which, and how often."""

import itertools
from typing import Any

import numpy as np
from jaxtyping import Int
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.patches import Circle, FancyArrowPatch
from matplotlib.path import Path as Curve

from dpmacro.figures.style import INK, WIDTH, bare, ink_on, macro_colour, set_title

START, END = "start", "end"
TERMINAL = 0.1  # radius of start and end, where neighbours are 1 apart
UNIT = 1.7  # inches between neighbours at most
RISE = 0.85  # height of an arc's control point per unit of its width


def edge_counts(
    labels: Int[np.ndarray, " frames"], lengths: Int[np.ndarray, " trajectories"]
) -> dict[tuple[str, str], int]:
    """How often one macro-action, named by its number, follows another; "start" and "end" enclose each.

    Start and end have as many edges as there are trajectories.
    """
    counts: dict[tuple[str, str], int] = {}
    for part in np.split(labels, np.cumsum(lengths)[:-1]):
        stretches = part[np.flatnonzero(np.diff(part, prepend=part[0] - 1))]
        path = [START, *map(str, stretches.tolist()), END]
        for edge in itertools.pairwise(path):
            counts[edge] = counts.get(edge, 0) + 1
    return counts


def transition_graph(
    labels: Int[np.ndarray, " frames"], lengths: Int[np.ndarray, " trajectories"], title: str = ""
) -> Figure:
    """Macro-actions in the order in which they tend to come, arrows with the number of changes between them.

    A circle's size and percentage are the share of frames that the macro-action holds. Arrows forward run
    above, backward below; the wider, the more often.
    """
    places = _mean_places(labels, lengths)
    order = [START, *sorted(places, key=lambda name: places[name]), END]
    x_of = {name: float(x) for x, name in enumerate(order)}
    shares = {name: float(np.mean(labels == int(name))) for name in places}
    radius = {name: 0.27 + 0.13 * share**0.5 for name, share in shares.items()}
    radius |= {START: TERMINAL, END: TERMINAL}
    counts = edge_counts(labels, lengths)
    spans = [x_of[target] - x_of[source] for source, target in counts]
    top = max(0.55, RISE / 2 * max(spans) + 0.35)
    bottom = max(0.55, RISE / 2 * -min(spans) + 0.35)
    unit = min(WIDTH / (len(order) - 0.2), UNIT)
    figure = Figure(figsize=(unit * (len(order) - 0.2), unit * (top + bottom) + 0.45), layout="constrained")
    axis = figure.subplots()
    bare(axis)
    axis.set_aspect("equal")
    axis.set_xlim(-0.4, len(order) - 0.6)
    axis.set_ylim(-bottom, top)
    most = max(counts.values())
    for (source, target), count in counts.items():
        ends = (x_of[source], radius[source]), (x_of[target], radius[target])
        _arrow(axis, *ends, count, 0.8 + 3.2 * count / most)
    for name, share in shares.items():
        colour = macro_colour(int(name))
        axis.add_patch(Circle((x_of[name], 0), radius[name], color=colour, zorder=3))
        text = f"{name}\n{share:.0%}"
        ink = ink_on(to_rgb(colour))
        axis.text(x_of[name], 0, text, color=ink, ha="center", va="center", weight="bold", zorder=4)
    for name in (START, END):
        axis.add_patch(Circle((x_of[name], 0), TERMINAL, color=INK, zorder=3))
        axis.text(x_of[name], -TERMINAL - 0.08, name, color=INK, ha="center", va="top")
    set_title(figure, title)
    return figure


def _mean_places(
    labels: Int[np.ndarray, " frames"], lengths: Int[np.ndarray, " trajectories"]
) -> dict[str, float]:
    """Where in a trajectory, 0..1, the frames of each macro-action lie on average."""
    place = np.concatenate([np.linspace(0, 1, length) for length in lengths.tolist()])
    return {str(macro): float(place[labels == macro].mean()) for macro in np.unique(labels).tolist()}


def _arrow(
    axis: Axes, source: tuple[float, float], target: tuple[float, float], count: int, width: float
) -> None:
    """An arc from circle to circle, each (x, radius), with the count on its top; backward it hangs below."""
    (x0, r0), (x1, r1) = source, target
    side = 1 if x1 > x0 else -1
    lean = np.deg2rad(40)
    start = np.array([x0 + side * r0 * np.cos(lean), side * r0 * np.sin(lean)])
    end = np.array([x1 - side * r1 * np.cos(lean), side * r1 * np.sin(lean)])
    control = np.array([(start[0] + end[0]) / 2, RISE * (x1 - x0)])
    curve = Curve([start, control, end], [Curve.MOVETO, Curve.CURVE3, Curve.CURVE3])
    style: dict[str, Any] = {
        "arrowstyle": "-|>",
        "mutation_scale": 12,
        "linewidth": width,
        "color": "#8A939B",
        "zorder": 1,
    }
    axis.add_patch(FancyArrowPatch(path=curve, shrinkA=0, shrinkB=0, **style))
    middle = start / 4 + control / 2 + end / 4
    box = {"facecolor": "white", "edgecolor": "none", "pad": 1.5}
    axis.text(middle[0], middle[1], str(count), color=INK, ha="center", va="center", bbox=box, zorder=2)
