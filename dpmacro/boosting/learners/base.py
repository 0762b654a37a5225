"""Weak learners behind one protocol: what a boosting round asks for, and what it gets back.

A round fits many independent problems at once (a problem is a macro-class, a restart's macro-class, a
switch function, a cross-validation fold). All problems share the frames; their weights differ.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol, TypeVar, runtime_checkable

import torch
from jaxtyping import Float, Int64, Shaped, UInt8
from torch import Tensor

from dpmacro.boosting.losses.base import Loss

__all__ = ["HEAVIEST", "Frames", "StrongClassifier", "WeakLearner", "overflow"]

HEAVIEST = 1e18  # sums of weights are multiplied by one another, in float32

Hypotheses = TypeVar("Hypotheses")
Memory = TypeVar("Memory")


@dataclass(frozen=True)
class Frames:
    """What weak hypotheses look at: stumps at quantised feature columns, convnets at pairs of images."""

    levels: UInt8[Tensor, "columns frames"]
    images: UInt8[Tensor, "frames height width 3"] | None = None
    previous: UInt8[Tensor, "frames height width 3"] | None = None  # the image before each


@runtime_checkable
class StrongClassifier(Protocol):
    """A sum of weak hypotheses for every problem, as fitted."""

    kind: str  # names its tensors in a file

    def select(self, problems: Int64[Tensor, " selected"]) -> "StrongClassifier":
        """The strong classifiers of just these problems, in this order."""
        ...

    def scores(self, frames: Frames) -> Float[Tensor, "frames problems classes"]:
        """f^m(x) of every frame, problem and class."""
        ...

    def used_columns(self) -> Int64[Tensor, " used"]:
        """The feature columns that the scores depend on, ascending."""
        ...

    def renumbered(self, columns: Int64[Tensor, " kept"]) -> "StrongClassifier":
        """The same classifiers for levels that hold only `columns` (ascending)."""
        ...

    def tensors(self) -> dict[str, Tensor]:
        """What defines the classifiers, for a file."""
        ...


@runtime_checkable
class WeakLearner(Protocol[Hypotheses, Memory]):
    """Fits one weak hypothesis per problem to weighted frames, and applies it to them."""

    @property
    def n_frames(self) -> int:
        """The number of training frames."""
        ...

    @property
    def device(self) -> torch.device:
        """Where the frames are."""
        ...

    def shown(
        self, strong: StrongClassifier, n_frames: int, size: int
    ) -> tuple[StrongClassifier, Iterator[Frames]]:
        """The classifiers, and the first training frames as they look at them, `size` at a time."""
        ...

    def fit(
        self,
        weights: Float[Tensor, "frames problems width"],
        responses: Shaped[Tensor, "frames #problems outputs"],
        generator: torch.Generator,
        memory: Memory | None = None,
        loss: Loss = ...,
    ) -> tuple[Hypotheses, Memory | None]:
        """One weak hypothesis for every problem, lowering the loss of the weighted frames.

        Weights and responses are those of `loss.working`; by default the loss is the exponential one. The
        second part of the result is the next round's `memory`, None in the first round: a learner keeps no
        state of its own. Raises ValueError where weights sum to `HEAVIEST` or to no number.
        """
        ...

    def outputs(self, hypotheses: Hypotheses) -> Float[Tensor, "frames problems classes"]:
        """h^m(x) of the training frames."""
        ...

    def strong(self, rounds: list[Hypotheses], steps: Float[Tensor, "rounds problems"]) -> StrongClassifier:
        """sum_t step_t h_t for every problem, to be applied to any frames."""
        ...


def overflow(weights: Float[Tensor, "frames problems width"]) -> str:
    """What to say of weights that sum to `HEAVIEST` or more, or to no number."""
    sums = weights.sum((0, 2))
    problem = int((~(sums < HEAVIEST)).nonzero()[0])
    return f"weights of problem {problem} sum to {float(sums[problem])}: scale them to less than {HEAVIEST:g}"
