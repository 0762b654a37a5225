"""Stages of demonstrations: what is written into a dataset, shown on a page, and corrected by people."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int64

__all__ = ["Stages"]


@dataclass(frozen=True)
class Stages:
    """Macro-labels of whole demonstrations with their names.

    Attributes:
        labels: of every frame, 0..K-1; demonstrations one after another.
        confidence: 0..1, how sure of each label; 1 where a person said it.
        idle: whether nothing moves beyond its noise, for a second or more around the frame.
        corrected: whether a person said the label.
        names: of the K stages, distinct and not empty.
        lengths: frames of every demonstration.
        episodes: the dataset's numbers of the demonstrations.
        timestamps: seconds since the start of its demonstration, of every frame, as the dataset has them.
        fps: frames a second.
    """

    labels: Int64[np.ndarray, " frames"]
    confidence: Float[np.ndarray, " frames"]
    idle: Bool[np.ndarray, " frames"]
    corrected: Bool[np.ndarray, " frames"]
    names: tuple[str, ...]
    lengths: Int64[np.ndarray, " demonstrations"]
    episodes: tuple[int, ...]
    timestamps: Float[np.ndarray, " frames"]
    fps: float
