"""Scores of every frame by classifiers that never saw it: what a segmentation is worth on left-out data."""

from collections.abc import Callable
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int64
from torch import Tensor

from dpmacro.boosting.folds import frame_folds
from dpmacro.boosting.learners.stumps import StumpLearner
from dpmacro.boosting.loop import Boosting, Round
from dpmacro.boosting.losses.classes import class_targets
from dpmacro.features.levels import SortedLevels

__all__ = ["CLASSIFIER_FOLDS", "LeftOutScores", "left_out_scores"]

CLASSIFIER_FOLDS = 4
SHARED_ROUNDS = 60  # that a candidate's macro-actions share
OWN_ROUNDS = 40  # of each after those
COLUMNS = 128  # random columns searched a round
SHRINKAGE = 0.2


@dataclass(frozen=True)
class LeftOutScores:
    """f^m(x) of every frame, by classifiers fitted to the other folds."""

    macros: Float[Tensor, "candidates frames macros actions"]  # one classifier for every macro-action of each
    alone: Float[Tensor, "frames actions"]  # a single classifier: the baseline


def left_out_scores(
    data: SortedLevels,
    actions: Int64[Tensor, " frames"],
    lengths: Int64[Tensor, " trajectories"],
    candidates: Int64[Tensor, "candidates frames"],
    n_macros: int,
    n_actions: int,
    seed: int,
    groups: Int64[Tensor, " trajectories"] | None = None,
    on_round: Callable[[Round], None] = lambda _: None,
) -> LeftOutScores:
    """Cross-fitted scores of candidate segmentations and of the baseline, all grown side by side.

    Every candidate gets the same folds and random columns, drawn by `seed`. Trajectories of a group fall into
    the same fold; where there are fewer groups than folds, stretches of trajectories are left out instead.
    `on_round` is called with the training loss of all of them together.

    A macro-action has a part of the frames only. If its classifier learned from those alone it would know
    less than the baseline of what all macro-actions have in common, and a segmentation would be judged by
    that lack. So all classifiers of a fold begin as the baseline's, after its first `SHARED_ROUNDS`.
    """
    generator = torch.Generator().manual_seed(seed)
    fold_of = frame_folds(lengths, CLASSIFIER_FOLDS, generator, groups)
    n_folds = int(fold_of.max()) + 1
    learner = StumpLearner(data, drawn=COLUMNS)
    kept = (fold_of[:, None] != torch.arange(n_folds)).float()
    kept = kept.to(learner.device)
    held = torch.nn.functional.one_hot(candidates, n_macros).float().transpose(0, 1).to(learner.device)
    base = (held[:, :, None] * kept[:, None, :, None]).flatten(1)
    base = torch.cat([base, kept], 1)
    targets = class_targets(actions, n_actions).to(learner.device)
    folds = torch.arange(n_folds, device=learner.device)
    forks = torch.cat([folds.repeat_interleave(n_macros).repeat(len(candidates)), folds])
    boosting, rounds = Boosting(learner, targets, n_folds, SHRINKAGE, generator), SHARED_ROUNDS + OWN_ROUNDS
    for number in range(1, rounds + 1):
        if number == SHARED_ROUNDS + 1:
            start = boosting.scores[:, forks]
            boosting = Boosting(learner, targets, len(forks), SHRINKAGE, generator, start)
        weights = kept if number <= SHARED_ROUNDS else base
        boosting.round(weights)
        loss = float((weights * boosting.losses()).sum() / weights.sum())
        right = boosting.scores.argmax(2) == actions.to(learner.device)[:, None]
        on_round(Round("score", number, rounds, loss, float((weights * right).sum() / weights.sum()), None))
    frames, own = torch.arange(len(actions)), fold_of
    macros = boosting.scores[:, :-n_folds].unflatten(1, (len(candidates), n_folds, n_macros))
    alone = boosting.scores[:, -n_folds:]
    return LeftOutScores(macros[frames, :, own].transpose(0, 1).cpu(), alone[frames, own].cpu())
