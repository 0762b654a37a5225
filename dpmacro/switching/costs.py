"""What switch functions charge a segmentation: a change costs what it takes to recognise it.

The paper names the switch functions' own loss in the dynamic program as future work. Here every frame n with
macro-action q asks the switch functions H_q^r, all r, whether to stay, and the answer is charged:

    staying in q      stay_n(q)    = sum_r l(-H_q^r(x_n))
    changing q' -> q  T_n(q', q)   = stay_n(q') - l(-H_q'^q(x_n)) + l(H_q'^q(x_n)) - stay_n(q)

with l(z) = log(1 + exp(-2z)), so that stay_n(q) joins the cost c_n(q) of every frame but the first of its
trajectory, and T enters the inner minimum of the segmentation.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int64
from torch import Tensor

from dpmacro.segmentation.segments import macro_segments

__all__ = ["SwitchCosts", "change_log_odds", "charges_of"]

SCORE_LIMIT = 3.0  # scores are cut off at +- this


@dataclass(frozen=True)
class SwitchCosts:
    """What the switch functions charge a segmentation, beside the actions; nats times a weight."""

    staying: Float[Tensor, "frames macros"]  # joins the cost of every frame
    changing: Float[Tensor, "frames macros macros"]  # T_n(q', q) of the segmentation


def change_log_odds(
    labels: Int64[Tensor, " frames"], lengths: Int64[Tensor, " trajectories"], n_macros: int
) -> Float[Tensor, "macros macros"]:
    """Log odds, for a frame of q', that q comes next: one more change than was seen in one more frame."""
    frames_of = labels.cpu().bincount(minlength=n_macros)
    changes = torch.zeros(n_macros, n_macros)
    for segment in macro_segments(labels, lengths):
        if segment.following is not None:
            changes[segment.macro, segment.following] += 1
    return ((changes + 1) / (frames_of[:, None] + 1)).log()


def charges_of(
    scores: Float[Tensor, "frames switches"],
    pairs: Sequence[tuple[int, int]],
    log_odds: Float[Tensor, "macros macros"],
    lengths: Int64[Tensor, " trajectories"],
    weight: float = 1.0,
) -> SwitchCosts:
    """stay_n(q) and T_n(q', q), in nats times `weight`, from the scores of switch functions.

    A switch function is trained on two halves of equal weight, so half the log odds of a change are added to
    its score, which is cut off at +-`SCORE_LIMIT` before. Where a function may not fire its score is to be
    the lowest. A change without a function has its odds alone.
    """
    n_macros = len(log_odds)
    total = (log_odds / 2).to(scores).repeat(len(scores), 1, 1)
    for place, (source, target) in enumerate(pairs):
        total[:, source, target] += scores[:, place].clamp(-SCORE_LIMIT, SCORE_LIMIT)
    others = ~torch.eye(n_macros, dtype=torch.bool, device=scores.device)
    refusing = torch.nn.functional.softplus(2 * total) * others
    firing = torch.nn.functional.softplus(-2 * total)
    staying = refusing.sum(2).double()
    staying[(lengths.cumsum(0) - lengths).to(scores.device)] = 0
    changing = staying[:, :, None] - refusing + firing - staying[:, None, :]
    return SwitchCosts(weight * staying, weight * changing.double())
