"""The one boosting loop: strong classifiers grown a round at a time, many problems side by side.

AdaBoost.MH (Schapire and Singer 1999): for every problem p the strong classifier
f_p^m(x) = sum_t h_{p,t}^m(x) lowers sum_n d_{n,p} sum_m exp(-y_{n,p}^m f_p^m(x_n)), where d is the frame's
base weight in the problem.
The macro-classes of DPBoost, the baseline and the switch functions are all problems of this kind.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int64
from torch import Tensor

from dpmacro.learners import StrongClassifier, WeakLearner

__all__ = ["MARGIN_LIMIT", "Boosting", "Round", "class_targets"]

MARGIN_LIMIT = 18.0  # exp(18) = 6.6e7: prefix sums of such costs keep 1e-5 in float64


@dataclass(frozen=True)
class Round:
    """What a boosting round reports to whoever watches."""

    stage: str  # discover | judge | recognise | fit | switch
    number: int  # from 1
    total: int
    loss: float  # exponential loss per frame; of the best restart while discovering
    accuracy: float  # share of training frames whose class is right, likewise
    labels: (
        Int64[Tensor, " frames"] | None
    )  # macro-labels, likewise; None where there is not one segmentation
    label_changes: float = 0.0  # share of frames whose macro-label this round changed


class Boosting:
    """Strong classifiers in the making: their scores on the training frames and the rounds so far.

    Args:
        learner: finds the weak hypothesis of a round.
        targets: True where y^m = +1; one set for all problems, or one each.
        n_problems: how many strong classifiers grow side by side.
        shrinkage: factor in (0, 1] on every weak hypothesis.
        generator: the randomness of the learner.

    With base weights held still the loss never rises: a weak hypothesis lowers it, and by convexity so does
    any shrunken step towards it.
    """

    def __init__(
        self,
        learner: WeakLearner,
        targets: Bool[Tensor, "frames #problems classes"],
        n_problems: int,
        shrinkage: float,
        generator: torch.Generator,
    ) -> None:
        if not 0 < shrinkage <= 1:
            raise ValueError(f"shrinkage is {shrinkage}: give a number above 0 and up to 1")
        self.learner = learner
        self.targets = targets.to(learner.device)
        self.shrinkage = shrinkage
        self.generator = generator
        shape = (learner.n_frames, n_problems, targets.shape[2])
        self.scores: Float[Tensor, "frames problems classes"] = torch.zeros(shape, device=learner.device)
        self.rounds: list = []

    def round(self, base: Float[Tensor, "frames problems"]) -> None:
        """Add one weak hypothesis to every problem, fitted to its base weights times the losses so far."""
        weights = base[:, :, None] * self._exponentials()
        hypotheses = self.learner.fit(weights, self.targets, self.generator)
        self.scores += self.shrinkage * self.learner.outputs(hypotheses)
        self.rounds.append(hypotheses)

    def losses(self) -> Float[Tensor, "frames problems"]:
        """sum_m exp(-y^m f^m(x)) of every frame and problem: the cost of holding the frame."""
        return self._exponentials().sum(2)

    def strong(self) -> StrongClassifier:
        """The strong classifiers of the rounds so far."""
        return self.learner.strong(self.rounds).scaled(self.shrinkage)

    def _exponentials(self) -> Tensor:
        margins = torch.where(self.targets, self.scores, -self.scores)
        return margins.clamp_(min=-MARGIN_LIMIT).neg_().exp_()


def class_targets(labels: Int64[Tensor, " frames"], n_classes: int) -> Bool[Tensor, "frames 1 classes"]:
    """y_n^m = +1 as True where frame n has class m, for all problems alike."""
    return torch.nn.functional.one_hot(labels, n_classes).bool()[:, None]
