"""Losses of classes: the exponential loss of AdaBoost.MH, and the deviance that left-out data is charged."""

import torch
from jaxtyping import Bool, Float, Int64
from torch import Tensor

__all__ = ["MARGIN_LIMIT", "bounded_deviance", "class_targets", "exponentials_of"]

MARGIN_LIMIT = 18.0  # exp(18) = 6.6e7: prefix sums of such costs keep 1e-5 in float64


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
