"""Initial segmentations for DPBoost's restarts."""

from dpmacro.discovery.starts.chains import chained
from dpmacro.discovery.starts.classes import action_events, initial_segmentations
from dpmacro.discovery.starts.cuts import feature_peaks, random_cuts, uniform_cuts
from dpmacro.discovery.starts.evidence import Evidence, principal
from dpmacro.discovery.starts.linear import Moments, linear_alternation
from dpmacro.discovery.starts.vectors import vector_starts

__all__ = [
    "Evidence",
    "Moments",
    "action_events",
    "chained",
    "feature_peaks",
    "initial_segmentations",
    "linear_alternation",
    "principal",
    "random_cuts",
    "uniform_cuts",
    "vector_starts",
]
