"""Segmentations, training curves, success rates, runs and what classifiers look at, as matplotlib figures."""

from dpmacro.figures.bars import column_bars
from dpmacro.figures.charts import (
    OUTCOME_COLOURS,
    curves,
    elbow,
    learning_curve,
    selection_chart,
    success_chart,
)
from dpmacro.figures.graphs import edge_counts, transition_graph
from dpmacro.figures.heatmaps import heat_maps
from dpmacro.figures.stills import Still, Strip, film_strips
from dpmacro.figures.strips import Line
from dpmacro.figures.style import macro_colour, save, surviving, to_image, to_png
from dpmacro.figures.timelines import timeline, timelines

__all__ = [
    "OUTCOME_COLOURS",
    "Line",
    "Still",
    "Strip",
    "column_bars",
    "curves",
    "edge_counts",
    "elbow",
    "film_strips",
    "heat_maps",
    "learning_curve",
    "macro_colour",
    "save",
    "selection_chart",
    "success_chart",
    "surviving",
    "timeline",
    "timelines",
    "to_image",
    "to_png",
    "transition_graph",
]
