"""Switch functions learned from the change points of a segmentation (Section IV of the paper).

H_q^q' separates the J frames from a change on (positives) from the frames of q (negatives), both sides
weighing the same. It is asked only after its cues, so it learns only from frames after them: what tells a
change from a turn need not tell it from a step. Its threshold is calibrated on left-out trajectories.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int64
from torch import Tensor

from dpmacro.boosting.folds import folds_of
from dpmacro.boosting.learners.base import WeakLearner
from dpmacro.boosting.loop import MARGIN_LIMIT, Boosting, Round, exponentials_of
from dpmacro.boosting.stopping import BestRound
from dpmacro.switching.functions import Event, SwitchFunctions, cued, macro_segments
from dpmacro.switching.threshold import calibrated

__all__ = ["FOLDS", "SwitchSettings", "examples", "fit_switches"]

COVERED = 0.75  # of the changes, by their cues
FOLDS = 5  # of trajectories; one function for each leaves it out, one more sees all


@dataclass(frozen=True)
class SwitchSettings:
    """How switch functions learn; a value out of range raises ValueError.

    Attributes:
        rounds: boosting rounds, 1 or more.
        window: J >= 1, the positive frames from a change on. Later ones show what the next macro-action
            does, which a planner that waits for the change never sees: with J = 10 a correction near the
            flag passes for the change.
        shrinkage: factor in (0, 1] on every weak hypothesis.
        folds: parts, 2 or more, that trajectories are dealt into; a function that never saw it scores each.
        early_stopping: whether every switch function keeps the rounds with the least loss on left-out parts.
        focused: whether frames after other actions than the cues are no examples. Where some changes are
            a frame or two late all frames are better ones: the true change is then taken for a frame before.
    """

    rounds: int
    window: int = 3
    shrinkage: float = 0.2
    folds: int = FOLDS
    early_stopping: bool = False
    focused: bool = True

    def __post_init__(self) -> None:
        if self.window < 1 or self.rounds < 1:
            raise ValueError(f"window is {self.window} and rounds {self.rounds}: both must be 1 or more")
        if not 0 < self.shrinkage <= 1:
            raise ValueError(f"shrinkage is {self.shrinkage}: give a number above 0 and up to 1")
        if self.folds < 2:
            raise ValueError(f"folds is {self.folds}: give 2 or more, so that something can be left out")


def fit_switches(
    learner: WeakLearner,
    labels: Int64[Tensor, " frames"],
    lengths: Int64[Tensor, " trajectories"],
    generator: torch.Generator,
    settings: SwitchSettings,
    groups: Int64[Tensor, " trajectories"] | None = None,
    actions: Int64[Tensor, " frames"] | None = None,
    on_round: Callable[[Round], None] = lambda _: None,
) -> SwitchFunctions:
    """Fit a switch function for every change of macro-label that the trajectories show.

    Args:
        learner: finds the weak hypotheses; holds the frames, and copies of all of them after them if
            any, like mirror images: examples too, of which no threshold or cue is taken.
        labels, lengths: the segmentation.
        generator: deals trajectories into folds, and draws what the learner draws.
        settings: see there.
        groups: trajectories of the same group fall into the same part, like mirror images; alone by default.
        actions: of every frame, for the cues; without them a switch function may fire after any action.
        on_round: called after every round with the balanced loss and accuracy over all of them.

    All switch functions and all their folds are boosted side by side. With a single trajectory nothing can
    be left out, and the calibration uses the training scores (`SwitchFunctions.left_out` is False).

    Raises ValueError where the learner does not hold a whole number of copies of the frames.
    """
    n_frames = len(labels)
    copies, rest = divmod(learner.n_frames, n_frames)
    if rest or not copies:
        raise ValueError(f"the learner holds {learner.n_frames} frames and {n_frames} are labelled")
    events = macro_segments(labels, lengths)
    pairs = sorted({(event.macro, event.following) for event in events if event.following is not None})
    if not pairs:
        return SwitchFunctions([], torch.zeros(0), torch.zeros(0), torch.zeros(n_frames, 0), None)
    cues = () if actions is None else tuple(_cues(pair, events, actions) for pair in pairs)
    asked = torch.ones(n_frames, len(pairs), dtype=torch.bool)
    if actions is not None:
        asked = cued(actions, lengths, cues)
    shown = asked if settings.focused else torch.ones_like(asked)
    fold_of = folds_of(len(lengths), settings.folds, generator, groups)
    n_fits = int(fold_of.max()) + 2 if fold_of.any() else 1  # the last one sees every trajectory
    weights, targets = zip(
        *(
            examples(pair, events, fold_of == fold, own, settings.window)
            for pair, own in zip(pairs, shown.unbind(1), strict=True)
            for fold in [*range(n_fits - 1), -1]
        ),
        strict=True,
    )
    all_targets = torch.stack(targets, 1).repeat(copies, 1)[:, :, None].to(learner.device)
    boosting = Boosting(learner, all_targets, len(targets), settings.shrinkage, generator)
    base = (torch.stack(weights, 1).repeat(copies, 1) / copies).to(learner.device)
    own_fit = fold_of.clamp(max=n_fits - 1).repeat_interleave(lengths).to(learner.device)
    held_out, kept = _boosted(boosting, base, own_fit, n_fits, settings, on_round)
    held_out = held_out.cpu().masked_fill(~asked, -MARGIN_LIMIT)
    found = [calibrated(pair, events, scores) for pair, scores in zip(pairs, held_out.unbind(1), strict=True)]
    thresholds, detected = torch.tensor(found).unbind(1)
    last = torch.arange(n_fits - 1, len(targets), n_fits, device=learner.device)
    classifier = boosting.strong(kept).select(last)
    return SwitchFunctions(pairs, thresholds, detected, held_out, classifier, cues, n_fits > 1)


def _boosted(
    boosting: Boosting,
    base: Float[Tensor, "examples problems"],
    own_fit: Int64[Tensor, " frames"],
    n_fits: int,
    settings: SwitchSettings,
    on_round: Callable[[Round], None],
) -> tuple[Float[Tensor, "frames switches"], Int64[Tensor, " problems"] | None]:
    """Boost `n_fits` problems a switch function; what a frame's own fit says of it, and the rounds kept."""
    n_frames, n_problems = len(own_fit), base.shape[1]
    n_switches = n_problems // n_fits
    last = torch.arange(n_fits - 1, n_problems, n_fits, device=base.device)

    def own_scores() -> Float[Tensor, "frames switches"]:
        scores = boosting.scores[:n_frames, :, 0].unflatten(1, (n_switches, n_fits))
        return scores.gather(2, own_fit[:, None, None].expand(-1, n_switches, 1)).squeeze(2)

    stopping, kept = BestRound(settings.rounds), None
    held_out = torch.zeros(n_frames, n_switches, device=base.device)
    for number in range(1, settings.rounds + 1):
        ended = boosting.round(base)
        right = ((boosting.scores > 0) == boosting.targets)[:, :, 0]
        accuracy = float((base * right).sum() / n_problems)
        loss = float((base * boosting.losses()).sum() / n_problems)
        over = tuple(int(k) // n_fits for k in ended if int(k) % n_fits == n_fits - 1)
        on_round(Round("switch", number, settings.rounds, loss, accuracy, None, ended=over))
        if settings.early_stopping:
            scores = own_scores()
            costs = exponentials_of(scores[:, :, None], boosting.targets[:n_frames, last])[:, :, 0]
            exhausted = stopping.exhausted((base[:n_frames, last] * costs).sum(0))
            kept = stopping.best.repeat_interleave(n_fits)
            held_out = torch.where(stopping.best == number, scores, held_out)
            if exhausted:
                break
        if bool(boosting.ended.all()):
            break
    return held_out if settings.early_stopping else own_scores(), kept


def examples(
    pair: tuple[int, int],
    events: Sequence[Event],
    left_out: Bool[Tensor, " trajectories"],
    shown: Bool[Tensor, " frames"],
    window: int,
) -> tuple[Float[Tensor, " frames"], Bool[Tensor, " frames"]]:
    """Base weights, half a side, and targets of a switch function that never sees what is left out.

    Args:
        pair: (from, to) macro-actions.
        events: the segments of all trajectories.
        left_out: trajectories without examples.
        shown: frames that may be examples.
        window: J, the positive frames from a change on; fewer where the next segment is shorter.
    """
    weights = torch.zeros(len(shown))
    targets = torch.zeros(len(shown), dtype=torch.bool)
    macro, following = pair
    for event in events:
        if event.macro != macro or left_out[event.trajectory]:
            continue
        weights[event.start : event.stop] = 1
        if event.following == following:
            positives = slice(event.stop, min(event.stop + window, event.following_stop))
            weights[positives] = 1
            targets[positives] = True
    weights *= shown
    for side in (targets, ~targets):
        weights[side] /= (2 * weights[side].sum()).clamp(min=1)
    return weights, targets


def _cues(
    pair: tuple[int, int], events: Sequence[Event], actions: Int64[Tensor, " frames"]
) -> tuple[int, ...]:
    """The actions that come right before most changes of a pair, the fewest that cover `COVERED` of them.

    Not all: a segmentation that is a frame or two late has the action after the change there.
    """
    before = [event.stop - 1 for event in events if (event.macro, event.following) == pair]
    counts = actions.cpu()[before].bincount()
    order = counts.argsort(descending=True, stable=True)
    enough = int((counts[order].cumsum(0) < COVERED * len(before)).sum()) + 1
    return tuple(sorted(order[:enough].tolist()))
