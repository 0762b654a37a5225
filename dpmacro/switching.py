"""Switch functions: when to leave a macro-action, learned from the change points of a segmentation.

For every observed change q -> q' a binary strong classifier H_q^q' (Section IV of the paper) separates the J
frames from the change on (positives) from the frames of q (negatives), both sides weighing the same. Its
threshold is calibrated on trajectories that its training left out. A planner knows what it has just done: a
switch function may fire only after an action that comes before its changes in demonstrations, its cues, and
learns only from frames after such an action: what tells a change from a turn need not tell it from a step.
"""

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int64
from torch import Tensor

from dpmacro.boosting import MARGIN_LIMIT, Boosting, Round, exponentials_of
from dpmacro.folds import folds_of
from dpmacro.learners import StrongClassifier, WeakLearner
from dpmacro.stopping import BestRound

__all__ = [
    "Event",
    "SwitchFunctions",
    "causal_labels",
    "cued",
    "fit_switches",
    "macro_segments",
    "starting_macro",
]

COVERED = 0.75  # of the changes, by their cues
FOLDS = 5  # of trajectories; one function for each leaves it out, one more sees all


@dataclass(frozen=True)
class SwitchFunctions:
    """One switch function for every observed change, the same order throughout."""

    pairs: list[tuple[int, int]]  # (from, to)
    thresholds: Float[Tensor, " switches"]
    detected: Float[
        Tensor, " switches"
    ]  # share of left-out segments in which it fires at the change, never before
    held_out: Float[
        Tensor, "frames switches"
    ]  # score of every frame by a function that never saw its trajectory, -18 where it may not fire
    classifier: StrongClassifier | None  # one binary problem per switch; None where nothing ever changes
    cues: tuple[tuple[int, ...], ...] = ()  # actions that each may follow; none stands for any


@dataclass(frozen=True)
class Event:
    """A segment of a macro-action and what follows it, in frames of the concatenated data."""

    trajectory: int
    macro: int
    start: int
    stop: int
    following: int | None  # the next macro-action; None at the end of the trajectory
    following_stop: int  # end of the next segment; `stop` where there is none


def macro_segments(labels: Int64[Tensor, " frames"], lengths: Int64[Tensor, " trajectories"]) -> list[Event]:
    """The segments of constant macro-label, in order, each with its successor in the trajectory."""
    events = []
    first = 0
    for trajectory, part in enumerate(labels.cpu().split(lengths.tolist())):
        macros, counts = part.unique_consecutive(return_counts=True)
        bounds = (counts.cumsum(0) + first).tolist()
        starts = [first, *bounds[:-1]]
        for k, macro in enumerate(macros.tolist()):
            follows = k + 1 < len(bounds)
            following = int(macros[k + 1]) if follows else None
            events.append(Event(trajectory, macro, starts[k], bounds[k], following, bounds[k + follows]))
        first = bounds[-1]
    return events


def starting_macro(labels: Int64[Tensor, " frames"], lengths: Int64[Tensor, " trajectories"]) -> int:
    """The macro-action that most trajectories start with."""
    starts = torch.nn.functional.pad(lengths.cumsum(0)[:-1], (1, 0)).to(labels.device)
    return int(labels[starts].mode().values)


def fit_switches(
    learner: WeakLearner,
    labels: Int64[Tensor, " frames"],
    lengths: Int64[Tensor, " trajectories"],
    generator: torch.Generator,
    window: int = 3,
    rounds: int = 60,
    shrinkage: float = 0.2,
    folds: int = FOLDS,
    early_stopping: bool = False,
    groups: Int64[Tensor, " trajectories"] | None = None,
    on_round: Callable[[Round], None] = lambda _: None,
    actions: Int64[Tensor, " frames"] | None = None,
    focused: bool = True,
) -> SwitchFunctions:
    """Fit a switch function for every change of macro-label that the trajectories show.

    Args:
        learner: finds the weak hypotheses; holds the frames, and copies of all of them after them if
            any, like mirror images: examples too, of which no threshold or cue is taken.
        labels, lengths: the segmentation.
        window: J >= 1, the positive frames from a change on. Later ones show what the next macro-action
            does, which a planner that waits for the change never sees: with J = 10 a correction near the
            flag passes for the change.
        rounds: boosting rounds.
        shrinkage: factor in (0, 1] on every weak hypothesis.
        folds: parts that trajectories are dealt into by `generator`; each part is scored by a switch function
            that never saw it. The threshold is the middle of the widest range in which most left-out
            segments fire at the first frame of their change and not before.
        groups: trajectories of the same group fall into the same part, like mirror images; alone by default.
        early_stopping: whether every switch function keeps the rounds with the least loss on left-out parts.
        on_round: called after every round with the balanced loss and accuracy over all of them.
        actions: of every frame, for the cues; without them a switch function may fire after any action.
        focused: whether frames after other actions than the cues are no examples. Where some changes are
            a frame or two late all frames are better ones: the true change is then taken for a frame before.

    All switch functions and all their folds are boosted side by side. With a single trajectory nothing can
    be left out, and the calibration uses the training scores.

    Raises ValueError where the learner does not hold a whole number of copies of the frames.
    """
    if window < 1 or rounds < 1:
        raise ValueError(f"window is {window} and rounds {rounds}: both must be 1 or more")
    if folds < 2:
        raise ValueError(f"folds is {folds}: give 2 or more, so that something can be left out")
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
    shown = asked if focused else torch.ones_like(asked)
    fold_of = folds_of(len(lengths), folds, generator, groups)
    n_fits = int(fold_of.max()) + 2 if fold_of.any() else 1  # the last one sees every trajectory
    weights, targets = zip(
        *(
            _examples(pair, events, fold_of == fold, own, window)
            for pair, own in zip(pairs, shown.unbind(1), strict=True)
            for fold in [*range(n_fits - 1), -1]
        ),
        strict=True,
    )
    n_problems = len(pairs) * n_fits
    all_targets = torch.stack(targets, 1).repeat(copies, 1)[:, :, None].to(learner.device)
    boosting = Boosting(learner, all_targets, n_problems, shrinkage, generator)
    base = (torch.stack(weights, 1).repeat(copies, 1) / copies).to(learner.device)
    own_fit = fold_of.clamp(max=n_fits - 1).repeat_interleave(lengths).to(learner.device)
    last = torch.arange(n_fits - 1, n_problems, n_fits, device=learner.device)
    stopping, kept = BestRound(rounds), None
    held_out = torch.zeros(n_frames, len(pairs), device=learner.device)
    for number in range(1, rounds + 1):
        ended = boosting.round(base)
        right = ((boosting.scores > 0) == boosting.targets)[:, :, 0]
        accuracy = float((base * right).sum() / n_problems)
        loss = float((base * boosting.losses()).sum() / n_problems)
        over = tuple(int(k) // n_fits for k in ended if int(k) % n_fits == n_fits - 1)
        on_round(Round("switch", number, rounds, loss, accuracy, None, ended=over))
        scores = boosting.scores[:n_frames, :, 0].unflatten(1, (len(pairs), n_fits))
        scores = scores.gather(2, own_fit[:, None, None].expand(-1, len(pairs), 1)).squeeze(2)
        costs = exponentials_of(scores[:, :, None], boosting.targets[:n_frames, last])[:, :, 0]
        exhausted = stopping.exhausted((base[:n_frames, last] * costs).sum(0))
        if early_stopping:
            kept = stopping.best.repeat_interleave(n_fits)
            held_out = torch.where(stopping.best == number, scores, held_out)
        else:
            held_out = scores
        if bool(boosting.ended.all()) or (early_stopping and exhausted):
            break
    held_out = held_out.cpu().masked_fill(~asked, -MARGIN_LIMIT)
    calibrated = [_calibrate(_peaks(pair, events, held_out[:, p])) for p, pair in enumerate(pairs)]
    thresholds, detected = torch.tensor(calibrated).unbind(1)
    return SwitchFunctions(pairs, thresholds, detected, held_out, boosting.strong(kept).select(last), cues)


def cued(
    actions: Int64[Tensor, " frames"],
    lengths: Int64[Tensor, " trajectories"],
    cues: Sequence[Sequence[int]],
) -> Bool[Tensor, "frames switches"]:
    """Whether each switch function may fire at a frame; none may at the first of a trajectory."""
    actions = actions.cpu()
    before = torch.nn.functional.pad(actions[:-1], (1, 0), value=-1)
    before[(lengths.cumsum(0) - lengths).cpu()] = -1
    return torch.stack([torch.isin(before, torch.tensor(own)) for own in cues], 1)


def causal_labels(
    scores: Float[Tensor, "frames switches"],
    thresholds: Float[Tensor, " switches"],
    pairs: list[tuple[int, int]],
    lengths: Int64[Tensor, " trajectories"],
    first_macro: int,
) -> Int64[Tensor, " frames"]:
    """The macro-labels that the switch functions choose as they run, frame by frame, never looking ahead."""
    labels = torch.full((len(scores),), first_macro, dtype=torch.int64)
    for start, length in zip((lengths.cumsum(0) - lengths).tolist(), lengths.tolist(), strict=True):
        stop, frame, macro = start + length, start, first_macro
        while True:
            own = torch.tensor([source == macro for source, _ in pairs], dtype=torch.bool)
            excess = (scores[frame:stop] - thresholds)[:, own]
            firing = (excess > 0).any(1).nonzero()
            if not len(firing):
                break
            frame += int(firing[0])
            macro = [pair for pair in pairs if pair[0] == macro][int(excess[int(firing[0])].argmax())][1]
            labels[frame:stop] = macro
            frame += 1
    return labels


def _examples(
    pair: tuple[int, int],
    events: list[Event],
    left_out: Bool[Tensor, " trajectories"],
    shown: Bool[Tensor, " frames"],
    window: int,
) -> tuple[Float[Tensor, " frames"], Bool[Tensor, " frames"]]:
    """Base weights, half a side, and targets of a switch function that never sees what is left out."""
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


def _cues(pair: tuple[int, int], events: list[Event], actions: Int64[Tensor, " frames"]) -> tuple[int, ...]:
    """The actions that come right before most changes of a pair, the fewest that cover `COVERED` of them.

    Not all: a segmentation that is a frame or two late has the action after the change there.
    """
    before = [event.stop - 1 for event in events if (event.macro, event.following) == pair]
    counts = actions.cpu()[before].bincount()
    order = counts.argsort(descending=True, stable=True)
    enough = int((counts[order].cumsum(0) < COVERED * len(before)).sum()) + 1
    return tuple(sorted(order[:enough].tolist()))


def _peaks(
    pair: tuple[int, int], events: list[Event], scores: Float[Tensor, " frames"]
) -> list[tuple[float, float]]:
    """Highest score before the change and the score at its first frame, for every segment that the pair ends.

    Only the first frame counts: a planner that has not changed by then will not see the frames that follow.
    """
    return [
        (float(scores[event.start : event.stop].max()), float(scores[event.stop]))
        for event in events
        if (event.macro, event.following) == pair
    ]


def _calibrate(peaks: list[tuple[float, float]]) -> tuple[float, float]:
    """The threshold under which most segments are left in time, and the share of them that are.

    A segment is left in time where before <= threshold < at. The middle of the widest best range wins; where
    no threshold serves any segment, zero, the switch function's own decision boundary, stands.
    """
    levels = sorted({value for peak in peaks for value in peak})
    ranges = [
        (sum(before <= low and high <= at for before, at in peaks), high - low, (low + high) / 2)
        for low, high in itertools.pairwise(levels)
    ]
    in_time, _, threshold = max(ranges, default=(0, 0.0, 0.0))
    return (threshold, in_time / len(peaks)) if in_time else (0.0, 0.0)
