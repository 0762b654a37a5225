"""Switch functions learned from the change points of a segmentation (Section IV of the paper).

H_q^q' separates the J frames from a change on (positives) from the frames before it (negatives), both sides
weighing the same. Where it may fire only after its cues, it learns only from frames after them. Its
threshold is chosen by the scores of functions that never saw the trajectory.
"""

from collections.abc import Callable, Sequence

import torch
from jaxtyping import Bool, Float, Int64
from torch import Tensor

from dpmacro.boosting.folds import folds_of
from dpmacro.boosting.learners.base import StrongClassifier, WeakLearner
from dpmacro.boosting.loop import Boosting, Round
from dpmacro.boosting.losses.classes import MARGIN_LIMIT, exponentials_of
from dpmacro.boosting.stopping import BestRound
from dpmacro.switching.functions import SwitchFunctions
from dpmacro.switching.settings import SwitchSettings
from dpmacro.switching.threshold import best_threshold, recognised_share
from dpmacro.switching.wanted import Ends, Fold, Wanted
from dpmacro.utils.stages import stage

__all__ = ["fit_switches"]


@stage
def fit_switches(
    learner: WeakLearner,
    labellings: Int64[Tensor, "labellings frames"],
    lengths: Int64[Tensor, " trajectories"],
    generator: torch.Generator,
    settings: SwitchSettings,
    groups: Int64[Tensor, " trajectories"] | None = None,
    actions: Int64[Tensor, " frames"] | None = None,
    on_round: Callable[[Round], None] = lambda _: None,
) -> tuple[SwitchFunctions, ...]:
    """Fit a switch function for every change of macro-label that the trajectories show.

    Args:
        learner: finds the weak hypotheses; holds the frames, and copies of all of them after them if
            any, like mirror images: examples too, of which no threshold or cue is taken.
        labellings: segmentations, each of which gets functions of its own, on the same draws. With early
            stopping there can be one only: that looks at all switch functions together.
        lengths: of the trajectories.
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
    n_frames, labellings = labellings.shape[1], labellings.cpu()
    copies, rest = divmod(learner.n_frames, n_frames)
    if rest or not copies:
        raise ValueError(f"the learner holds {learner.n_frames} frames and {n_frames} are labelled")
    assert len(labellings) == 1 or not settings.early_stopping, "they would wait for one another"
    fold_of = folds_of(len(lengths), settings.folds, generator, groups)
    n_folds = int(fold_of.max()) + 1 if fold_of.any() else 0
    numbers = [*range(n_folds), -1]
    wanted = [Wanted.of(labels, lengths, fold_of, numbers, settings, actions) for labels in labellings]
    targets = [target for one in wanted for target in one.targets]
    if not targets:
        return tuple(_without_changes(one, n_frames) for one in wanted)
    weights = [weight for one in wanted for weight in one.weights]
    all_targets = torch.stack(targets, 1).repeat(copies, 1)[:, :, None].to(learner.device)
    boosting = Boosting(learner, all_targets, len(targets), settings.shrinkage, generator)
    base = (torch.stack(weights, 1).repeat(copies, 1) / copies).to(learner.device)
    own_fit = fold_of.clamp(max=max(n_folds - 1, 0)).repeat_interleave(lengths).to(learner.device)
    scored, kept = _boosted(boosting, base, own_fit, len(numbers), settings, on_round)
    last = torch.arange(len(numbers) - 1, len(targets), len(numbers), device=learner.device)
    strong, sizes = boosting.strong(kept), [one.switches for one in wanted]
    parts = zip(wanted, scored.cpu().split(sizes, 1), last.split(sizes), strict=True)
    return tuple(
        _functions(one, own, lengths, own_fit.cpu(), settings, strong.select(places))
        if one.switches
        else _without_changes(one, n_frames)
        for one, own, places in parts
    )


def _without_changes(wanted: Wanted, n_frames: int) -> SwitchFunctions:
    """Of a segmentation without any change, whose trajectories begin alike."""
    none, nothing = torch.zeros(n_frames, 0), torch.zeros(0)
    return SwitchFunctions((), wanted.starts, nothing, (), nothing, none, none, wanted.begun, None)


def _functions(
    wanted: Wanted,
    scored: Float[Tensor, "frames switches"],
    lengths: Int64[Tensor, " trajectories"],
    own_fit: Int64[Tensor, " frames"],
    settings: SwitchSettings,
    classifier: StrongClassifier,
) -> SwitchFunctions:
    """A segmentation's switch functions, their thresholds, and what they are worth.

    `scored` is what every frame's own fit says, first of changes, then of starts.
    """
    pairs, asking, folds = wanted.pairs, wanted.asking, wanted.folds
    scores, of_starts = scored.split([len(pairs), len(asking)], 1)
    scores = scores.masked_fill(~folds[-1].asked, -MARGIN_LIMIT)
    margins = _margins(wanted.ends, scored[:, : len(pairs)], folds, own_fit, settings)
    told = zip(wanted.ends, margins.T, strict=True)
    first = wanted.begun
    if asking:
        first = torch.tensor(wanted.starts)[of_starts[lengths.cumsum(0) - lengths].argmax(1)]
    return SwitchFunctions(
        pairs,
        wanted.starts,
        _thresholds(wanted.ends, scores, folds[-1].left_out, settings),
        folds[-1].cues,
        torch.tensor([recognised_share(one.changes, own, settings.tolerance) for one, own in told]),
        scores,
        margins,
        first,
        classifier,
        len(folds) > 1,
    )


def _thresholds(
    ends: Sequence[Ends],
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
    ends: Sequence[Ends],
    scored: Float[Tensor, "frames switches"],
    folds: Sequence[Fold],
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
