"""Weak learners behind one protocol: what a boosting round asks for, and what it gets back.

A round fits many independent problems at once (a problem is a macro-class, a restart's macro-class, a
switch function, a cross-validation fold). All problems share the frames; their weights differ.
"""

from typing import Protocol, TypeVar, runtime_checkable

import torch
from jaxtyping import Bool, Float, Int64, UInt8
from torch import Tensor

Hypotheses = TypeVar("Hypotheses")


@runtime_checkable
class StrongClassifier(Protocol):
    """A sum of weak hypotheses for every problem, as fitted."""

    def select(self, problems: Int64[Tensor, " selected"]) -> "StrongClassifier":
        """The strong classifiers of just these problems, in this order."""
        ...

    def scaled(self, factor: float) -> "StrongClassifier":
        """Every hypothesis multiplied by `factor`: the shrinkage."""
        ...

    def scores(self, levels: UInt8[Tensor, "columns frames"]) -> Float[Tensor, "frames problems classes"]:
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
class WeakLearner(Protocol[Hypotheses]):
    """Fits one weak hypothesis per problem to weighted frames, and applies it to them."""

    @property
    def n_frames(self) -> int:
        """The number of training frames."""
        ...

    @property
    def device(self) -> torch.device:
        """Where the frames are."""
        ...

    def fit(
        self,
        weights: Float[Tensor, "frames problems classes"],
        targets: Bool[Tensor, "frames #problems classes"],
        generator: torch.Generator,
    ) -> Hypotheses:
        """One weak hypothesis for every problem, minimising the exponential loss of the weighted frames."""
        ...

    def outputs(self, hypotheses: Hypotheses) -> Float[Tensor, "frames problems classes"]:
        """h^m(x) of the training frames."""
        ...

    def strong(self, rounds: list[Hypotheses]) -> StrongClassifier:
        """The sum of the rounds' hypotheses, to be applied to any frames."""
        ...
