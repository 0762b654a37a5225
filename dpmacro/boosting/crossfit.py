"""Scores of every frame by classifiers that never saw it: what a segmentation is worth on left-out data."""

from collections.abc import Callable
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int64, Num
from torch import Tensor

from dpmacro.boosting.folds import frame_folds
from dpmacro.boosting.learners.stumps import StumpLearner
from dpmacro.boosting.loop import Boosting, Round
from dpmacro.boosting.losses.base import Loss
from dpmacro.features.levels import LEVELS, SortedLevels
from dpmacro.utils.stages import stage, storable

__all__ = ["CLASSIFIER_FOLDS", "LeftOutScores", "Pace", "left_out_scores", "pace_of"]

CLASSIFIER_FOLDS = 4
TABLE = 2**27  # scores of candidates that grow side by side


@dataclass(frozen=True)
class Pace:
    """How far the classifiers of candidates are grown."""

    shared: int  # rounds that a candidate's macro-actions share
    own: int  # rounds of each after those
    shrinkage: float
    columns: int  # random ones searched a round
    bins: int  # of a column, at most


CLASSES = Pace(shared=60, own=40, shrinkage=0.2, columns=128, bins=LEVELS)
# Squared errors fall slowly. Classifiers that stop early, or have most rounds in common, cannot tell what a
# macro-action's own model explains.
VECTORS = Pace(shared=20, own=80, shrinkage=0.5, columns=48, bins=64)


def pace_of(actions: Num[Tensor, "frames *dims"]) -> Pace:
    """That of classes or of vectors."""
    return VECTORS if actions.ndim == 2 else CLASSES


@storable
@dataclass(frozen=True)
class LeftOutScores:
    """Scores of every frame, by classifiers fitted to the other folds."""

    macros: Float[Tensor, "candidates frames macros outputs"]  # one classifier for every macro-action of each
    alone: Float[Tensor, "frames outputs"]  # a single classifier: the baseline


@stage
def left_out_scores(
    data: SortedLevels,
    actions: Num[Tensor, "frames *dims"],
    lengths: Int64[Tensor, " trajectories"],
    candidates: Int64[Tensor, "candidates frames"],
    n_macros: int,
    loss: Loss,
    seed: int,
    groups: Int64[Tensor, " trajectories"] | None = None,
    on_round: Callable[[Round], None] = lambda _: None,
) -> LeftOutScores:
    """Cross-fitted scores of candidate segmentations and of the baseline, all grown side by side.

    `loss` is that of the actions, classes or vectors. Every candidate gets the same folds and random columns,
    drawn by `seed`. Trajectories of a group fall into the same fold; where there are fewer groups than folds,
    stretches of trajectories are left out instead. `on_round` is called with the training loss of all of them
    together, and the accuracy of one fold's baseline.

    A macro-action has a part of the frames only. If its classifier learned from those alone it would know
    less than the baseline of what all macro-actions have in common, and a segmentation would be judged by
    that lack. So all classifiers of a fold begin as the baseline's, after its first rounds (`pace_of`).

    So many candidates grow at a time as `TABLE` allows, each lot with the same draws.
    """
    generator = torch.Generator().manual_seed(seed)
    fold_of = frame_folds(lengths, CLASSIFIER_FOLDS, generator, groups)
    drawn, pace = generator.get_state(), pace_of(actions)
    learner = StumpLearner(data, drawn=pace.columns, bins=pace.bins)
    room = len(actions) * CLASSIFIER_FOLDS * n_macros * max(actions[0].numel(), 1)
    parts = []
    for some in candidates.split(max(TABLE // room, 1)):
        generator.set_state(drawn)
        parts.append(_grown(learner, actions, fold_of, some, n_macros, loss, pace, generator, on_round))
    return LeftOutScores(torch.cat([part.macros for part in parts]), parts[0].alone)


def _grown(
    learner: StumpLearner,
    actions: Num[Tensor, "frames *dims"],
    fold_of: Int64[Tensor, " frames"],
    candidates: Int64[Tensor, "candidates frames"],
    n_macros: int,
    loss: Loss,
    pace: Pace,
    generator: torch.Generator,
    on_round: Callable[[Round], None],
) -> LeftOutScores:
    """Scores of candidates that grow side by side."""
    n_folds = int(fold_of.max()) + 1
    kept = (fold_of[:, None] != torch.arange(n_folds)).float()
    kept = kept.to(learner.device)
    held = torch.nn.functional.one_hot(candidates, n_macros).float().transpose(0, 1).to(learner.device)
    base = (held[:, :, None] * kept[:, None, :, None]).flatten(1)
    base = torch.cat([base, kept], 1)
    actions = actions.to(learner.device)
    targets = loss.targets(actions)
    folds = torch.arange(n_folds, device=learner.device)
    forks = torch.cat([folds.repeat_interleave(n_macros).repeat(len(candidates)), folds])
    boosting = Boosting(learner, targets, n_folds, pace.shrinkage, generator, loss=loss)
    rounds = pace.shared + pace.own
    for number in range(1, rounds + 1):
        if number == pace.shared + 1:
            start = boosting.scores[:, forks]
            boosting = Boosting(learner, targets, len(forks), pace.shrinkage, generator, start, loss)
        weights = kept if number <= pace.shared else base
        boosting.round(weights)
        lost = float((weights * boosting.losses()).sum() / weights.sum())
        known = weights[:, -n_folds:]  # of one fit, all frames but a fold
        accuracy = 1 - loss.error(boosting.scores[known[:, 0] > 0, -n_folds], actions[known[:, 0] > 0])
        on_round(Round("score", number, rounds, lost, accuracy, None))
    frames, own = torch.arange(len(actions)), fold_of
    macros = boosting.scores[:, :-n_folds].unflatten(1, (len(candidates), n_folds, n_macros))
    alone = boosting.scores[:, -n_folds:]
    return LeftOutScores(macros[frames, :, own].transpose(0, 1).cpu(), alone[frames, own].cpu())
