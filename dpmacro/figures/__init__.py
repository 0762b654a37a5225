"""Segmentations, training curves, success rates and what classifiers look at, as matplotlib figures."""

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
from dpmacro.figures.style import macro_colour, save, to_image, to_png
from dpmacro.figures.timelines import timeline, timelines

__all__ = [
    "OUTCOME_COLOURS",
    "curves",
    "edge_counts",
    "elbow",
    "heat_maps",
    "learning_curve",
    "macro_colour",
    "save",
    "selection_chart",
    "success_chart",
    "timeline",
    "timelines",
    "to_image",
    "to_png",
    "transition_graph",
]
