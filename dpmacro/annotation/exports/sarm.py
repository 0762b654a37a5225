"""Stages as LeRobot's reward model SARM trains on them: columns of meta/episodes and the stages' shares."""

import json
from pathlib import Path

import numpy as np
import pyarrow as pa
from jaxtyping import Float64

from dpmacro.annotation.exports.base import Export, Labelled, Make
from dpmacro.annotation.exports.ordered import order_of, unordered

__all__ = ["HEADS", "Sarm", "progress", "shares"]

HEADS = ("sparse", "dense")  # SARM's two scales; both get the same stages, for its modes dense_only and dual
FIELDS = {
    "names": pa.string(),
    "start_times": pa.float64(),
    "end_times": pa.float64(),
    "start_frames": pa.int64(),
    "end_frames": pa.int64(),
}


class Sarm(Export):
    """Names, first and last frames (the last is included), and their times, of every episode's stages.

    `meta/temporal_proportions_{sparse,dense}.json` holds every stage's mean share of a demonstration, in the
    order of the stages.
    """

    name = "sarm"
    episode_columns = tuple(f"{head}_subtask_{field}" for head in HEADS for field in FIELDS)
    files = tuple(f"meta/temporal_proportions_{head}.json" for head in HEADS)

    def refusal(self) -> str | None:
        """SARM's progress would go backwards where a stage comes back."""
        return unordered(self.labelled)

    def of_episodes(self) -> dict[str, pa.Array]:
        """The columns of meta/episodes."""
        values: dict[str, list[list]] = {field: [] for field in FIELDS}
        for part, segments in zip(self.stages.trajectories, self.labelled.segments, strict=True):
            seconds = self.stages.timestamps[part].astype(np.float64)
            starts, ends = [start for _, start, _ in segments], [end - 1 for _, _, end in segments]
            values["names"].append([self.labelled.name(label) for label, _, _ in segments])
            values["start_times"].append(seconds[starts].tolist())
            values["end_times"].append(seconds[ends].tolist())
            values["start_frames"].append(starts)
            values["end_frames"].append(ends)
        return {
            f"{head}_subtask_{field}": pa.array(values[field], pa.list_(kind))
            for head in HEADS
            for field, kind in FIELDS.items()
        }

    def make(self) -> dict[str, Make]:
        """The stages' shares."""

        def write(path: Path) -> None:
            names = [self.labelled.name(label) for label in order_of(self.labelled)]
            content = dict(zip(names, shares(self.labelled).tolist(), strict=True))
            path.write_text(json.dumps(content, indent=2, ensure_ascii=False) + "\n", encoding="utf-8")

        return dict.fromkeys(self.files, write)


def shares(labelled: Labelled) -> Float64[np.ndarray, " stages"]:
    """Mean over demonstrations of each stage's share of the frames, of stages in order; they add up to 1."""
    of_each = [
        [(end - start) / length for _, start, end in segments]
        for segments, length in zip(labelled.segments, labelled.stages.lengths.tolist(), strict=True)
    ]
    return np.mean(of_each, axis=0)


def progress(labelled: Labelled) -> Float64[np.ndarray, " frames"]:
    """How much of the task is done at every frame, 0..1, never falling within a demonstration.

    With the shares a_k of stages and a stage k that goes from frame s_k to frame e_k (included), frame t has
    sum_{j<k} a_j + a_k (t - s_k) / (e_k - s_k), as SARM defines it; a stage of one frame is over there.
    """
    of_stage = shares(labelled)
    done = np.concatenate([[0.0], np.cumsum(of_stage)])
    pieces = [
        done[place] + of_stage[place] * _position(end - start)
        for segments in labelled.segments
        for place, (_, start, end) in enumerate(segments)
    ]
    return np.concatenate(pieces).clip(0, 1)


def _position(frames: int) -> Float64[np.ndarray, " frames"]:
    return np.linspace(0, 1, frames) if frames > 1 else np.ones(1)
