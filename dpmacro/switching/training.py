"""Switch functions learned from the change points of a segmentation (Section IV of the paper).

H_q^q' separates the J frames from a change on (positives) from the frames before it (negatives), both sides
weighing the same. Where it may fire only after its cues, it learns only from frames after them. Its
threshold is chosen by the scores of functions that never saw the trajectory.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int64
from torch import Tensor

from dpmacro.boosting.folds import folds_of
from dpmacro.boosting.learners.base import WeakLearner
from dpmacro.boosting.loop import Boosting, Round
from dpmacro.boosting.losses.classes import MARGIN_LIMIT, exponentials_of
from dpmacro.boosting.stopping import BestRound
from dpmacro.segmentation.segments import Segment, macro_segments, starting_macros
from dpmacro.switching.examples import cues_of, examples, start_examples
from dpmacro.switching.functions import SwitchFunctions, cued
from dpmacro.switching.threshold import best_threshold, recognised_share
from dpmacro.utils.stages import stage

__all__ = ["SWITCH_FOLDS", "SwitchSettings", "fit_switches"]

SWITCH_FOLDS = 5  # of trajectories; one function for each leaves it out, one more sees all


@dataclass(frozen=True)
class SwitchSettings:
    """How switch functions learn; a value out of range raises ValueError.

    Attributes:
        rounds: boosting rounds, 1 or more.
        window: J >= 1, the positive frames from a change on. Later ones show what the next macro-action
            does, which a policy that waits for the change never sees.
        shrinkage: factor in (0, 1] on every weak hypothesis.
        folds: parts, 2 or more, that trajectories are dealt into; a function that never saw it scores each.
        early_stopping: whether every switch function keeps the rounds with the least loss on left-out parts.
        focused: whether frames after other actions than the cues are no examples. Where some changes are
            a frame or two late all frames are better ones: the true change is then taken for a frame before.
        whole_past: whether all frames of the trajectory before the change are negatives, as in the paper,
            instead of the frames of all segments of macro-action q.
        calibrated: whether left-out scores choose the thresholds; else they are 0.
        cues: whether a function may fire only after the actions that come before its changes.
        aligned: whether changes are moved to where left-out functions fire before the final fit.
        tolerance: frames by which a function may fire early or late and still recognises its change, 0 or
            more.
    """

    rounds: int = 400
    window: int = 3
    shrinkage: float = 0.2
    folds: int = SWITCH_FOLDS
    early_stopping: bool = False
    focused: bool = True
    whole_past: bool = False
    calibrated: bool = True
    cues: bool = True
    aligned: bool = True
    tolerance: int = 0

    def __post_init__(self) -> None:
        if self.window < 1 or self.rounds < 1:
            raise ValueError(f"window is {self.window} and rounds {self.rounds}: both must be 1 or more")
        if not 0 < self.shrinkage <= 1:
            raise ValueError(f"shrinkage is {self.shrinkage}: give a number above 0 and up to 1")
        if self.tolerance < 0:
            raise ValueError(f"tolerance is {self.tolerance}: give 0 or more")
        if self.folds < 2:
            raise ValueError(f"folds is {self.folds}: give 2 or more, so that something can be left out")


@dataclass(frozen=True)
class _Fold:
    """What one fit of the switch functions leaves out, and what the rest says."""

    left_out: Bool[Tensor, " trajectories"]
    cues: tuple[tuple[int, ...], ...]  # of every pair; none stands for any
    asked: Bool[Tensor, "frames switches"]  # where the cues allow a change


@dataclass(frozen=True)
class _Ends:
    """The segments of the macro-action that a change leaves, parted by how they end."""

    changes: Sequence[Segment]
    others: Sequence[Segment]

    @classmethod
    def of(cls, pair: tuple[int, int], segments: Sequence[Segment]) -> "_Ends":
        left = [one for one in segments if one.macro == pair[0]]
        return cls(
            [one for one in left if one.following == pair[1]],
            [one for one in left if one.following != pair[1]],
        )

    def without(self, left_out: Bool[Tensor, " trajectories"]) -> tuple[list[Segment], list[Segment]]:
        """Both, but for those of trajectories that are left out."""
        kept = (~left_out).tolist()
        changes, others = (
            [one for one in own if kept[one.trajectory]] for own in (self.changes, self.others)
        )
        return changes, others


@stage
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
        groups: trajectories of the same group fall into the same fold; alone by default.
        actions: of every frame, for the cues; without them a switch function may fire after any action.
        on_round: called after every round with the balanced loss and accuracy over all of them.

    All switch functions and all their folds are boosted side by side. The cues and the threshold under which
    a fold's changes count as recognised are chosen by the other folds; the functions that scored those other
    folds have seen this one. With a single trajectory nothing can be left out
    (`SwitchFunctions.left_out` is False).

    Raises ValueError where the learner does not hold a whole number of copies of the frames.
    """
    n_frames, labels = len(labels), labels.cpu()
    copies, rest = divmod(learner.n_frames, n_frames)
    if rest or not copies:
        raise ValueError(f"the learner holds {learner.n_frames} frames and {n_frames} are labelled")
    segments = macro_segments(labels, lengths)
    pairs = tuple(sorted({(one.macro, one.following) for one in segments if one.following is not None}))
    begun = starting_macros(labels, lengths)
    starts = tuple(begun.unique().tolist())
    asking = starts if len(starts) > 1 else ()
    if not pairs and not asking:
        none = torch.zeros(n_frames, 0)
        return SwitchFunctions((), starts, torch.zeros(0), (), torch.zeros(0), none, none, begun, None)
    fold_of = folds_of(len(lengths), settings.folds, generator, groups)
    n_folds = int(fold_of.max()) + 1 if fold_of.any() else 0
    folds = [_fold(fold_of == fold, pairs, segments, lengths, actions) for fold in [*range(n_folds), -1]]
    how = settings.window, settings.whole_past
    weights, targets = zip(
        *(
            examples(pair, segments, fold.left_out, shown, *how, lengths)
            for place, pair in enumerate(pairs)
            for fold in folds
            for shown in [fold.asked[:, place] if settings.focused else torch.ones(n_frames).bool()]
        ),
        *(
            start_examples(start, segments, fold.left_out, n_frames, settings.window)
            for start in asking
            for fold in folds
        ),
        strict=True,
    )
    all_targets = torch.stack(targets, 1).repeat(copies, 1)[:, :, None].to(learner.device)
    boosting = Boosting(learner, all_targets, len(targets), settings.shrinkage, generator)
    base = (torch.stack(weights, 1).repeat(copies, 1) / copies).to(learner.device)
    own_fit = fold_of.clamp(max=max(n_folds - 1, 0)).repeat_interleave(lengths).to(learner.device)
    scored, kept = _boosted(boosting, base, own_fit, len(folds), settings, on_round)
    scores, of_starts = scored.cpu().split([len(pairs), len(asking)], 1)
    scores = scores.masked_fill(~folds[-1].asked, -MARGIN_LIMIT)
    ends = [_Ends.of(pair, segments) for pair in pairs]
    margins = _margins(ends, scored.cpu()[:, : len(pairs)], folds, own_fit.cpu(), settings)
    last = torch.arange(len(folds) - 1, len(targets), len(folds), device=learner.device)
    return SwitchFunctions(
        pairs,
        starts,
        _thresholds(ends, scores, folds[-1].left_out, settings),
        folds[-1].cues if actions is not None else (),
        torch.tensor(
            [
                recognised_share(one.changes, own, settings.tolerance)
                for one, own in zip(ends, margins.T, strict=True)
            ]
        ),
        scores,
        margins,
        torch.tensor(starts)[of_starts[lengths.cumsum(0) - lengths].argmax(1)] if asking else begun,
        boosting.strong(kept).select(last),
        n_folds > 0,
    )


def _fold(
    left_out: Bool[Tensor, " trajectories"],
    pairs: Sequence[tuple[int, int]],
    segments: Sequence[Segment],
    lengths: Int64[Tensor, " trajectories"],
    actions: Int64[Tensor, " frames"] | None,
) -> _Fold:
    """A fold with the cues that the trajectories outside it give."""
    if actions is None or not pairs:
        return _Fold(left_out, (), torch.ones(int(lengths.sum()), len(pairs), dtype=torch.bool))
    inside = [one for one in segments if not left_out[one.trajectory]]
    cues = tuple(cues_of(pair, inside, actions) for pair in pairs)
    return _Fold(left_out, cues, cued(actions, lengths, cues))


def _thresholds(
    ends: Sequence[_Ends],
    scores: Float[Tensor, "frames switches"],
    left_out: Bool[Tensor, " trajectories"],
    settings: SwitchSettings,
) -> Float[Tensor, " switches"]:
    """The threshold of every switch function, chosen by the trajectories that are not left out."""
    if not settings.calibrated:
        return torch.zeros(len(ends))
    found = []
    for one, own in zip(ends, scores.unbind(1), strict=True):
        changes, others = one.without(left_out)
        found.append(best_threshold(changes, own, settings.tolerance, others))
    return torch.tensor(found)


def _margins(
    ends: Sequence[_Ends],
    scored: Float[Tensor, "frames switches"],
    folds: Sequence[_Fold],
    own_fit: Int64[Tensor, " frames"],
    settings: SwitchSettings,
) -> Float[Tensor, "frames switches"]:
    """Left-out scores less the thresholds of the other folds, -inf outside their cues.

    `folds` has all but one that leave something out, and last the one that sees every trajectory.
    """
    result = torch.empty_like(scored)
    for number, fold in enumerate(folds[:-1] or folds):
        asked = scored.masked_fill(~fold.asked, -MARGIN_LIMIT)
        margins = asked - _thresholds(ends, asked, fold.left_out, settings)
        result = torch.where(
            (own_fit == number)[:, None], margins.masked_fill(~fold.asked, -torch.inf), result
        )
    return result


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
