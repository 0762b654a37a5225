"""Stages of demonstrations: what is written into a dataset, shown on a page, and corrected by people."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int64

from dpmacro.metrics import segments
from dpmacro.utils.checks import as_count, as_kind, as_number, shown

__all__ = ["Stages"]

KINDS = {"labels": "iu", "confidence": "f", "idle": "b", "corrected": "b", "lengths": "iu", "timestamps": "f"}
WORDS = {"iu": "whole numbers", "f": "floating point numbers", "b": "true or false"}  # by numpy's kinds


@dataclass(frozen=True)
class Stages:
    """Macro-labels of whole demonstrations with their names.

    Attributes:
        labels: of every frame, 0..K-1; demonstrations one after another.
        confidence: 0..1, how sure of each label; 1 where a person said it.
        idle: whether nothing moves beyond its noise, for a second or more around the frame.
        corrected: whether a person said the label.
        names: of the K stages, distinct and not empty, a line each.
        lengths: frames of every demonstration, 1 or more.
        episodes: the dataset's numbers of the demonstrations.
        timestamps: seconds since the start of its demonstration, of every frame, as the dataset has them.
        fps: frames a second.

    Raises ValueError, one line that names the attribute, for anything else.
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

    def __post_init__(self) -> None:
        for name, kinds in KINDS.items():
            values = as_kind(name, getattr(self, name), np.ndarray, "an array")
            if values.dtype.kind not in kinds:
                raise ValueError(f"{name} are of type {values.dtype}: give {WORDS[kinds]}")
        for name in ("names", "episodes"):
            as_kind(name, getattr(self, name), tuple | list, "a tuple")
        for episode in self.episodes:
            as_count("episodes", episode, 0)
        as_number("fps", self.fps, above=0.0)
        self._check_names()
        self._check_demonstrations()
        self._check_frames()

    @property
    def trajectories(self) -> list[slice]:
        """The frames of each demonstration."""
        ends = np.cumsum(self.lengths).tolist()
        return [slice(end - length, end) for end, length in zip(ends, self.lengths.tolist(), strict=True)]

    @property
    def segments(self) -> list[list[list[int]]]:
        """Label, first frame and end (excluded) of every segment, in frames of its demonstration."""
        return [part.tolist() for part in segments(self.labels, self.lengths)]

    def of_episodes(self, episodes: tuple[int, ...]) -> "Stages":
        """The same in another order of demonstrations, or of some of them.

        Raises KeyError for an episode that has no labels.
        """
        parts = dict(zip(self.episodes, self.trajectories, strict=True))
        frames = np.concatenate([np.arange(parts[one].start, parts[one].stop) for one in episodes])
        return Stages(
            self.labels[frames],
            self.confidence[frames],
            self.idle[frames],
            self.corrected[frames],
            self.names,
            np.array([parts[one].stop - parts[one].start for one in episodes], np.int64),
            episodes,
            self.timestamps[frames],
            self.fps,
        )

    def _check_names(self) -> None:
        if not self.names:
            raise ValueError("names is (): give a name for every stage")
        for name in self.names:
            if not isinstance(name, str) or not name.strip() or not name.isprintable():
                raise ValueError(f"names hold {shown(name)}: give each stage a name of one line")
        if len(set(self.names)) < len(self.names):
            raise ValueError(f"names are {shown(self.names)}: give each stage a name of its own")

    def _check_demonstrations(self) -> None:
        if self.lengths.ndim != 1 or not len(self.lengths) or (self.lengths < 1).any():
            raise ValueError(
                f"lengths are {shown(self.lengths.tolist())}: give the frames of each, 1 or more"
            )
        if len(self.episodes) != len(self.lengths) or len(set(self.episodes)) < len(self.episodes):
            raise ValueError(
                f"episodes are {shown(self.episodes)}: give each of {len(self.lengths)} demonstrations a "
                "number of its own"
            )

    def _check_frames(self) -> None:
        n_frames = int(self.lengths.sum())
        for name in ("labels", "confidence", "idle", "corrected", "timestamps"):
            shape = getattr(self, name).shape
            if shape != (n_frames,):
                raise ValueError(
                    f"{name} have shape {list(shape)}, lengths add up to {n_frames}: give one a frame"
                )
        low, high = int(self.labels.min()), int(self.labels.max())
        if low < 0 or high >= len(self.names):
            raise ValueError(f"labels are {low} to {high}: give 0 to {len(self.names) - 1}, one a name")
        if not ((self.confidence >= 0) & (self.confidence <= 1)).all():
            raise ValueError("confidence is below 0, above 1 or no number in places: give numbers of 0 to 1")
        if not np.isfinite(self.timestamps).all():
            raise ValueError("timestamps are not finite in places: give seconds")
