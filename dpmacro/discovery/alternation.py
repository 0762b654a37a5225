"""DPBoost's alternation: a boosting round, then a segmentation, from many initial ones side by side."""

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int64, Num
from torch import Tensor

from dpmacro.boosting.loop import Boosting, Round
from dpmacro.segmentation.recursion import cost_of, segment
from dpmacro.switching.costs import SwitchCosts
from dpmacro.utils.stages import storable

__all__ = ["Alternated", "ObjectiveWarning", "alternate", "pooled"]

ROUNDING = 1e-4  # relative; scores are float32


class ObjectiveWarning(RuntimeWarning):
    """The objective of an alternation rose by more than rounding explains."""


@storable
@dataclass(frozen=True)
class Alternated:
    """Where the alternation ended from every initial segmentation."""

    labels: Int64[Tensor, "restarts frames"]
    loss: Float[Tensor, "rounds restarts"]  # objective per frame after every round


def alternate(
    boosting: Boosting,
    actions: Num[Tensor, "frames *dims"],
    lengths: Int64[Tensor, " trajectories"],
    starts: Int64[Tensor, "restarts frames"],
    n_macros: int,
    max_transitions: int,
    rounds: int,
    warmup: int,
    stage: str,
    on_round: Callable[[Round], None] = lambda _: None,
    switch_costs: SwitchCosts | None = None,
    order: str = "free",
    keep: Callable[[Tensor, Tensor | None], Tensor] = lambda costs, _: costs,
) -> Alternated:
    """Boosting rounds, each followed by a segmentation once `warmup` rounds are over.

    Boosting lowers the objective with the labels held, segmentation lowers it with the classifiers held and
    the labels so far among its choices: it never rises but for rounding, and an `ObjectiveWarning` says so
    where it does. `switch_costs`, with a single start only, join the objective and stay as they are. `order`
    is that of `segment`; with "chain" every start is one.
    `keep` makes of the costs, of all starts one after another, and of what changes cost those under which
    labels stay that are given; every start has them (see `Task.held`).
    `boosting` has a problem for every start and macro-action. Ends early where no problem finds anything
    better than chance and the labels stay as they are.

    Raises ValueError for switch costs with several starts.
    """
    restarts, n_frames = starts.shape
    device = boosting.learner.device
    labels, repeated = starts.to(device), lengths.repeat(restarts)
    actions, frames = actions.to(device), torch.arange(n_frames, device=device)
    changing = None
    if switch_costs is not None:
        if restarts != 1:
            raise ValueError(f"switch costs with {restarts} starts: they belong to one segmentation")
        switch_costs = SwitchCosts(switch_costs.staying.to(device), switch_costs.changing.to(device))
        changing = switch_costs.changing
    loss: list[Tensor] = []
    for number in range(1, rounds + 1):
        held = torch.nn.functional.one_hot(labels, n_macros).float()
        ended = boosting.round(held.transpose(0, 1).flatten(1))
        costs = boosting.losses().unflatten(1, (restarts, n_macros)).transpose(0, 1)
        if switch_costs is not None:
            costs = costs + switch_costs.staying
        changed = torch.zeros(restarts)
        if number > warmup and n_macros > 1:
            own = keep(costs.flatten(0, 1), changing)
            found = segment(own, repeated, max_transitions, changing, order).labels
            found = found.view(restarts, n_frames)
            changed, labels = (found != labels).float().mean(1), found
        totals = [cost_of(own, cost, lengths, changing) for own, cost in zip(labels, costs, strict=True)]
        loss.append(torch.stack(totals) / n_frames)
        before = loss[max(len(loss) - 2, 0)]
        risen = (loss[-1] - before) / before.abs()
        if bool((risen > ROUNDING).any()):
            warnings.warn(
                f"the objective of stage {stage!r} rose in round {number}, by {float(risen.max()):.2g} of "
                "itself: its segmentation may be worse than an earlier one",
                ObjectiveWarning,
                stacklevel=2,
            )
        best = int(loss[-1].argmin())
        accuracy = 1 - boosting.loss.error(boosting.scores[frames, best * n_macros + labels[best]], actions)
        over = tuple(ended.tolist()) if restarts == 1 else ()
        now = float(loss[-1][best]), accuracy, labels[best], float(changed[best])
        on_round(Round(stage, number, rounds, *now, ended=over))
        segmented = number > warmup or n_macros == 1
        if segmented and bool(boosting.ended.all()) and not bool(changed.any()):
            break
    return Alternated(labels.cpu(), torch.stack(loss).cpu())


def pooled(parts: Sequence[Alternated]) -> Alternated:
    """Several alternations as one; the objective of those that ended early stays as it ended."""
    rounds = max(len(part.loss) for part in parts)
    losses = [torch.cat([part.loss, part.loss[-1:].expand(rounds - len(part.loss), -1)]) for part in parts]
    return Alternated(torch.cat([part.labels for part in parts]), torch.cat(losses, 1))
