"""The protocol of losses: one for every kind of action.

A loss says what a frame costs under scores, which is what the segmentation pays; what a weak hypothesis is
chosen by, as sums of one row a frame; and what left-out frames are charged, in nats.
"""

from typing import Protocol, runtime_checkable

from jaxtyping import Float
from torch import Tensor

__all__ = ["Loss"]


@runtime_checkable
class Loss(Protocol):
    """What a strong learner minimises, and what is charged for its scores.

    Attributes:
        outputs: scores that a problem has of a frame: classes, or dimensions of a vector.
    """

    @property
    def outputs(self) -> int: ...

    @property
    def signed(self) -> bool:
        """Whether rows of the table may be negative."""
        ...

    def targets(self, actions: Tensor) -> Tensor:
        """Of shape [frames, 1, outputs]: what the scores of every problem are to come near to."""
        ...

    def terms(
        self, scores: Float[Tensor, "frames problems outputs"], targets: Tensor
    ) -> Float[Tensor, "frames problems outputs"]:
        """What every output of a frame costs; their sum is the frame's cost c_n(q)."""
        ...

    def working(
        self,
        terms: Float[Tensor, "frames problems outputs"],
        scores: Float[Tensor, "frames problems outputs"],
        targets: Tensor,
        base: Float[Tensor, "frames problems"],
    ) -> tuple[Tensor, Tensor]:
        """Weights and responses that a weak hypothesis is fitted to (Friedman, Hastie, Tibshirani 2000)."""
        ...

    def table(self, weights: Tensor, responses: Tensor) -> Float[Tensor, "frames rows columns problems"]:
        """What is summed over frames to judge a threshold, a row for every frame."""
        ...

    def split(
        self,
        below: Float[Tensor, "columns bins rows columns problems"],
        slack: Float[Tensor, " problems"],
    ) -> Float[Tensor, "columns bins problems"]:
        """What a threshold leaves of the loss, but for a constant, from the sums of rows up to it."""
        ...

    def votes(
        self, sides: Float[Tensor, "problems 2 rows columns"], slack: Float[Tensor, " problems"]
    ) -> Float[Tensor, "problems 2 outputs"]:
        """The best votes below and above a threshold, from the sums [below, in all]."""
        ...

    def remaining(self, weights: Tensor, responses: Tensor, votes: Tensor) -> Tensor:
        """Of shape [frames, outputs]: what one problem's votes leave of its weighted loss."""
        ...

    def charge(
        self,
        scores: Float[Tensor, "frames problems outputs"],
        targets: Tensor,
        limit: float,
        scale: Float[Tensor, " outputs"],
    ) -> Float[Tensor, "frames problems"]:
        """Bounded charges of left-out frames, in nats; a larger `limit` bounds them later."""
        ...

    def scale(self, scores: Float[Tensor, "frames outputs"], actions: Tensor) -> Float[Tensor, " outputs"]:
        """The deviation of left-out residuals of every output, which `charge` measures in."""
        ...

    def per_nat(self, scale: Float[Tensor, " outputs"]) -> float:
        """How much of the training loss is one nat of what `charge` charges."""
        ...

    def error(self, scores: Float[Tensor, "frames outputs"], actions: Tensor) -> float:
        """Share, 0 to 1, of the actions that are wrong, or of their variance that is not explained."""
        ...
