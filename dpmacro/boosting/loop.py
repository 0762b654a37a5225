"""The one boosting loop: strong classifiers grown a round at a time, many problems side by side.

For every problem p the strong classifier f_p(x) = sum_t h_{p,t}(x) lowers sum_n d_{n,p} c(y_n, f_p(x_n)),
where d is the frame's base weight in the problem and c its loss (dpmacro/boosting/losses): with that of
classes this is AdaBoost.MH (Schapire and Singer 1999), with those of vectors gradient boosting (Friedman
2001).
The macro-classes of DPBoost, the baseline and the switch functions are all problems of this kind.
"""

from dataclasses import dataclass
from typing import Any

import torch
from jaxtyping import Bool, Float, Int64, Shaped
from torch import Tensor

from dpmacro.boosting.learners.base import StrongClassifier, WeakLearner
from dpmacro.boosting.losses.base import Loss
from dpmacro.boosting.losses.classes import ExponentialLoss
from dpmacro.utils.stages import journal

__all__ = ["Boosting", "Round"]

CHANCE = 1e-6  # relative; a round that lowers the loss by less is no better than chance
TRIES = 3  # rounds in a row without success: columns are drawn and networks start at random


@dataclass(frozen=True)
class Round:
    """What a boosting round reports to its observer."""

    stage: str  # discover | score | recognise | validate | fit | switch
    number: int  # from 1
    total: int
    loss: float  # loss per frame; of the best restart while discovering
    accuracy: float  # share of training frames whose class is right, or of the variance explained, likewise
    labels: (
        Int64[Tensor, " frames"] | None
    )  # macro-labels, likewise; None where there is not one segmentation of all frames
    label_changes: float = 0.0  # share of frames whose macro-label this round changed
    ended: tuple[int, ...] = ()  # macro-actions or switch functions that found nothing better than chance


class Boosting:
    """Strong classifiers in the making: their scores on the training frames and the rounds so far.

    Args:
        learner: finds the weak hypothesis of a round.
        targets: of the loss, True where y^m = +1, say; one set for all problems, or one each.
        n_problems: how many strong classifiers grow side by side.
        shrinkage: factor in (0, 1] on every weak hypothesis.
        generator: the randomness of the learner.
        start: scores to begin with, which `strong` knows nothing of; zeros by default.
        loss: what is lowered; the exponential loss of classes by default.

    With base weights held still the loss never rises: a weak hypothesis that does not lower it is no better
    than chance and is left out. A problem to which that happens `TRIES` times in a row has ended: it gets no
    more hypotheses until its base weights change, since other frames may hold what these do not.
    """

    def __init__(
        self,
        learner: WeakLearner,
        targets: Shaped[Tensor, "frames #problems outputs"],
        n_problems: int,
        shrinkage: float,
        generator: torch.Generator,
        start: Float[Tensor, "frames problems outputs"] | None = None,
        loss: Loss | None = None,
    ) -> None:
        if not 0 < shrinkage <= 1:
            raise ValueError(f"shrinkage is {shrinkage}: give a number above 0 and up to 1")
        self.learner = learner
        self.loss: Loss = ExponentialLoss(targets.shape[2]) if loss is None else loss
        self.targets = targets.to(learner.device)
        self.shrinkage = shrinkage
        self.generator = generator
        shape = (learner.n_frames, n_problems, targets.shape[2])
        zeros = torch.zeros(shape, device=learner.device)
        self.scores: Float[Tensor, "frames problems outputs"] = zeros if start is None else start
        self.ended: Bool[Tensor, " problems"] = torch.zeros(
            n_problems, dtype=torch.bool, device=learner.device
        )
        self._failures = torch.zeros(shape[1], dtype=torch.int64, device=learner.device)
        self._terms = self.loss.terms(self.scores, self.targets)
        self._lost = self._terms.sum(2)
        self._rounds: list = []
        self._steps: list[Tensor] = []
        self._memory: object = None
        self._base: Tensor | None = None  # of the round before
        self._journal = journal()

    def round(self, base: Float[Tensor, "frames problems"]) -> Int64[Tensor, " ended"]:
        """Add one weak hypothesis to every problem, fitted to its base weights times the losses so far.

        Returns the problems that end in this round. Raises ValueError for weights that are negative or NaN,
        and for those whose sum overflows.
        """
        if not bool((base >= 0).all()):
            raise ValueError(f"a base weight is {float(base.min())}: weights must be 0 or more")
        self._revive(base)
        active = base * ~self.ended
        before = (active * self._lost).sum(0, dtype=torch.float64)
        hypotheses = self._found(active)
        steps = self.shrinkage * (~self.ended).to(self.scores.dtype)
        scores = self.learner.outputs(hypotheses).mul_(steps[:, None]).add_(self.scores)
        terms = self.loss.terms(scores, self.targets)
        lost = terms.sum(2)
        after = (base * lost).sum(0, dtype=torch.float64)
        chance = (before > 0) & ~(after <= before * (1 - CHANCE))
        self._failures = torch.where(chance, self._failures + 1, 0)
        if bool(chance.any()):
            steps[chance] = 0
            scores[:, chance], terms[:, chance] = self.scores[:, chance], self._terms[:, chance]
            lost[:, chance] = self._lost[:, chance]
        ending = (self._failures == TRIES) & ~self.ended
        self.ended = self.ended | ending
        self.scores, self._terms, self._lost = scores, terms, lost
        self._rounds.append(hypotheses)
        self._steps.append(steps)
        return ending.nonzero()[:, 0]

    def _found(self, active: Float[Tensor, "frames problems"]) -> Any:
        """The round's hypotheses: those of a run that was stopped, where it came so far, or new ones."""
        known = None if self._journal is None else self._journal.known(self.generator)
        if known is not None:
            return known
        weights, responses = self.loss.working(self._terms, self.scores, self.targets, active)
        found, self._memory = self.learner.fit(weights, responses, self.generator, self._memory, self.loss)
        if self._journal is not None:
            self._journal.note(found, self.generator, self._memory is None)
        return found

    def _revive(self, base: Float[Tensor, "frames problems"]) -> None:
        """Give problems whose base weights are not those of the round before their tries back."""
        if self._base is not None and self._base is not base:
            changed = (self._base != base).any(0)
            self.ended = self.ended & ~changed
            self._failures = torch.where(changed, 0, self._failures)
        self._base = base

    def losses(self) -> Float[Tensor, "frames problems"]:
        """c_n of every frame and problem, the loss summed over outputs: the cost of holding the frame."""
        return self._lost

    def strong(self, rounds: Int64[Tensor, " problems"] | None = None) -> StrongClassifier:
        """The strong classifiers of all rounds so far, or of the first `rounds` of every problem."""
        steps = torch.stack(self._steps)
        if rounds is not None:
            steps = steps * (torch.arange(len(steps), device=steps.device)[:, None] < rounds)
        return self.learner.strong(self._rounds, steps)
