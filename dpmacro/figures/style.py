"""Colours, legends and files that all pictures share, without matplotlib's global state."""

import io
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from jaxtyping import Float, UInt8
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.legend_handler import HandlerTuple
from matplotlib.patches import Patch
from matplotlib.text import Text

from dpmacro.utils.files import replacing

# Okabe and Ito's colours, distinct under the common kinds of colour blindness, then four that are darker or
# paler than those near them; truth stands in greys, neighbours far apart.
OKABE_ITO = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#56B4E9", "#D55E00", "#000000", "#F0E442")
PALETTE = (*OKABE_ITO, "#6A3D9A", "#8C510A", "#B5E2A8", "#7F1734")
GREYS = ("#D3D8DC", "#6B757E", "#A3ACB4", "#3D454C", "#BBC2C8", "#545D65", "#8A939B", "#20262B")
ACTIONS = ("#E8E4DA", "#56B4E9", "#D55E00", "#009E73", "#CC79A7", "#F0E442", "#0072B2", "#E69F00")
INK = "#222222"
FAINT = "#DDDDDD"
WIDTH = 12.0
DPI = 120
NAMED = 24  # colours that a legend names at most
LEGEND = 0.22  # inches, of a legend's line
SURE = "pale: unsure"
HANDLE, LETTER = 0.75, 0.085  # inches, of a legend's patch with its space, and of a letter


def macro_colour(macro: int) -> str:
    """Colour of a macro-action as "#rrggbb", the same in every picture and video."""
    return PALETTE[macro % len(PALETTE)]


def shortened(text: str, letters: int) -> str:
    """Text of at most so many letters: of a longer one the two ends."""
    if len(text) <= letters:
        return text
    end = (letters - 1) // 2
    return f"{text[: letters - 1 - end]}…{text[-end:]}"


def one_line(text: str) -> str:
    """A name in a line, a space in place of characters that cannot be seen."""
    return "".join(letter if letter.isprintable() else " " for letter in text)


@contextmanager
def surviving(name: str) -> Iterator[None]:
    """Whatever goes wrong with a picture in the block becomes a warning: what it shows is worth more.

    Ctrl-C passes.
    """
    try:
        yield
    except Exception as error:
        text = " ".join(str(error).split())
        told = f"{type(error).__name__}: {text}" if text else type(error).__name__
        warnings.warn(
            f"the picture {name} could not be made ({told}); nothing else depends on it", stacklevel=3
        )


def ink_on(shade: Sequence[float] | np.ndarray) -> str:
    """A colour that can be read on `shade`, RGB in 0..1."""
    return "white" if np.dot(shade, (0.3, 0.59, 0.11)) < 0.55 else INK


def faded(
    colours: Float[np.ndarray, "*shape 3"], confidence: Float[np.ndarray, "*shape"]
) -> Float[np.ndarray, "*shape 3"]:
    """RGB in 0..1, white where the confidence is 0 and as it was where that is 1."""
    return 1 - (1 - colours) * np.clip(confidence, 0, 1)[..., None]


def save(figure: Figure, path: Path) -> None:
    """Write `figure` in the format of the path's suffix (.png, .svg, .pdf), whole or not at all."""
    _as_written(figure)
    with replacing(path) as temporary:
        figure.savefig(temporary, dpi=DPI)


def to_png(figure: Figure) -> bytes:
    """The file that `save` writes to a .png."""
    _as_written(figure)
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=DPI)
    return buffer.getvalue()


def to_image(figure: Figure) -> UInt8[np.ndarray, "height width 3"]:
    """The figure's pixels, as TensorBoard's `add_image(..., dataformats="HWC")` takes them."""
    _as_written(figure)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3].copy()


def _as_written(figure: Figure) -> None:
    """Names are no formulas, whatever dollar signs they hold."""
    for text in figure.findobj(Text):
        text.set_parse_math(False)


def bare(axis: Axes) -> None:
    """Without frame, ticks and their labels."""
    axis.spines[:].set_visible(False)
    axis.tick_params(left=False, labelleft=False, bottom=False, labelbottom=False)


def plain(axis: Axes) -> None:
    """A chart's axes: a frame on two sides and horizontal lines."""
    axis.grid(axis="y", color=FAINT, linewidth=0.8)
    axis.set_axisbelow(True)
    axis.spines[["top", "right"]].set_visible(False)


def set_title(figure: Figure, title: str) -> None:
    """A title on the left above all."""
    figure.suptitle(one_line(title), x=0.01, ha="left", fontsize=13, weight="bold", color=INK)


def legend_height(names: Sequence[str], confidence: bool = False) -> float:
    """Inches that `legend` takes below a figure of the usual width."""
    texts = [*names[: NAMED + 1], *[SURE] * confidence]
    return LEGEND * -(-len(texts) // _columns(texts, WIDTH)) if texts else 0.0


def legend(figure: Figure, colours: Sequence[str], names: Sequence[str], confidence: bool = False) -> None:
    """What the colours mean, below all; where `confidence` shades them, what that means, too."""
    more = len(names) - NAMED
    handles: list = [Patch(color=colour) for colour in colours][:NAMED]
    texts = [one_line(name) for name in names[:NAMED]]
    if more > 0:
        handles.append(Patch(color="none"))
        texts.append(f"and {more} more")
    if confidence:
        grey = np.array(to_rgb(GREYS[5]))
        steps = (faded(grey, np.array(step)) for step in (1.0, 0.75, 0.5, 0.25, 0.0))
        handles.append(tuple(Patch(facecolor=step, edgecolor=FAINT, linewidth=0.5) for step in steps))
        texts.append(SURE)
    if not texts:
        return
    figure.legend(
        handles=handles,
        labels=texts,
        loc="outside lower center",
        ncols=_columns(texts, figure.get_figwidth()),
        frameon=False,
        handler_map={tuple: HandlerTuple(ndivide=None, pad=0)},
    )


def _columns(texts: Sequence[str], width: float) -> int:
    """Of a legend in a figure of this width, in inches."""
    longest = max(map(len, texts))
    return max(1, min(len(texts), 6, int(width / (HANDLE + LETTER * longest))))
