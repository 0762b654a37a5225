"""The loss of vectors: Huber's, and with an infinite delta half the squared error.

L2Boost (Friedman 2001; Buehlmann and Yu 2003): a weak hypothesis is fitted to what is left of the vectors.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

__all__ = ["LOSSES", "HuberLoss"]

DEVIATIONS = 2.0  # left-out residuals are cut off at so many of their deviations, times the limit
RIDGE = 4.0  # `slack` counts so often in the mean of a leaf: two frames that say nothing with half a frame
LOSSES = {"huber": 1.0, "squared": float("inf")}  # delta by name, in standard deviations of the actions


@dataclass(frozen=True)
class HuberLoss:
    """sum_d rho(y_nd - f_d(x_n)) over dimensions d; rho(r) = r^2 / 2 up to |r| = delta, then linear.

    Actions are standardised, so delta is in their standard deviations. A leaf's vote is the mean of its
    clipped residuals: rho'' is 1 at most, so a vote never overshoots (Huber 1964; Friedman 2001).
    """

    outputs: int
    delta: float = LOSSES["huber"]
    signed = True

    def targets(self, actions: Float[Tensor, "frames dims"]) -> Float[Tensor, "frames 1 dims"]:
        """The actions."""
        return actions[:, None]

    def terms(
        self,
        scores: Float[Tensor, "frames problems dims"],
        targets: Float[Tensor, "frames #problems dims"],
    ) -> Float[Tensor, "frames problems dims"]:
        """Rho of every residual."""
        residuals = targets - scores
        near = residuals.clamp(-self.delta, self.delta)
        return residuals.sub_(near, alpha=0.5).mul_(near)

    def working(
        self,
        terms: Float[Tensor, "frames problems dims"],
        scores: Float[Tensor, "frames problems dims"],
        targets: Float[Tensor, "frames #problems dims"],
        base: Float[Tensor, "frames problems"],
    ) -> tuple[Float[Tensor, "frames problems 1"], Float[Tensor, "frames problems dims"]]:
        """Base weights, and residuals clipped at +-delta."""
        return base[:, :, None], (targets - scores).clamp_(-self.delta, self.delta)

    def table(
        self,
        weights: Float[Tensor, "frames problems 1"],
        responses: Float[Tensor, "frames problems dims"],
    ) -> Float[Tensor, "frames 1 rows problems"]:
        """W r of every dimension, then w: G and H."""
        frames, problems, dims = responses.shape
        rows = responses.new_empty(frames, dims + 1, problems)
        torch.mul(responses.transpose(1, 2), weights.transpose(1, 2), out=rows[:, :-1])
        rows[:, -1:] = weights.transpose(1, 2)
        return rows[:, None]

    def split(
        self,
        below: Float[Tensor, "columns bins 1 rows problems"],
        slack: Float[Tensor, " problems"],
    ) -> Float[Tensor, "columns bins problems"]:
        """-(|G|^2 / H) / 2, summed over the two sides."""
        ridge = (RIDGE * slack).clamp(min=torch.finfo(slack.dtype).tiny)
        left = below[:, :, 0]
        total = left[:, -1:]
        low = _squares(left[:, :, :-1]).div_(left[:, :, -1].clamp(min=0).add_(ridge))
        high = _squares(total[:, :, :-1] - left[:, :, :-1])
        high.div_((total[:, :, -1] - left[:, :, -1]).clamp_(min=0).add_(ridge))
        return low.add_(high).mul_(-0.5)

    def votes(
        self, sides: Float[Tensor, "problems 2 1 rows"], slack: Float[Tensor, " problems"]
    ) -> Float[Tensor, "problems 2 dims"]:
        """G / H."""
        below, total = sides[:, :, 0].unbind(1)
        both = torch.stack([below, total - below], 1)
        ridge = (RIDGE * slack).clamp(min=torch.finfo(slack.dtype).tiny)
        return both[..., :-1] / (both[..., -1:].clamp(min=0) + ridge[:, None, None])

    def remaining(
        self,
        weights: Float[Tensor, "frames 1"],
        responses: Float[Tensor, "frames dims"],
        votes: Float[Tensor, "frames dims"],
    ) -> Float[Tensor, "frames dims"]:
        """W (r - h)^2 / 2, of the clipped residuals."""
        return weights * (responses - votes).square() / 2

    def charge(
        self,
        scores: Float[Tensor, "frames problems dims"],
        targets: Float[Tensor, "frames #problems dims"],
        limit: float,
        scale: Float[Tensor, " dims"],
    ) -> Float[Tensor, "frames problems"]:
        """sum_d z_d^2 / 2 with residuals z in units of `scale`, cut off at `DEVIATIONS` times `limit`.

        The negative log likelihood of normal residuals, but for a constant. Bounded, a frame that nobody can
        explain counts once.
        """
        bound = DEVIATIONS * limit
        return ((targets - scores) / scale).clamp_(-bound, bound).square_().sum(2).div_(2)

    def scale(
        self, scores: Float[Tensor, "frames dims"], actions: Float[Tensor, "frames dims"]
    ) -> Float[Tensor, " dims"]:
        """Root mean square of the residuals, 0.001 at least."""
        return (actions - scores).square().mean(0).sqrt().clamp(min=1e-3)

    def per_nat(self, scale: Float[Tensor, " dims"]) -> float:
        """Mean square of the deviations: the loss does not divide by it."""
        return float(scale.square().mean())

    def error(self, scores: Float[Tensor, "frames dims"], actions: Float[Tensor, "frames dims"]) -> float:
        """Mean square of the residuals over that of the actions, 1 at most."""
        unexplained = (actions - scores).square().mean()
        return float((unexplained / actions.square().mean().clamp(min=1e-12)).clamp(max=1))


def _squares(sums: Float[Tensor, "columns bins dims problems"]) -> Float[Tensor, "columns bins problems"]:
    """|G|^2, added up in the order of the dimensions however many columns there are."""
    first, *others = sums.unbind(2)
    result = first.square()
    for one in others:
        result.addcmul_(one, one)
    return result
