"""Weak learners behind one protocol: what a boosting round asks for, and what it gets back.

A round fits many independent problems at once (a problem is a macro-class, a restart's macro-class, a
switch function, a cross-validation fold). All problems share the frames; their weights differ.
"""

from typing import Protocol, runtime_checkable

import torch
from jaxtyping import Bool, Float, UInt8
from torch import Tensor


@runtime_checkable
class StrongClassifier(Protocol):
    """A sum of weak hypotheses for every problem, as fitted."""

    def select(self, problems: Tensor) -> "StrongClassifier":
        """The strong classifiers of just these problems, in this order."""
        ...

    def scaled(self, factor: float) -> "StrongClassifier":
        """Every hypothesis multiplied by `factor`: the shrinkage."""
        ...

    def scores(self, levels: UInt8[Tensor, "columns frames"]) -> Float[Tensor, "frames problems classes"]:
        """f^m(x) of every frame, problem and class."""
        ...


@runtime_checkable
class WeakLearner(Protocol):
    """Fits one weak hypothesis per problem to weighted frames, and applies it to them."""

    n_frames: int
    device: torch.device

    def fit(
        self,
        weights: Float[Tensor, "frames problems classes"],
        targets: Bool[Tensor, "frames #problems classes"],
        generator: torch.Generator,
    ) -> object:
        """One weak hypothesis for every problem, minimising the exponential loss of the weighted frames."""
        ...

    def outputs(self, hypotheses: object) -> Float[Tensor, "frames problems classes"]:
        """h^m(x) of the training frames."""
        ...

    def strong(self, rounds: list) -> StrongClassifier:
        """The sum of the rounds' hypotheses, to be applied to any frames."""
        ...
