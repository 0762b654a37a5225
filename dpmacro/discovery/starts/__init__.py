"""Initial segmentations for DPBoost's restarts."""

from dpmacro.discovery.starts.chains import chained
from dpmacro.discovery.starts.classes import action_events, initial_segmentations
from dpmacro.discovery.starts.clusters import window_clusters
from dpmacro.discovery.starts.cuts import feature_peaks, random_cuts, uniform_cuts
from dpmacro.discovery.starts.evidence import Evidence
from dpmacro.discovery.starts.linear import Moments, linear_alternation
from dpmacro.discovery.starts.vectors import KINDS, evidence_of, vector_starts

__all__ = [
    "KINDS",
    "Evidence",
    "Moments",
    "action_events",
    "chained",
    "evidence_of",
    "feature_peaks",
    "initial_segmentations",
    "linear_alternation",
    "random_cuts",
    "uniform_cuts",
    "vector_starts",
    "window_clusters",
]
