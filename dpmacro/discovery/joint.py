"""Segmentation and switch functions together: a change costs what it takes to recognise it.

The paper names the switch functions' own loss in the dynamic program as future work. Here every frame n with
macro-action q asks the switch functions H_q^r, all r, whether to stay, and the answer is charged:

    staying in q      stay_n(q)    = sum_r l(-H_q^r(x_n))
    changing q' -> q  T_n(q', q)   = stay_n(q') - l(-H_q'^q(x_n)) + l(H_q'^q(x_n)) - stay_n(q)

with l(z) = log(1 + exp(-2z)), so that stay_n(q) joins the cost c_n(q) of every frame but the first of its
trajectory, and T enters the inner minimum of the segmentation. All scores are those of classifiers and switch
functions that never saw the trajectory: on their own training data a few dozen changes can always be told.
"""

from collections.abc import Sequence

import torch
from jaxtyping import Float, Int64
from torch import Tensor

from dpmacro.boosting.crossfit import bounded_deviance
from dpmacro.discovery.alternation import SwitchCosts
from dpmacro.discovery.candidates import Judged, Task
from dpmacro.segmentation.recursion import segment, transition_counts
from dpmacro.switching.functions import macro_segments

__all__ = ["change_log_odds", "charges_of", "resegmented", "switch_costs"]

MARGIN = 3.0  # of the bounded deviances


def resegmented(judged: Judged, task: Task, weight: float = 1.0) -> Int64[Tensor, " frames"]:
    """The segmentation that left-out classifiers and switch functions of a rival agree on.

    It has no more transitions in a trajectory than the rival has in any. `weight` is how much the switch
    functions count beside the actions.
    """
    targets = torch.nn.functional.one_hot(task.actions.cpu(), task.n_actions).bool()
    costs = bounded_deviance(judged.scores, targets[:, None], MARGIN).double()
    extra = switch_costs(judged, task, weight)
    bound = min(task.max_transitions, int(transition_counts(judged.labels, task.lengths).max()))
    return segment(costs + extra.staying, task.lengths, bound, extra.changing).labels


def switch_costs(judged: Judged, task: Task, weight: float = 1.0) -> SwitchCosts:
    """What left-out switch functions of a rival charge, in nats times `weight`."""
    log_odds = change_log_odds(judged.labels, task.lengths, task.macros)
    return charges_of(judged.switches.held_out, judged.switches.pairs, log_odds, task.lengths, weight)


def change_log_odds(
    labels: Int64[Tensor, " frames"], lengths: Int64[Tensor, " trajectories"], n_macros: int
) -> Float[Tensor, "macros macros"]:
    """Log odds, for a frame of q', that q comes next: one more change than was seen in one more frame."""
    frames_of = labels.bincount(minlength=n_macros)
    changes = torch.zeros(n_macros, n_macros)
    for event in macro_segments(labels, lengths):
        if event.following is not None:
            changes[event.macro, event.following] += 1
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
    its score, which is cut off at +-`MARGIN` before. A change without a function has its odds alone.
    """
    n_macros = len(log_odds)
    total = (log_odds / 2).to(scores).repeat(len(scores), 1, 1)
    for place, (source, target) in enumerate(pairs):
        total[:, source, target] += scores[:, place].clamp(-MARGIN, MARGIN)
    others = ~torch.eye(n_macros, dtype=torch.bool, device=scores.device)
    refusing = torch.nn.functional.softplus(2 * total) * others
    firing = torch.nn.functional.softplus(-2 * total)
    staying = refusing.sum(2).double()
    staying[(lengths.cumsum(0) - lengths).to(scores.device)] = 0
    changing = staying[:, :, None] - refusing + firing - staying[:, None, :]
    return SwitchCosts(weight * staying, weight * changing.double())
