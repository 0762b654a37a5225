"""Weak learners of different kinds in one strong classifier: first one boosts, then the other."""

from dataclasses import dataclass
from typing import Any

import torch
from jaxtyping import Bool, Float, Int64
from torch import Tensor

from dpmacro.boosting.learners.base import Frames, StrongClassifier, WeakLearner
from dpmacro.boosting.learners.convnet import ConvNetClassifier
from dpmacro.boosting.learners.stumps import StumpClassifier

__all__ = ["Ensemble", "InTurn", "classifier_from", "classifier_tensors"]

KINDS: dict[str, type] = {kind.kind: kind for kind in (StumpClassifier, ConvNetClassifier)}


@dataclass(frozen=True)
class Ensemble:
    """The sum of strong classifiers of different kinds, problem by problem."""

    parts: tuple[StrongClassifier, ...]
    kind = "ensemble"

    def select(self, problems: Int64[Tensor, " selected"]) -> "Ensemble":
        """The strong classifiers of just these problems, in this order."""
        return Ensemble(tuple(part.select(problems) for part in self.parts))

    def scores(self, frames: Frames) -> Float[Tensor, "frames problems classes"]:
        """f^m(x) of every frame, problem and class."""
        return torch.stack([part.scores(frames) for part in self.parts]).sum(0)

    def used_columns(self) -> Int64[Tensor, " used"]:
        """The columns that any part looks at, ascending."""
        return torch.cat([part.used_columns() for part in self.parts]).unique()

    def renumbered(self, columns: Int64[Tensor, " kept"]) -> "Ensemble":
        """The same classifiers for levels that hold only `columns` (ascending)."""
        return Ensemble(tuple(part.renumbered(columns) for part in self.parts))

    def tensors(self) -> dict[str, Tensor]:
        """What defines the parts, named <place>.<kind>.<name>."""
        return {
            f"{place}.{part.kind}.{name}": value
            for place, part in enumerate(self.parts)
            for name, value in part.tensors().items()
        }


@dataclass(frozen=True)
class _Turn:
    number: int  # rounds that this learner has had
    then: bool  # whether it is the second learner
    memory: Any


@dataclass(frozen=True)
class InTurn:
    """`first` finds the weak hypotheses of the first `rounds` rounds, `then` all others.

    Problems that end while `first` has its turn have ended for `then`, too.

    Both hold the same frames. A hypothesis is a pair: whether it is the second learner's, and what it is.
    """

    first: WeakLearner
    rounds: int
    then: WeakLearner

    def __post_init__(self) -> None:
        if self.first.n_frames != self.then.n_frames:
            raise ValueError(
                f"the learners hold {self.first.n_frames} and {self.then.n_frames} frames: give the same ones"
            )
        if self.rounds < 1:
            raise ValueError(f"rounds of the first learner is {self.rounds}: give 1 or more")

    @property
    def n_frames(self) -> int:
        """The number of training frames."""
        return self.first.n_frames

    @property
    def device(self) -> torch.device:
        """Where the frames are."""
        return self.first.device

    def fit(
        self,
        weights: Float[Tensor, "frames problems classes"],
        targets: Bool[Tensor, "frames #problems classes"],
        generator: torch.Generator,
        memory: _Turn | None = None,
    ) -> tuple[tuple[bool, Any], _Turn]:
        """One weak hypothesis for every problem by the learner whose turn it is."""
        turn = memory or _Turn(0, False, None)
        if not turn.then and turn.number == self.rounds:
            turn = _Turn(0, True, None)
        learner = self.then if turn.then else self.first
        found, learner_memory = learner.fit(weights, targets, generator, turn.memory)
        return (turn.then, found), _Turn(turn.number + 1, turn.then, learner_memory)

    def outputs(self, hypotheses: tuple[bool, Any]) -> Float[Tensor, "frames problems classes"]:
        """h^m(x) of the training frames."""
        then, found = hypotheses
        return (self.then if then else self.first).outputs(found)

    def strong(
        self, rounds: list[tuple[bool, Any]], steps: Float[Tensor, "rounds problems"]
    ) -> StrongClassifier:
        """sum_t step_t h_t: the first learner's alone where the second had no turn."""
        by_first = sum(not then for then, _ in rounds)
        found = [part for _, part in rounds]
        first = self.first.strong(found[:by_first], steps[:by_first])
        if by_first == len(rounds):
            return first
        return Ensemble((first, self.then.strong(found[by_first:], steps[by_first:])))


def classifier_tensors(classifier: StrongClassifier) -> dict[str, Tensor]:
    """What defines a strong classifier, every tensor named <place>.<kind>.<name>."""
    parts = classifier.parts if isinstance(classifier, Ensemble) else (classifier,)
    return Ensemble(parts).tensors()


def classifier_from(tensors: dict[str, Tensor]) -> StrongClassifier:
    """The strong classifier that `classifier_tensors` described. Raises KeyError for an unknown kind."""
    groups: dict[str, dict[str, Tensor]] = {}
    for name, tensor in tensors.items():
        part, _, field_name = name.rpartition(".")
        groups.setdefault(part, {})[field_name] = tensor
    parts = tuple(KINDS[part.partition(".")[2]](**group) for part, group in sorted(groups.items()))
    return parts[0] if len(parts) == 1 else Ensemble(parts)
