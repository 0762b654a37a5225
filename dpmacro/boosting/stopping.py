"""Early stopping: trajectories that a fit leaves out decide how many boosting rounds are worth having."""

from collections.abc import Callable

import torch
from jaxtyping import Float, Int64, Num
from torch import Tensor

from dpmacro.boosting.folds import folds_of
from dpmacro.boosting.learners.base import WeakLearner
from dpmacro.boosting.loop import Boosting, Round
from dpmacro.boosting.losses.base import Loss
from dpmacro.utils.stages import stage

__all__ = ["BestRound", "validated_rounds"]

PARTS = 4  # one of so many parts of the trajectories is left out
PATIENCE = 0.2  # share of all rounds that may pass without a better one
LEAST_PATIENCE = 5


class BestRound:
    """The round with the least held-out loss of every problem, and when to give up on a better one."""

    def __init__(self, rounds: int) -> None:
        self.patience = max(int(PATIENCE * rounds), LEAST_PATIENCE)
        self.number = 0  # rounds seen
        self.best: Int64[Tensor, " problems"] = torch.zeros(0, dtype=torch.int64)  # from 1
        self._least: Tensor | None = None

    def exhausted(self, losses: Float[Tensor, " problems"]) -> bool:
        """Note the held-out losses of one more round; whether no problem has hope left."""
        self.number += 1
        if self._least is None:
            self._least, self.best = losses.clone(), torch.ones_like(losses, dtype=torch.int64)
        better = losses < self._least
        self._least = torch.where(better, losses, self._least)
        self.best = torch.where(better, self.number, self.best)
        return bool((self.number - self.best >= self.patience).all())


@stage
def validated_rounds(
    learner: WeakLearner,
    labels: Int64[Tensor, " frames"],
    actions: Num[Tensor, "frames *dims"],
    lengths: Int64[Tensor, " trajectories"],
    rounds: int,
    shrinkage: float,
    loss: Loss,
    generator: torch.Generator,
    groups: Int64[Tensor, " trajectories"] | None = None,
    on_round: Callable[[Round], None] = lambda _: None,
) -> int:
    """How many of `rounds` boosting rounds left-out trajectories want, 1 or more.

    A classifier for every macro-class is fitted, its labels held still, with a quarter of the trajectories
    left out; the round with the least error on those is the answer. The error, of classes the share of
    wrong actions, is asked rather than the exponential loss, which rises as soon as a few left-out frames
    are confidently wrong, long before the planner's decisions suffer.

    Trajectories of the same group are left out together. Raises ValueError where nothing can be left out.
    """
    fold_of = folds_of(len(lengths), PARTS, generator, groups)
    if int(fold_of.max()) == 0:
        raise ValueError(
            f"{len(lengths)} trajectory: early stopping leaves trajectories out, give two or more"
        )
    left_out = (fold_of == 0).repeat_interleave(lengths).to(learner.device)
    labels, actions = labels.to(learner.device), actions.to(learner.device)
    n_macros = int(labels.max()) + 1
    base = torch.nn.functional.one_hot(labels, n_macros).float() * ~left_out[:, None]
    boosting = Boosting(learner, loss.targets(actions), n_macros, shrinkage, generator, loss=loss)
    stopping, frames = BestRound(rounds), torch.arange(len(labels), device=learner.device)
    for number in range(1, rounds + 1):
        boosting.round(base)
        error = loss.error(boosting.scores[frames, labels][left_out], actions[left_out])
        lost = float(boosting.losses()[frames, labels][left_out].mean())
        on_round(Round("validate", number, rounds, lost, 1 - error, None))
        if stopping.exhausted(torch.tensor([error])) or bool(boosting.ended.all()):
            break
    return int(stopping.best)
