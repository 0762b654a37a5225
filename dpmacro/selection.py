"""Which segmentation to keep, from the demonstrations alone.

Rival segmentations explain the actions equally well (the training loss cannot tell them apart), but the
planner has only images to tell when to change. So every rival is judged much as it would be run: in
trajectories that the fit left out, the switch functions choose the macro-labels frame by frame, without
looking ahead, and the strong classifiers are charged for the actions under those labels. What is left out
are the trajectories of these quick fits; the rival's labels themselves came from all of them.
"""

from collections.abc import Callable
from dataclasses import dataclass

import torch
from jaxtyping import Int64
from torch import Tensor

from dpmacro.boosting import Boosting, Round, class_targets
from dpmacro.learners.sorting import SortedLevels
from dpmacro.learners.stumps import StumpLearner
from dpmacro.stopping import folds_of
from dpmacro.switching import causal_labels, fit_switches, starting_macro

__all__ = ["Verdict", "best_verdict", "distinct", "judge"]

FINALISTS = 8  # rivals whose changes are recognised best go on to the dearer test
FOLDS = 4
ROUNDS = 60
COLUMNS = 128  # random columns searched a round
SWITCH_ROUNDS = 30
SWITCH_COLUMNS = 512
SHRINKAGE = 0.2
CLOSE = 1.1  # causal errors within this factor are a tie


@dataclass(frozen=True)
class Verdict:
    """What left-out trajectories say of a segmentation."""

    detected: float  # share of changes recognised at their first frame and not before; 1 where there is none
    causal_loss: float  # exponential loss per frame when switch functions choose the labels
    causal_error: float  # share of frames whose action is wrong, likewise


def judge(
    data: SortedLevels,
    actions: Int64[Tensor, " frames"],
    lengths: Int64[Tensor, " trajectories"],
    rivals: Int64[Tensor, "rivals frames"],
    n_actions: int,
    seed: int,
    groups: Int64[Tensor, " trajectories"] | None = None,
    on_round: Callable[[Round], None] = lambda _: None,
) -> dict[int, Verdict]:
    """Verdicts on the finalists among rival segmentations, by their number.

    All rivals get the same folds and random columns, drawn by `seed`; trajectories of the same group fall
    into the same fold. `on_round` is called after every rival's switch functions, then after every boosting
    round of the finalists' classifiers, which grow side by side. Raises ValueError with fewer than two
    trajectories: there is nothing to leave out.
    """
    if len(lengths) < 2:
        raise ValueError(
            f"{len(lengths)} trajectory: judging a segmentation leaves trajectories out, give two or more"
        )
    detected, causal = [], []
    learner = StumpLearner(data, drawn=SWITCH_COLUMNS)
    for number, labels in enumerate(rivals, 1):
        switches = fit_switches(
            learner,
            labels,
            lengths,
            torch.Generator().manual_seed(seed),
            rounds=SWITCH_ROUNDS,
            groups=groups,
        )
        first = starting_macro(labels, lengths)
        causal.append(causal_labels(switches.held_out, switches.thresholds, switches.pairs, lengths, first))
        detected.append(float(switches.detected.mean()) if switches.pairs else 1.0)
        agreement = float((causal[-1] == labels).float().mean())
        on_round(Round("recognise", number, len(rivals), 1 - detected[-1], agreement, None))
    order = sorted(range(len(rivals)), key=lambda k: -detected[k])[:FINALISTS]
    losses, errors = _causal_charges(
        data,
        actions.cpu(),
        lengths,
        rivals[order],
        torch.stack([causal[k] for k in order]),
        n_actions,
        seed,
        groups,
        on_round,
    )
    return {k: Verdict(detected[k], losses[f], errors[f]) for f, k in enumerate(order)}


def _causal_charges(
    data: SortedLevels,
    actions: Int64[Tensor, " frames"],
    lengths: Int64[Tensor, " trajectories"],
    rivals: Int64[Tensor, "finalists frames"],
    causal: Int64[Tensor, "finalists frames"],
    n_actions: int,
    seed: int,
    groups: Int64[Tensor, " trajectories"] | None,
    on_round: Callable[[Round], None],
) -> tuple[list[float], list[float]]:
    """Exponential loss and share of wrong actions per left-out frame, every frame under its causal label."""
    generator = torch.Generator().manual_seed(seed)
    n_rivals, n_macros = len(rivals), int(rivals.max()) + 1
    fold_of = folds_of(len(lengths), FOLDS, generator, groups).repeat_interleave(lengths)
    n_folds = int(fold_of.max()) + 1
    held = torch.nn.functional.one_hot(rivals, n_macros).float().transpose(0, 1)
    kept = (fold_of[:, None] != torch.arange(n_folds)).float()
    learner = StumpLearner(data, drawn=COLUMNS)
    base = (held[:, :, None] * kept[:, None, :, None]).flatten(1).to(learner.device)
    targets = class_targets(actions, n_actions).to(learner.device)
    boosting = Boosting(learner, targets, base.shape[1], SHRINKAGE, generator)
    truth = actions.to(learner.device)[:, None]
    for number in range(1, ROUNDS + 1):
        boosting.round(base)
        loss = float((base * boosting.losses()).sum() / base.sum())
        accuracy = float((base * (boosting.scores.argmax(2) == truth)).sum() / base.sum())
        on_round(Round("judge", number, ROUNDS, loss, accuracy, None))
    problem = (torch.arange(n_rivals)[:, None] * n_folds + fold_of) * n_macros + causal  # [finalists, frames]
    frames = torch.arange(len(actions))
    losses = boosting.losses().cpu()[frames, problem].mean(1)
    wrong = boosting.scores.cpu()[frames, problem].argmax(2) != actions
    return losses.tolist(), wrong.float().mean(1).tolist()


def best_verdict(verdicts: dict[int, Verdict]) -> int:
    """The rival of least causal error; of those within a tenth of it the one whose changes are seen best."""
    limit = CLOSE * min(verdict.causal_error for verdict in verdicts.values())
    close = [k for k, verdict in verdicts.items() if verdict.causal_error <= limit]
    return max(close, key=lambda k: verdicts[k].detected)


def distinct(rivals: Int64[Tensor, "rivals frames"], similar: float = 0.99) -> Int64[Tensor, " kept"]:
    """The first of every group of rivals that agree on `similar` of the frames, labels taken as named."""
    kept: list[int] = []
    for k, labels in enumerate(rivals):
        if all(float((labels == rivals[other]).float().mean()) < similar for other in kept):
            kept.append(k)
    return torch.tensor(kept)
