"""Where the classifiers look: weights of pixels over the mean image of every macro-action."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, UInt8
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import PowerNorm
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine

from dpmacro.figures.style import INK, bare, macro_colour, one_line, set_title

HEAT = colormaps["YlOrRd"]  # what it lies on is grey
STEEP = 0.5  # power of the scale: a few pixels hold most of the weight
ACROSS = 4  # macro-actions side by side
SIDE = 2.8  # inches, of a picture's width


def heat_maps(
    means: UInt8[np.ndarray, "macros height width 3"],
    weights: Float[np.ndarray, "macros height width"],
    names: Sequence[str] = (),
    title: str = "",
) -> Figure:
    """For every macro-action its mean image and, below, that image in grey under the heat of its pixels.

    Heat is a pixel's weight, 0 or more, over the mean weight of the macro-action's pixels, on one scale for
    all; pixels without weight show the image. `names` stand above the images, by default the numbers.
    """
    n_macros, height, width = weights.shape
    mean = weights.mean((1, 2), keepdims=True)
    heat = np.divide(weights, mean, out=np.zeros(weights.shape), where=mean > 0)
    norm = PowerNorm(STEEP, 0, max(float(heat.max()), 1.0))
    across = min(n_macros, ACROSS)
    rows = -(-n_macros // across)
    tall = SIDE * height / width
    size = (max(across * (SIDE + 0.15) + 1.1, 6.5), rows * (2 * tall + 0.55) + 0.5)
    figure = Figure(figsize=size, layout=ConstrainedLayoutEngine(w_pad=0.06, h_pad=0.04, hspace=0.01))
    axes = figure.subplots(2 * rows, across, squeeze=False)
    for axis in axes.ravel():
        bare(axis)
    for macro in range(n_macros):
        row, column = 2 * (macro // across), macro % across
        axes[row, column].imshow(means[macro], interpolation="nearest")
        _heat(axes[row + 1, column], means[macro], norm(heat[macro]))
        name = names[macro] if macro < len(names) else f"macro-action {macro}"
        axes[row, column].set_title(one_line(name), fontsize=10, loc="left", color=INK)
        for axis in axes[row : row + 2, column]:
            axis.spines["left"].set(visible=True, color=macro_colour(macro), linewidth=5)
    for axis in axes.reshape(rows, 2, across).swapaxes(1, 2).reshape(-1, 2)[n_macros:].ravel():
        axis.set_visible(False)
    bar = figure.colorbar(ScalarMappable(norm, HEAT), ax=axes, fraction=0.03, pad=0.02, shrink=0.8)
    bar.set_label("weight of a pixel / mean of all pixels", color=INK)
    bar.outline.set_visible(False)
    set_title(figure, title)
    return figure


def _heat(
    axis: Axes, image: UInt8[np.ndarray, "height width 3"], heat: Float[np.ndarray, "height width"]
) -> None:
    """Heat in 0..1 over the image in grey, the more opaque the hotter."""
    axis.imshow(image @ (0.3, 0.59, 0.11), cmap="gray", vmin=0, vmax=255, interpolation="nearest")
    colours = HEAT(np.asarray(heat))
    colours[..., 3] = heat
    axis.imshow(colours, interpolation="nearest")
