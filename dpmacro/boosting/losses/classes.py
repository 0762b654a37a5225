"""The loss of classes: AdaBoost.MH's exponential loss, the paper's, and the deviance of left-out data."""

from dataclasses import dataclass
from functools import reduce
from operator import add

import torch
from jaxtyping import Bool, Float, Int64
from torch import Tensor

__all__ = ["MARGIN_LIMIT", "ExponentialLoss", "bounded_deviance", "class_targets", "exponentials_of"]

MARGIN_LIMIT = 18.0  # exp(18) = 6.6e7: prefix sums of such costs keep 1e-5 in float64


@dataclass(frozen=True)
class ExponentialLoss:
    """sum_m exp(-y_n^m f^m(x_n)) over classes m, margins no lower than -`MARGIN_LIMIT`."""

    outputs: int = 1
    signed = False

    def targets(self, actions: Int64[Tensor, " frames"]) -> Bool[Tensor, "frames 1 classes"]:
        """y_n^m = +1 as True; a class beyond the outputs is none of them."""
        n_classes = max(self.outputs, int(actions.max()) + 1)
        return class_targets(actions, n_classes)[..., : self.outputs]

    def terms(
        self,
        scores: Float[Tensor, "frames problems classes"],
        targets: Bool[Tensor, "frames #problems classes"],
    ) -> Float[Tensor, "frames problems classes"]:
        """exp(-y^m f^m(x))."""
        return exponentials_of(scores, targets)

    def working(
        self,
        terms: Float[Tensor, "frames problems classes"],
        scores: Float[Tensor, "frames problems classes"],
        targets: Bool[Tensor, "frames #problems classes"],
        base: Float[Tensor, "frames problems"],
    ) -> tuple[Float[Tensor, "frames problems classes"], Bool[Tensor, "frames #problems classes"]]:
        """AdaBoost's weights, base times exponential, and the classes themselves."""
        return base[:, :, None] * terms, targets

    def table(
        self,
        weights: Float[Tensor, "frames problems classes"],
        responses: Bool[Tensor, "frames #problems classes"],
    ) -> Float[Tensor, "frames 2 classes problems"]:
        """Weights of right class labels, and of wrong ones."""
        weights, responses = weights.transpose(1, 2), responses.transpose(1, 2)
        return torch.stack([weights * responses, weights * ~responses], 1)

    def split(
        self,
        below: Float[Tensor, "columns bins 2 classes problems"],
        slack: Float[Tensor, " problems"],
    ) -> Float[Tensor, "columns bins problems"]:
        """Z / 2: sqrt(W+ W-) summed over the two sides and the classes."""
        above = below[:, -1:] - below
        low = (below[:, :, 0] * below[:, :, 1]).sqrt_()
        high = (above[:, :, 0] * above[:, :, 1]).clamp_(min=0).sqrt_()
        return reduce(add, low.add_(high).unbind(2))

    def votes(
        self, sides: Float[Tensor, "problems 2 2 classes"], slack: Float[Tensor, " problems"]
    ) -> Float[Tensor, "problems 2 classes"]:
        """1/2 ln((W+ + e) / (W- + e)) with e the slack."""
        below, total = sides.unbind(1)
        weights = torch.stack([below, (total - below).clamp(min=0)], 1)
        right, wrong = (weights + slack[:, None, None, None].clamp(min=torch.finfo(slack.dtype).tiny)).unbind(
            2
        )
        return (right / wrong).log() / 2

    def remaining(
        self,
        weights: Float[Tensor, "frames classes"],
        responses: Bool[Tensor, "frames classes"],
        votes: Float[Tensor, "frames classes"],
    ) -> Float[Tensor, "frames classes"]:
        """W exp(-y h)."""
        return weights * torch.where(responses, -votes, votes).exp()

    def charge(
        self,
        scores: Float[Tensor, "frames problems classes"],
        targets: Bool[Tensor, "frames #problems classes"],
        limit: float,
        scale: Float[Tensor, " classes"],
    ) -> Float[Tensor, "frames problems"]:
        """Bounded deviances, margins cut off at -`limit` and `limit`; classes have no scale."""
        return bounded_deviance(scores, targets, limit)

    def scale(
        self, scores: Float[Tensor, "frames classes"], actions: Int64[Tensor, " frames"]
    ) -> Float[Tensor, " classes"]:
        """Ones."""
        return scores.new_ones(self.outputs)

    def per_nat(self, scale: Float[Tensor, " classes"]) -> float:
        """1: the exponential loss and the deviance are alike near a margin of 0."""
        return 1.0

    def error(self, scores: Float[Tensor, "frames classes"], actions: Int64[Tensor, " frames"]) -> float:
        """Share of the frames whose class of highest score is wrong."""
        return float((scores.argmax(1) != actions).float().mean())


def exponentials_of(
    scores: Float[Tensor, "frames problems classes"], targets: Bool[Tensor, "frames #problems classes"]
) -> Float[Tensor, "frames problems classes"]:
    """exp(-y^m f^m(x)), margins no lower than -`MARGIN_LIMIT`."""
    margins = torch.where(targets, scores, -scores)
    return margins.clamp_(min=-MARGIN_LIMIT).neg_().exp_()


def class_targets(labels: Int64[Tensor, " frames"], n_classes: int) -> Bool[Tensor, "frames 1 classes"]:
    """y_n^m = +1 as True where frame n has class m, for all problems alike."""
    return torch.nn.functional.one_hot(labels, n_classes).bool()[:, None]


def bounded_deviance(
    scores: Float[Tensor, "*shape classes"], targets: Bool[Tensor, "*#shape classes"], limit: float
) -> Float[Tensor, "*shape"]:
    """sum_m log(1 + exp(-2 y^m f^m(x))) in nats, margins y f cut off at -limit and limit.

    The binomial deviance is what the exponential loss estimates (Friedman, Hastie, Tibshirani 2000). On
    left-out frames the exponential loss itself hangs on the few that are confidently wrong; bounded, each of
    those counts once.
    """
    margins = torch.where(targets, scores, -scores).clamp(-limit, limit)
    return torch.nn.functional.softplus(-2 * margins).sum(-1)
