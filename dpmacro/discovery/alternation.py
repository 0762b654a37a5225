"""DPBoost's alternation: a boosting round, then a segmentation, from many initial ones side by side."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int64
from torch import Tensor

from dpmacro.boosting.loop import Boosting, Round
from dpmacro.segmentation.recursion import cost_of, segment

__all__ = ["Alternated", "SwitchCosts", "alternate", "pooled"]

ROUNDING = 1e-4  # relative; scores are float32


@dataclass(frozen=True)
class SwitchCosts:
    """What the switch functions charge a segmentation, beside the actions."""

    staying: Float[Tensor, "frames macros"]  # joins the cost of every frame
    changing: Float[Tensor, "frames macros macros"]  # T_n(q', q) of the segmentation


@dataclass(frozen=True)
class Alternated:
    """Where the alternation ended from every initial segmentation."""

    labels: Int64[Tensor, "restarts frames"]
    loss: Float[Tensor, "rounds restarts"]  # objective per frame after every round


def alternate(
    boosting: Boosting,
    actions: Int64[Tensor, " frames"],
    lengths: Int64[Tensor, " trajectories"],
    starts: Int64[Tensor, "restarts frames"],
    n_macros: int,
    max_transitions: int,
    rounds: int,
    warmup: int,
    stage: str,
    on_round: Callable[[Round], None] = lambda _: None,
    switch_costs: SwitchCosts | None = None,
) -> Alternated:
    """Boosting rounds, each followed by a segmentation once `warmup` rounds are over.

    Boosting lowers the objective with the labels held, segmentation lowers it with the classifiers held and
    the labels so far among its choices: it never rises, which is asserted up to rounding. `switch_costs`,
    with a single start only, join the objective and stay as they are. `boosting` has a problem for every
    start and macro-action.
    """
    restarts, n_frames = starts.shape
    device = boosting.learner.device
    labels, repeated = starts.to(device), lengths.repeat(restarts)
    actions, frames = actions.to(device), torch.arange(n_frames, device=device)
    changing = None
    if switch_costs is not None:
        assert restarts == 1, "switch costs belong to one segmentation"
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
            found = segment(costs.flatten(0, 1), repeated, max_transitions, changing).labels
            found = found.view(restarts, n_frames)
            changed, labels = (found != labels).float().mean(1), found
        totals = [cost_of(own, cost, lengths, changing) for own, cost in zip(labels, costs, strict=True)]
        loss.append(torch.stack(totals) / n_frames)
        before = loss[max(len(loss) - 2, 0)]
        assert not bool((loss[-1] > before + ROUNDING * before.abs()).any()), (
            f"{stage} rose in round {number}"
        )
        best = int(loss[-1].argmin())
        chosen = boosting.scores[frames, best * n_macros + labels[best]].argmax(1)
        accuracy = float((chosen == actions).float().mean())
        over = tuple(ended.tolist()) if restarts == 1 else ()
        now = float(loss[-1][best]), accuracy, labels[best], float(changed[best])
        on_round(Round(stage, number, rounds, *now, ended=over))
        if bool(boosting.ended.all()):
            break
    return Alternated(labels.cpu(), torch.stack(loss).cpu())


def pooled(parts: Sequence[Alternated]) -> Alternated:
    """Several alternations as one; the objective of those that ended early stays as it ended."""
    rounds = max(len(part.loss) for part in parts)
    losses = [torch.cat([part.loss, part.loss[-1:].expand(rounds - len(part.loss), -1)]) for part in parts]
    return Alternated(torch.cat([part.labels for part in parts]), torch.cat(losses, 1))
