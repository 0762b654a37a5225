"""Segmentation and switch functions together: a change costs what it takes to recognise it.

The paper names the switch functions' own loss in the dynamic program as future work. Here every frame n with
macro-action q asks the switch functions H_q^r, all r, whether to stay, and the answer is charged:

    staying in q      stay_n(q)    = sum_r l(-H_q^r(x_n))
    changing q' -> q  T_n(q', q)   = stay_n(q') - l(-H_q'^q(x_n)) + l(H_q'^q(x_n)) - stay_n(q)

with l(z) = log(1 + exp(-2z)), so that stay_n(q) joins the cost c_n(q) of every frame but the first of its
trajectory, and T enters the inner minimum of the segmentation. All scores are those of classifiers and switch
functions that never saw the trajectory: on their own training data a few dozen changes can always be told.
"""

import torch
from jaxtyping import Int64
from torch import Tensor

from dpmacro.alternation import SwitchCosts
from dpmacro.crossfit import bounded_deviance
from dpmacro.segmentation import segment
from dpmacro.selection import Judged, Task
from dpmacro.switching import macro_segments

__all__ = ["resegmented", "switch_costs"]

MARGIN = 3.0  # of the bounded deviances


def resegmented(judged: Judged, task: Task, weight: float = 1.0) -> Int64[Tensor, " frames"]:
    """The segmentation that left-out classifiers and switch functions of a rival agree on.

    `weight` is how much the switch functions count beside the actions.
    """
    targets = torch.nn.functional.one_hot(task.actions.cpu(), task.n_actions).bool()
    costs = bounded_deviance(judged.scores, targets[:, None], MARGIN).double()
    extra = switch_costs(judged, task, weight)
    return segment(costs + extra.staying, task.lengths, task.max_transitions, extra.changing).labels


def switch_costs(judged: Judged, task: Task, weight: float = 1.0) -> SwitchCosts:
    """stay_n(q) and T_n(q', q), in nats times `weight`.

    A switch function is trained on two halves of equal weight, so half the log odds of a change are added to
    its score. A change that was never seen has no function: its odds are those of one in as many frames.
    """
    n_frames, n_macros = len(judged.labels), task.macros
    frames_of = judged.labels.bincount(minlength=n_macros)
    changes: dict[tuple[int, int], int] = {}
    for event in macro_segments(judged.labels, task.lengths):
        if event.following is not None:
            pair = event.macro, event.following
            changes[pair] = changes.get(pair, 0) + 1
    scores = torch.zeros(n_frames, n_macros, n_macros)
    for source in range(n_macros):
        for target in range(n_macros):
            times = changes.get((source, target), 0)
            odds = (times + 1) / (int(frames_of[source]) + 1)
            scores[:, source, target] = torch.tensor(odds).log() / 2
    for place, (source, target) in enumerate(judged.switches.pairs):
        scores[:, source, target] += judged.switches.held_out[:, place].clamp(-MARGIN, MARGIN)
    others = ~torch.eye(n_macros, dtype=torch.bool)
    refusing = torch.nn.functional.softplus(2 * scores) * others
    firing = torch.nn.functional.softplus(-2 * scores)
    staying = refusing.sum(2).double()
    starts = task.lengths.cumsum(0) - task.lengths
    staying[starts] = 0
    changing = staying[:, :, None] - refusing + firing - staying[:, None, :]
    return SwitchCosts(weight * staying, weight * changing.double())
