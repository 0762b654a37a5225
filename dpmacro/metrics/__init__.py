"""Labels against truth: plain functions on numpy arrays.

Labels and truth are any integers, one per frame, trajectories concatenated; `lengths` says where each ends.
No score depends on what the integers are, only on which frames share one.
"""

from dpmacro.metrics.boundaries import Boundaries, boundary_counts, boundary_scores, matched_boundaries
from dpmacro.metrics.chance import random_cuts_like, uniform_cuts
from dpmacro.metrics.frames import (
    Matching,
    adjusted_rand_index,
    frame_accuracy,
    match_labels,
    normalized_mutual_information,
)
from dpmacro.metrics.scores import SegmentationScores, segmentation_scores
from dpmacro.metrics.segments import edit_score, overlap_f1, segments, transitions

__all__ = [
    "Boundaries",
    "Matching",
    "SegmentationScores",
    "adjusted_rand_index",
    "boundary_counts",
    "boundary_scores",
    "edit_score",
    "frame_accuracy",
    "match_labels",
    "matched_boundaries",
    "normalized_mutual_information",
    "overlap_f1",
    "random_cuts_like",
    "segmentation_scores",
    "segments",
    "transitions",
    "uniform_cuts",
]
