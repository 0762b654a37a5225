"""The alternation with linear models: ridge regressions, one per macro-action, and the segmentation in turn.

    sum_n |y_n - W_{q_n} [x_n, 1]|^2 + r sum_q |W_q|^2   subject to   #{n : q_n != q_{n+1}} <= S

in every trajectory. It asks what a regression hidden Markov model asks (Fridman 1994), with a strict bound in place
of transition probabilities, and converges in a few cheap sweeps from many starts side by side.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Float, Int64
from torch import Tensor

from dpmacro.discovery.starts.evidence import Evidence

__all__ = ["LinearOutcomes", "Moments", "linear_alternation"]

SWEEPS = 20
RIDGE = 1.0  # frames' worth of a component's variance
TABLE = 2**24  # costs that stand in memory together


@dataclass(frozen=True)
class LinearOutcomes:
    """Where the linear alternation ended from every start."""

    labels: Int64[Tensor, "restarts frames"]
    loss: Float[Tensor, " restarts"]  # squared error a frame, summed over dimensions


class Moments:
    """What linear models are fitted to and judged by: products of inputs and actions of every frame."""

    def __init__(self, evidence: Evidence) -> None:
        actions = evidence.actions
        inputs = torch.cat([evidence.components, torch.ones(len(actions), 1)], 1)
        self.n_inputs, self.dims = inputs.shape[1], actions.shape[1]
        self.table: Float[Tensor, "frames moments"] = torch.cat(
            [
                (inputs[:, :, None] * inputs[:, None]).flatten(1),
                (inputs[:, :, None] * actions[:, None]).flatten(1),
                actions.square().sum(1, keepdim=True),
            ],
            1,
        )

    def models(self, sums: Float[Tensor, "models moments"]) -> Float[Tensor, "models moments"]:
        """Ridge regressions to sums of moments, as the coefficients that a frame's moments are charged by.

        |y - W x|^2 = <W W^T, x x^T> - 2 <W, x y^T> + |y|^2 is linear in the moments.
        """
        square = self.n_inputs**2
        gram = sums[:, :square].double().unflatten(1, (self.n_inputs, self.n_inputs))
        cross = sums[:, square:-1].double().unflatten(1, (self.n_inputs, self.dims))
        ridge = RIDGE * torch.eye(self.n_inputs, dtype=torch.float64)
        weights = torch.linalg.solve(gram + ridge, cross)
        both = weights @ weights.transpose(1, 2)
        ones = torch.ones(len(sums), 1, dtype=torch.float64)
        return torch.cat([both.flatten(1), -2 * weights.flatten(1), ones], 1).float()


def linear_alternation(
    evidence: Evidence, starts: Int64[Tensor, "restarts frames"], moments: Moments | None = None
) -> LinearOutcomes:
    """The linear alternation from every start, `SWEEPS` sweeps at most."""
    moments = Moments(evidence) if moments is None else moments
    n_frames, macros = len(evidence.actions), evidence.macros
    size = max(TABLE // (n_frames * macros), 1)
    labels, losses = [], []
    for part in starts.split(size):
        found, loss = _alternated(evidence, part.clone(), moments)
        labels.append(found)
        losses.append(loss)
    if not labels:
        return LinearOutcomes(starts, torch.zeros(0))
    return LinearOutcomes(torch.cat(labels), torch.cat(losses))


def _alternated(evidence: Evidence, labels: Tensor, moments: Moments) -> tuple[Tensor, Tensor]:
    restarts, n_frames = labels.shape
    macros = evidence.macros
    loss = torch.full((restarts,), torch.inf)
    going = torch.arange(restarts)
    for _ in range(SWEEPS):
        own = labels[going]
        held = torch.nn.functional.one_hot(own, macros).float()
        sums = held.transpose(1, 2).flatten(0, 1) @ moments.table
        costs = (moments.table @ moments.models(sums).T).clamp(min=0).unflatten(1, (-1, macros))
        found = torch.stack([evidence.cheapest(cost) for cost in costs.unbind(1)])
        chosen = costs.gather(2, found.T[:, :, None])[:, :, 0]
        loss[going] = chosen.mean(0)
        changed = (found != own).any(1)
        labels[going] = found
        going = going[changed]
        if len(going) == 0:
            break
    return labels, loss
