"""Which segmentation to keep, from the demonstrations alone.

Rival segmentations explain the actions equally well (the training loss cannot tell them apart), but the
planner has only images to tell when to change. So every candidate is judged as it would be run: in
trajectories that the fit left out, the switch functions choose the macro-labels frame by frame, without
looking ahead, and the strong classifiers are charged for the actions under those labels.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Int64
from torch import Tensor

from dpmacro.boosting import Boosting, class_targets
from dpmacro.learners import WeakLearner
from dpmacro.switching import causal_labels, fit_switches, folds_of, starting_macro

__all__ = ["Verdict", "distinct", "judge"]

SWITCH_ROUNDS = 30
ROUNDS = 60
SHRINKAGE = 0.2
FOLDS = 4


@dataclass(frozen=True)
class Verdict:
    """What left-out trajectories say of a segmentation."""

    causal_loss: float  # exponential loss per frame when switch functions choose the labels
    causal_error: float  # share of frames whose action is wrong, likewise
    detected: float  # share of changes recognised when they happen and not before; 1 where there is none


def judge(
    learner: WeakLearner,
    actions: Int64[Tensor, " frames"],
    lengths: Int64[Tensor, " trajectories"],
    candidates: Int64[Tensor, "candidates frames"],
    n_actions: int,
    generator: torch.Generator,
) -> list[Verdict]:
    """A verdict on every candidate segmentation; all of them are boosted side by side.

    Raises ValueError with fewer than two trajectories: there is nothing to leave out.
    """
    if len(lengths) < 2:
        raise ValueError(
            f"{len(lengths)} trajectory: judging a segmentation leaves trajectories out, give two or more"
        )
    n_candidates, n_macros = len(candidates), int(candidates.max()) + 1
    fold_of = folds_of(len(lengths), FOLDS, generator).repeat_interleave(lengths)
    n_folds = int(fold_of.max()) + 1
    held = torch.nn.functional.one_hot(candidates, n_macros).float().transpose(0, 1)
    kept = (fold_of[:, None] != torch.arange(n_folds)).float()
    base = (held[:, :, None] * kept[:, None, :, None]).flatten(1).to(learner.device)
    targets = class_targets(actions, n_actions)
    boosting = Boosting(learner, targets, base.shape[1], SHRINKAGE, generator)
    for _ in range(ROUNDS):
        boosting.round(base)
    frames = torch.arange(len(actions))
    scores = boosting.scores.cpu().unflatten(1, (n_candidates, n_folds, n_macros))[frames, :, fold_of]
    losses = boosting.losses().cpu().unflatten(1, (n_candidates, n_folds, n_macros))[frames, :, fold_of]
    verdicts = []
    for c, labels in enumerate(candidates):
        switches = fit_switches(learner, labels, lengths, generator, rounds=SWITCH_ROUNDS)
        first = starting_macro(labels, lengths)
        causal = causal_labels(switches.held_out, switches.thresholds, switches.pairs, lengths, first)
        wrong = scores[frames, c, causal].argmax(1) != actions
        verdicts.append(
            Verdict(
                float(losses[frames, c, causal].mean()),
                float(wrong.float().mean()),
                float(switches.detected.mean()) if switches.pairs else 1.0,
            )
        )
    return verdicts


def distinct(candidates: Int64[Tensor, "candidates frames"], similar: float = 0.99) -> Int64[Tensor, " kept"]:
    """The first of every group of candidates that agree on `similar` of the frames, labels taken as named."""
    kept: list[int] = []
    for c, labels in enumerate(candidates):
        if all(float((labels == candidates[k]).float().mean()) < similar for k in kept):
            kept.append(c)
    return torch.tensor(kept)
