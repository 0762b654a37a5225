"""Candidate segmentations, scored on left-out data from the demonstrations alone.

Candidates explain the actions equally well (the training loss cannot tell them apart), but a policy has only
observations to tell when to change. So every candidate is scored much as it would be run: in trajectories
that the fit left out, switch functions choose the macro-labels frame by frame, without looking ahead, and the
strong classifiers are charged for the actions under those labels. What is left out are the trajectories of
these quick fits; a candidate's labels themselves came from all of them.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int64
from torch import Tensor

from dpmacro.boosting.crossfit import LeftOutScores, left_out_scores
from dpmacro.boosting.learners.stumps import StumpLearner
from dpmacro.boosting.loop import Round
from dpmacro.discovery.criteria import CandidateScores, equally_good, part_sums
from dpmacro.discovery.task import Task
from dpmacro.features.levels import SortedLevels
from dpmacro.segmentation.marginals import costs_without, margins
from dpmacro.segmentation.segments import transition_counts
from dpmacro.switching.functions import SwitchFunctions, causal_labels
from dpmacro.switching.settings import SWITCH_FOLDS, SwitchSettings
from dpmacro.switching.training import fit_switches
from dpmacro.utils.stages import stage

__all__ = [
    "Candidate",
    "action_charges",
    "confidence",
    "left_out_charges",
    "score_candidates",
]

FINALISTS = 8  # candidates whose changes are recognised best go on to the dearer test,
LEADERS = 4  # and so many whose training loss is least
SWITCH_ROUNDS = 30
PROBLEMS = 256  # switch functions, in all their folds, that are boosted side by side
SWITCH_COLUMNS = 512
SCREENING_COLUMNS = 128
SCREENING_FOLDS = 2
CHARGE_LIMIT = 1.0  # at which charges are cut off: a margin of classes, two deviations of vectors
REACH = 5  # frames on either side of one that do not vote on its label


@dataclass(frozen=True)
class Candidate:
    """A segmentation with all that left-out data says of it."""

    labels: Int64[Tensor, " frames"]
    scores: CandidateScores
    left_out: Float[Tensor, "frames macros outputs"]  # scores by classifiers that never saw the frame
    scale: Float[Tensor, " outputs"]  # deviation of the baseline's left-out residuals
    switches: SwitchFunctions

    @property
    def used(self) -> Int64[Tensor, " used"]:
        """The macro-actions that have frames, ascending."""
        return self.labels.unique()

    def transitions(self, lengths: Int64[Tensor, " trajectories"]) -> int:
        """The most transitions that it has in any trajectory."""
        return int(transition_counts(self.labels, lengths).max())


def score_candidates(
    data: SortedLevels,
    task: Task,
    candidates: Int64[Tensor, "candidates frames"],
    on_round: Callable[[Round], None] = lambda _: None,
) -> list[Candidate]:
    """Scores of the finalists among candidates, which are given in the order of their training loss.

    Finalists are, of classes, the candidates whose changes are recognised best, by quick switch functions,
    and those of least training loss; of vectors those of least loss in hindsight on left-out data, and no
    others can be kept (`criteria.best_candidate`). All get
    the same folds and random columns, drawn by the task's seed. `on_round` is called after every candidate's
    quick switch functions, then after every boosting round of classifiers, which grow side by side.
    """

    def fit(some: Int64[Tensor, "some frames"]) -> LeftOutScores:
        given = data, task.actions, task.lengths, some, task.macros, task.loss, task.seed, task.groups
        return left_out_scores(*given, on_round)

    if task.vectors:
        fitted = fit(candidates)
        order = _explaining(task, candidates, fitted)
        fitted = LeftOutScores(fitted.macros[order], fitted.alone)
    else:
        order = _recognised(data, task, candidates, on_round)
        fitted = fit(candidates[order])
    switches = list(_switches(data, task, candidates[order], SWITCH_COLUMNS))
    scale = task.loss.scale(fitted.alone, task.actions.cpu())
    return [
        Candidate(candidates[k], _scores(task, candidates[k], found, fitted, place, scale), own, scale, found)
        for place, (k, found, own) in enumerate(zip(order, switches, fitted.macros, strict=True))
    ]


def confidence(
    candidate: Candidate, task: Task, labels: Int64[Tensor, " frames"]
) -> Float[Tensor, " frames"]:
    """How sure classifiers that never saw a frame are of its label, 0..1.

    1 - exp(-d), d being what the best segmentation with another label at that frame costs them more, in nats
    of bounded deviance; 0 where they want another label. Only macro-actions that have frames count, and no
    more transitions than the candidate has in any trajectory: a bound that the labels do not use leaves room
    for excursions that nobody proposed. A label that is given is sure, 1, and every segmentation keeps to it.
    """
    used = candidate.used
    charges = task.held(left_out_charges(candidate, task))[:, used].double()
    places = torch.searchsorted(used, labels)
    sure = margins(charges, task.lengths, candidate.transitions(task.lengths), places, order=task.order)
    sure = -torch.expm1(-sure.clamp(min=0)).float()
    return sure if task.given is None else sure.masked_fill(task.known.held, 1.0)


def left_out_charges(candidate: Candidate, task: Task) -> Float[Tensor, "frames macros"]:
    """Bounded charges, in nats, of every frame under every macro-action's left-out classifiers."""
    return action_charges(candidate.left_out, task, CHARGE_LIMIT, candidate.scale)


def action_charges(
    scores: Float[Tensor, "frames problems outputs"],
    task: Task,
    limit: float,
    scale: Float[Tensor, " outputs"],
) -> Float[Tensor, "frames problems"]:
    """What left-out scores are charged for the actions, in nats; see `Loss.charge`."""
    return task.loss.charge(scores, task.loss.targets(task.actions.cpu()), limit, scale)


def _explaining(
    task: Task, candidates: Int64[Tensor, "candidates frames"], fitted: LeftOutScores
) -> list[int]:
    """The numbers of the candidates that may be kept, ascending: those of least left-out loss in hindsight.

    They are those that do as well as the best by it, of which switch functions are to tell the one to keep,
    `LEADERS` at least and `FINALISTS + LEADERS` at most. Where labels are given their loss is asked first
    (`criteria.best_candidate`), so all may be kept.
    """
    scale, frames = task.loss.scale(fitted.alone, task.actions.cpu()), torch.arange(len(task.actions))
    losses = [
        part_sums(
            action_charges(scores[frames, labels][:, None], task, CHARGE_LIMIT, scale)[:, 0],
            task.lengths,
            task.groups,
        )
        for scores, labels in zip(fitted.macros, candidates, strict=True)
    ]
    good = set(range(len(losses)) if task.given is not None else equally_good(losses))
    order = sorted(range(len(losses)), key=lambda k: float(losses[k].sum()))
    kept = [k for rank, k in enumerate(order) if rank < LEADERS or k in good]
    return sorted(kept[: FINALISTS + LEADERS])


@stage
def _recognised(
    data: SortedLevels,
    task: Task,
    candidates: Int64[Tensor, "candidates frames"],
    on_round: Callable[[Round], None],
) -> list[int]:
    """The numbers of the candidates that go on to the dearer test; all where they are few."""
    if len(candidates) <= FINALISTS + LEADERS:
        return list(range(len(candidates)))
    shares: list[float] = []
    for found in _switches(data, task, candidates, SCREENING_COLUMNS, SCREENING_FOLDS):
        shares.append(found.mean_recognised)
        on_round(Round("recognise", len(shares), len(candidates), 1 - shares[-1], shares[-1], None))
    recognised = sorted(range(len(candidates)), key=lambda k: -shares[k])
    return list(dict.fromkeys([*recognised[:FINALISTS], *range(LEADERS)]))


def _switches(
    data: SortedLevels,
    task: Task,
    candidates: Int64[Tensor, "candidates frames"],
    columns: int,
    folds: int = SWITCH_FOLDS,
) -> Iterator[SwitchFunctions]:
    """Quick switch functions of candidates, `columns` random columns searched a round, without cues.

    On a demonstration a switch function that missed its change gets another chance from the frames that the
    demonstrator's next actions bring about. With cues a single miss would decide a whole trajectory.
    """
    learner = StumpLearner(data, drawn=columns)
    settings = SwitchSettings(rounds=SWITCH_ROUNDS, folds=folds, tolerance=task.tolerance)
    most = task.macros * (task.macros - 1) + task.macros  # changes and starts of one candidate
    for some in candidates.split(max(PROBLEMS // ((folds + 1) * most), 1)):
        generator = torch.Generator().manual_seed(task.seed)
        yield from fit_switches(learner, some, task.lengths, generator, settings, groups=task.groups)


def _scores(
    task: Task,
    labels: Int64[Tensor, " frames"],
    switches: SwitchFunctions,
    fitted: LeftOutScores,
    place: int,
    scale: Float[Tensor, " outputs"],
) -> CandidateScores:
    """Scores of one candidate; where a single group of trajectories leaves nothing out, it cannot be run."""
    frames, actions = torch.arange(len(labels)), task.actions.cpu()
    charges = action_charges(fitted.macros[place], task, CHARGE_LIMIT, scale)
    alone = action_charges(fitted.alone[:, None], task, CHARGE_LIMIT, scale)[:, 0]
    paid, wrong = torch.full_like(alone, torch.inf), 1.0
    if task.n_groups > 1:
        causal = causal_labels(switches.margins, switches.pairs, task.lengths, switches.first)
        paid = charges[frames, causal]
        wrong = task.loss.error(fitted.macros[place][frames, causal], actions)
    told = charges[frames, _context(charges, labels, task)]
    own = charges[frames, labels]
    parts = [part_sums(each, task.lengths, task.groups) for each in (paid, own, told, alone)]
    causal_parts, hindsight, context, alone_parts = parts
    given = None if task.given is None else _given_parts(own, task, task.known.held)
    return CandidateScores(
        switches.mean_recognised, causal_parts, wrong, hindsight, context, alone_parts, given
    )


def _given_parts(
    charges: Float[Tensor, " frames"], task: Task, held: Bool[Tensor, " frames"]
) -> Float[Tensor, " parts"]:
    """What the frames are charged whose labels are given, in parts."""
    counts = torch.stack([part.sum() for part in held.split(task.lengths.tolist())])
    return part_sums(charges[held], counts[counts > 0], task.groups[counts > 0])


def _context(
    charges: Float[Tensor, "frames macros"], labels: Int64[Tensor, " frames"], task: Task
) -> Int64[Tensor, " frames"]:
    """The label that the frames around each frame want, it and `REACH` on either side left out.

    A segmentation in hindsight gets better with every macro-action and transition more; what its labels say
    of frames that had no voice in them does not. Only what the labels use counts, in macro-actions and in
    transitions, so that the answer does not depend on how much more was allowed.
    """
    used = labels.unique()
    bound = int(transition_counts(labels, task.lengths).max())
    return used[
        costs_without(charges[:, used].double(), task.lengths, bound, REACH, order=task.order).argmin(1)
    ]
