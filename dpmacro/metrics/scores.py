"""All that is to be said of a segmentation where the true one is known."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Int

from dpmacro.metrics.boundaries import boundary_scores
from dpmacro.metrics.frames import (
    adjusted_rand_index,
    frame_accuracy,
    named_after_truth,
    normalized_mutual_information,
)
from dpmacro.metrics.segments import edit_score, overlap_f1, segments


@dataclass(frozen=True)
class SegmentationScores:
    """A segmentation against the true one; every score in 0..1 but `ari`, and 1 the best.

    Attributes:
        accuracy: share of frames that agree, labels matched to classes over the whole dataset.
        edit: `edit_score` of segments under that matching, mean over trajectories.
        f1_10, f1_25, f1_50: `overlap_f1` under that matching, at an overlap of 10, 25 and 50%.
        precision, recall, boundary_f1: change points within the tolerance, see `boundary_scores`.
        nmi: mutual information of frames' labels and classes, see `normalized_mutual_information`.
        ari: `adjusted_rand_index` of frames, -0.5..1, 0 expected by chance.
        segments, true_segments: how many there are, all trajectories together.
    """

    accuracy: float
    edit: float
    f1_10: float
    f1_25: float
    f1_50: float
    precision: float
    recall: float
    boundary_f1: float
    nmi: float
    ari: float
    segments: int
    true_segments: int


def segmentation_scores(
    labels: Int[np.ndarray, " frames"],
    truth: Int[np.ndarray, " _frames"],
    lengths: Int[np.ndarray, " trajectories"],
    tolerance: int = 10,
) -> SegmentationScores:
    """Every score of labels against truth; change points count within `tolerance` frames, inclusive.

    Raises:
        ValueError: no frames, not one label per true one, lengths that do not add up, a wrong tolerance.
    """
    named, classes = named_after_truth(labels, truth)
    precision, recall, boundary_f1 = boundary_scores(labels, truth, lengths, tolerance)
    return SegmentationScores(
        accuracy=frame_accuracy(labels, truth),
        edit=edit_score(named, classes, lengths),
        f1_10=overlap_f1(named, classes, lengths, 0.1),
        f1_25=overlap_f1(named, classes, lengths, 0.25),
        f1_50=overlap_f1(named, classes, lengths, 0.5),
        precision=precision,
        recall=recall,
        boundary_f1=boundary_f1,
        nmi=normalized_mutual_information(labels, truth),
        ari=adjusted_rand_index(labels, truth),
        segments=sum(map(len, segments(labels, lengths))),
        true_segments=sum(map(len, segments(truth, lengths))),
    )
