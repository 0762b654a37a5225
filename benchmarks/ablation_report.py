"""The ablation as markdown and as a dot plot."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure
from report import markdown
from table_rows import Row

from dpmacro.figures.style import INK, WIDTH, plain

__all__ = ["ALL", "NONE", "Difference", "differences", "dots", "table"]

ALL, NONE = "all", "none"


@dataclass(frozen=True)
class Difference:
    """A variant less all additions together on a source, points, with a 95% interval where there is one."""

    variant: str
    source: str
    mean: float
    half: float  # of the interval; NaN where there is a single pair


def differences(rows: Sequence[Row]) -> list[Difference]:
    """Paired differences of every variant to all additions, normal intervals over the pairs."""
    by = {(row["source"], row["variant"], row["train_seed"]): row["values"] for row in rows}
    found = []
    for source in dict.fromkeys(row["source"] for row in rows):
        for variant in dict.fromkeys(row["variant"] for row in rows if row["source"] == source):
            pairs = [
                100 * (one - other)
                for (where, what, seed), own in by.items()
                if (where, what) == (source, variant) and (source, ALL, seed) in by
                for one, other in zip(own, by[source, ALL, seed], strict=True)
            ]
            if pairs and variant != ALL:
                error = np.std(pairs, ddof=1) / len(pairs) ** 0.5 if len(pairs) > 1 else np.nan
                found.append(Difference(variant, source, float(np.mean(pairs)), float(1.96 * error)))
    return found


def table(rows: Sequence[Row]) -> list[str]:
    """A line for every variant, a column for every source: means, and differences to all additions."""
    sources = list(dict.fromkeys(row["source"] for row in rows))
    told = {(one.variant, one.source): one for one in differences(rows)}
    lines = []
    for variant in dict.fromkeys(row["variant"] for row in rows):
        cells = []
        for source in sources:
            own = [
                value
                for row in rows
                if (row["source"], row["variant"]) == (source, variant)
                for value in row["values"]
            ]
            one = told.get((variant, source))
            beside = "" if one is None else f" ({one.mean:+.1f}, +-{one.half:.1f})"
            cells.append(f"{100 * np.mean(own):.1f}{beside}" if own else "")
        lines.append([variant, *cells])
    return markdown(["%", *sources], lines)


def dots(rows: Sequence[Row]) -> Figure:
    """The differences as dots with their intervals, a panel for every source."""
    told = differences(rows)
    names, sources = (
        list(dict.fromkeys(one.variant for one in told)),
        list(dict.fromkeys(one.source for one in told)),
    )
    figure = Figure(figsize=(WIDTH, 1.2 + 0.24 * len(names)), layout="constrained")
    axes = figure.subplots(1, len(sources), squeeze=False, sharey=True)[0]
    for axis, source in zip(axes, sources, strict=True):
        own = [one for one in told if one.source == source]
        places = [names.index(one.variant) for one in own]
        half = np.nan_to_num([one.half for one in own])
        axis.axvline(0, color="#999999", linewidth=0.8)
        axis.errorbar([one.mean for one in own], places, xerr=half, fmt="o", color=INK, markersize=4)
        axis.set_title(source, fontsize="medium")
        axis.set_yticks(range(len(names)), names)
        plain(axis)
    axes[0].invert_yaxis()
    figure.supxlabel("points more than with all additions, 95% interval")
    return figure
