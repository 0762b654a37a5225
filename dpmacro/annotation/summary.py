"""The numbers of a policy's segmentation of demonstrations: segments, and scores beside those of chance."""

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from dpmacro.annotation.annotate import Annotation
from dpmacro.annotation.dimensions import action_lines, standardised
from dpmacro.data.demonstrations import Demonstrations
from dpmacro.figures import Line
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
    def action_lines(self) -> list[Line]:
        """The dimensions of vectors that are worth drawing, of all frames; [] for classes."""
        return action_lines(self.demonstrations, self.labels) if self.demonstrations.vector else []

    @cached_property
    def macros(self) -> list[dict[str, Any]]:
        """For every macro-action its share of frames, segments, confidence, and what its actions are.

        `actions` holds the share of each class by its name. For vectors `dimensions` lists the name and the
        mean of each, and by how many standard deviations that is off the mean of all frames; it is empty
        where the macro-action has no frame.
        """
        result = []
        told = self._dimensions() if self.demonstrations.vector else self._classes()
        for macro, actions in enumerate(told):
            held = self.labels == macro
            n_segments = sum(found == macro for part in self.segments for found, _, _ in part)
            result.append(
                {
                    "macro": macro,
                    "share": float(held.mean()),
                    "segments": n_segments,
                    "frames_per_segment": float(held.sum() / n_segments) if n_segments else 0.0,
                    "confidence": float(self.frame_confidence[held].mean()) if n_segments else 0.0,
                    **actions,
                }
            )
        return result

    @property
    def _held(self) -> Iterator[Bool[np.ndarray, " frames"]]:
        """The frames of every macro-action."""
        return (self.labels == macro for macro in range(self.policy.config.macros))

    def _classes(self) -> Iterator[dict[str, Any]]:
        names, actions = self.demonstrations.action_names, self.demonstrations.actions
        for held in self._held:
            shares = np.bincount(actions[held], minlength=len(names)) / max(int(held.sum()), 1)
            yield {"actions": dict(zip(names, shares.tolist(), strict=True))}

    def _dimensions(self) -> Iterator[dict[str, Any]]:
        names, actions = self.demonstrations.action_names, self.demonstrations.actions
        off = standardised(actions)
        for held in self._held:
            means = [
                values[held].mean(0, dtype=np.float64).tolist() for values in (actions, off) if held.any()
            ]
            rows = zip(names, *means, strict=True) if means else ()
            keys = ("name", "mean", "deviations")
            yield {"dimensions": [dict(zip(keys, row, strict=True)) for row in rows]}

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
