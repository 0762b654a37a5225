"""The numbers of a policy's segmentation of demonstrations: segments, and scores beside those of chance."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from dpmacro.annotation.annotate import Annotation
from dpmacro.data.demonstrations import Demonstrations
from dpmacro.metrics import match_labels, random_cuts_like, segmentation_scores, segments, uniform_cuts
from dpmacro.policy.policy import MacroPolicy

__all__ = ["SCORES", "Summary"]

DRAWS = 20  # of random cuts, whose scores are averaged
SCORES = {  # names of `SegmentationScores` for people
    "accuracy": "frames that agree",
    "edit": "edit score",
    "f1_10": "segment F1, 10% overlap",
    "f1_25": "segment F1, 25% overlap",
    "f1_50": "segment F1, 50% overlap",
    "precision": "change points, precision",
    "recall": "change points, recall",
    "boundary_f1": "change points, F1",
    "nmi": "mutual information (NMI)",
    "ari": "Rand index (ARI)",
    "segments": "segments",
    "true_segments": "true segments",
}


@dataclass(frozen=True)
class Summary:
    """A policy's segmentation of demonstrations.

    Attributes:
        policy: what segmented them.
        demonstrations: what was segmented.
        annotation: macro-labels, their confidence, and the cost under every bound.
        episodes: the demonstrations' numbers in their dataset.
        sources: where the dataset and the policy are.
        tolerance: frames by which a found change point may miss a true one.
        seed: of the random cuts.
    """

    policy: MacroPolicy
    demonstrations: Demonstrations
    annotation: Annotation
    episodes: tuple[int, ...]
    sources: dict[str, str]
    tolerance: int = 10
    seed: int = 0

    @property
    def lengths(self) -> Int[np.ndarray, " trajectories"]:
        """Frames of every demonstration."""
        return self.demonstrations.lengths

    @cached_property
    def labels(self) -> Int[np.ndarray, " frames"]:
        """Macro-action of every frame."""
        return self.annotation.labels.numpy()

    @cached_property
    def frame_confidence(self) -> Float[np.ndarray, " frames"]:
        """The confidence in every frame's label, 0..1, as `annotate` defines it."""
        return self.annotation.confidence.numpy()

    @cached_property
    def segments(self) -> list[list[list[int]]]:
        """Macro-action, first frame and end (excluded) of the segments of every demonstration."""
        return [part.tolist() for part in segments(self.labels, self.lengths)]

    @cached_property
    def cost_by_bound(self) -> Float[np.ndarray, " bounds"]:
        """Cost per frame of the best segmentation with at most s = 0..S transitions in a demonstration."""
        return self.annotation.cost_by_bound.sum(0).numpy() / len(self.labels)

    @cached_property
    def scores(self) -> dict[str, dict[str, float]]:
        """Method -> score -> value: the policy's, uniform cuts', random cuts' mean; {} without truth."""
        truth = self.demonstrations.truth
        if truth is None:
            return {}
        generator = np.random.default_rng(self.seed)
        labellings = {
            "policy": [self.labels],
            "uniform cuts": [uniform_cuts(truth, self.lengths)],
            "random cuts": [random_cuts_like(truth, self.lengths, generator) for _ in range(DRAWS)],
        }
        result = {}
        for method, drawn in labellings.items():
            scored = [
                asdict(segmentation_scores(labels, truth, self.lengths, self.tolerance)) for labels in drawn
            ]
            result[method] = {name: float(np.mean([one[name] for one in scored])) for name in SCORES}
        return result

    @cached_property
    def agreement(self) -> list[float] | None:
        """Share of each demonstration's frames that agree with the truth, labels matched over all."""
        truth, labels = self.demonstrations.truth, self.labels
        if truth is None:
            return None
        truth_of = match_labels(labels, truth).truth_of
        agrees = np.zeros(len(labels), bool)
        for label, true in truth_of.items():
            agrees |= (labels == label) & (truth == true)
        return [float(agrees[part].mean()) for part in self.demonstrations.trajectories]

    @cached_property
    def confidence(self) -> list[float]:
        """Mean confidence of every demonstration's frames, 0..1."""
        return [float(self.frame_confidence[part].mean()) for part in self.demonstrations.trajectories]

    @cached_property
    def macros(self) -> list[dict[str, Any]]:
        """For every macro-action its share of frames, segments, confidence and the share of each action."""
        names = self.demonstrations.action_names
        result = []
        for macro in range(self.policy.config.macros):
            held = self.labels == macro
            n_segments = sum(found == macro for part in self.segments for found, _, _ in part)
            counts = np.bincount(self.demonstrations.actions[held], minlength=len(names))
            shares = counts / max(int(held.sum()), 1)
            result.append(
                {
                    "macro": macro,
                    "share": float(held.mean()),
                    "segments": n_segments,
                    "frames_per_segment": float(held.sum() / n_segments) if n_segments else 0.0,
                    "confidence": float(self.frame_confidence[held].mean()) if n_segments else 0.0,
                    "actions": dict(zip(names, shares.tolist(), strict=True)),
                }
            )
        return result

    def as_json(self) -> dict[str, Any]:
        """Return all of it in the form of segmentation.json."""
        agreement: Sequence[float | None] = self.agreement or [None] * len(self.episodes)
        rows = zip(
            self.episodes, self.lengths.tolist(), self.segments, self.confidence, agreement, strict=True
        )
        names = ("episode", "frames", "segments", "confidence", "agreement")
        return {
            **self.sources,
            "truth": self.demonstrations.truth_name,
            "tolerance": self.tolerance,
            "scores": self.scores,
            "macros": self.macros,
            "cost_per_frame_by_bound": self.cost_by_bound.tolist(),
            "demonstrations": [dict(zip(names, row, strict=True)) for row in rows],
        }
