"""Which segmentation to keep, from the demonstrations alone.

Rival segmentations explain the actions equally well (the training loss cannot tell them apart), but the
planner has only images to tell when to change. So every rival is judged much as it would be run: in
trajectories that the fit left out, the switch functions choose the macro-labels frame by frame, without
looking ahead, and the strong classifiers are charged for the actions under those labels. What is left out
are the trajectories of these quick fits; the rival's labels themselves came from all of them.

Where no rival can be run better than a single classifier (the changes cannot be seen), or nothing can be left
out for the switch functions, the rival whose own labels explain left-out frames best is kept.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int64
from torch import Tensor

from dpmacro.boosting.crossfit import LeftOutScores, bounded_deviance, left_out_scores
from dpmacro.boosting.learners.stumps import StumpLearner
from dpmacro.boosting.loop import Round
from dpmacro.features.levels import SortedLevels
from dpmacro.segmentation.marginals import costs_without, margins
from dpmacro.switching.functions import SwitchFunctions, causal_labels, starting_macro
from dpmacro.switching.training import SwitchSettings, fit_switches

__all__ = [
    "Judged",
    "Task",
    "Verdict",
    "best_verdict",
    "confidence",
    "distinct",
    "judge",
    "left_out_charges",
]

FINALISTS = 8  # rivals whose changes are recognised best go on to the dearer test,
LEADERS = 4  # and so many whose training loss is least
SWITCH_ROUNDS = 30
SWITCH_COLUMNS = 512
SCREENING_COLUMNS = 128
MARGIN = 1.0  # of the bounded deviance
RECOGNISED = 0.5  # share of the changes
CLOSE = 2  # standard errors; rivals nearer to the best do equally well
REACH = 5  # frames on either side of one that do not vote on its label
STRETCHES = 8


@dataclass(frozen=True)
class Task:
    """What is to be explained, and what is left out together."""

    actions: Int64[Tensor, " frames"]
    lengths: Int64[Tensor, " trajectories"]
    groups: Int64[Tensor, " trajectories"]  # trajectories of a group are left out together
    n_actions: int
    macros: int
    max_transitions: int
    seed: int

    @property
    def n_groups(self) -> int:
        """How many groups of trajectories there are to leave out."""
        return len(self.groups.unique())


@dataclass(frozen=True)
class Verdict:
    """What left-out data says of a segmentation; losses are bounded deviances in nats a frame."""

    detected: float  # share of changes recognised at their first frame and not before; 0 where there is none
    causal_loss: float  # when switch functions choose the labels
    causal_error: float  # share of frames whose action is wrong, likewise
    hindsight_loss: float  # under the segmentation's own labels
    gain: float  # by how much the causal loss is below that of a single classifier
    gain_error: float  # its standard error over the trajectories
    context_gain: float  # likewise when every frame's label comes from the frames around it, see `_context`
    context_error: float

    @property
    def runnable(self) -> bool:
        """Whether a planner can tell when to change, and does better for it."""
        return self.detected >= RECOGNISED and self.gain > 0


@dataclass(frozen=True)
class Judged:
    """A rival with all that left-out data says of it."""

    labels: Int64[Tensor, " frames"]
    verdict: Verdict
    scores: Float[Tensor, "frames macros actions"]  # by classifiers that never saw the frame
    switches: SwitchFunctions


def judge(
    data: SortedLevels,
    task: Task,
    rivals: Int64[Tensor, "rivals frames"],
    on_round: Callable[[Round], None] = lambda _: None,
) -> list[Judged]:
    """Verdicts on the finalists among rival segmentations, given in the order of their training loss.

    Finalists are the rivals whose changes are recognised best, by quick switch functions, and those of least
    training loss. All get the same folds and random columns, drawn by the task's seed. `on_round` is called
    after every rival's quick switch functions, then after every boosting round of the finalists'
    classifiers, which grow side by side.
    """
    order = _finalists(data, task, rivals, on_round)
    switches = [_switches(data, task, rivals[k], SWITCH_COLUMNS) for k in order]
    scores = left_out_scores(
        data,
        task.actions,
        task.lengths,
        rivals[order],
        task.macros,
        task.n_actions,
        task.seed,
        task.groups,
        on_round,
    )
    return [
        Judged(rivals[k], _verdict(task, rivals[k], found, scores, place), own, found)
        for place, (k, found, own) in enumerate(zip(order, switches, scores.macros, strict=True))
    ]


def best_verdict(verdicts: Sequence[Verdict]) -> int:
    """The number of the verdict to follow.

    Runnable are the rivals half of whose changes, at least, are recognised and that are run better than a
    single classifier. Of those the one of least causal loss, or of those within two standard errors of it the
    one whose changes are recognised best. Where none is runnable, the one of least loss in hindsight.
    """
    runnable = [k for k, verdict in enumerate(verdicts) if verdict.runnable]
    if not runnable:
        return min(range(len(verdicts)), key=lambda k: verdicts[k].hindsight_loss)
    best = min((verdicts[k] for k in runnable), key=lambda verdict: verdict.causal_loss)
    limit = best.causal_loss + CLOSE * best.gain_error
    close = [k for k in runnable if verdicts[k].causal_loss <= limit]
    return max(close, key=lambda k: (verdicts[k].detected, -verdicts[k].causal_loss))


def confidence(judged: Judged, task: Task, labels: Int64[Tensor, " frames"]) -> Float[Tensor, " frames"]:
    """How sure classifiers that never saw a frame are of its label, 0..1.

    1 - exp(-d), d being what the best segmentation with another label at that frame costs them more, in nats
    of bounded deviance; 0 where they want another label.
    """
    charges = left_out_charges(judged, task).double()
    sure = margins(charges, task.lengths, task.max_transitions, labels)
    return -torch.expm1(-sure.clamp(min=0)).float()


def left_out_charges(judged: Judged, task: Task) -> Float[Tensor, "frames macros"]:
    """Bounded deviances, in nats, of every frame under every macro-action's left-out classifiers."""
    targets = torch.nn.functional.one_hot(task.actions.cpu(), task.n_actions).bool()
    return bounded_deviance(judged.scores, targets[:, None], MARGIN)


def distinct(rivals: Int64[Tensor, "rivals frames"], similar: float = 0.99) -> Int64[Tensor, " kept"]:
    """The first of every group of rivals that agree on `similar` of the frames, labels taken as named."""
    kept: list[int] = []
    for k, labels in enumerate(rivals):
        if all(float((labels == rivals[other]).float().mean()) < similar for other in kept):
            kept.append(k)
    return torch.tensor(kept)


def _finalists(
    data: SortedLevels, task: Task, rivals: Int64[Tensor, "rivals frames"], on_round: Callable[[Round], None]
) -> list[int]:
    """The numbers of the rivals that go on to the dearer test; all where they are few."""
    if len(rivals) <= FINALISTS + LEADERS:
        return list(range(len(rivals)))
    shares = []
    for number, labels in enumerate(rivals, 1):
        shares.append(_detected(_switches(data, task, labels, SCREENING_COLUMNS)))
        on_round(Round("recognise", number, len(rivals), 1 - shares[-1], shares[-1], None))
    recognised = sorted(range(len(rivals)), key=lambda k: -shares[k])
    return list(dict.fromkeys([*recognised[:FINALISTS], *range(LEADERS)]))


def _switches(
    data: SortedLevels, task: Task, labels: Int64[Tensor, " frames"], columns: int
) -> SwitchFunctions:
    """Quick switch functions of a rival, `columns` random columns searched a round.

    Without cues: where a change is missed, what the teacher does next gives a chance to notice, in place of
    the chances that a waiting planner has; with cues a single miss would decide a whole trajectory.
    """
    generator = torch.Generator().manual_seed(task.seed)
    learner = StumpLearner(data, drawn=columns)
    settings = SwitchSettings(rounds=SWITCH_ROUNDS)
    return fit_switches(learner, labels, task.lengths, generator, settings, groups=task.groups)


def _detected(switches: SwitchFunctions) -> float:
    return float(switches.detected.mean()) if switches.pairs else 0.0


def _verdict(
    task: Task,
    labels: Int64[Tensor, " frames"],
    switches: SwitchFunctions,
    scores: LeftOutScores,
    place: int,
) -> Verdict:
    """Charges of one rival; where a single group of trajectories leaves nothing out, it cannot be run."""
    frames, actions = torch.arange(len(labels)), task.actions.cpu()
    targets = torch.nn.functional.one_hot(actions, task.n_actions).bool()
    charges = bounded_deviance(scores.macros[place], targets[:, None], MARGIN)
    alone = bounded_deviance(scores.alone, targets, MARGIN)
    in_context = alone - charges[frames, _context(charges, task)]
    if task.n_groups > 1:
        first = starting_macro(labels, task.lengths)
        causal = causal_labels(switches.held_out, switches.thresholds, switches.pairs, task.lengths, first)
        paid = charges[frames, causal]
        wrong = float((scores.macros[place][frames, causal].argmax(1) != actions).float().mean())
        run = float(paid.mean()), wrong
        gain = float((alone - paid).mean()), _standard_error(alone - paid, task)
    else:
        run, gain = (torch.inf, 1.0), (-torch.inf, 0.0)
    return Verdict(
        _detected(switches),
        *run,
        float(charges[frames, labels].mean()),
        *gain,
        float(in_context.mean()),
        _standard_error(in_context, task),
    )


def _context(charges: Float[Tensor, "frames macros"], task: Task) -> Int64[Tensor, " frames"]:
    """The label that the frames around each frame want, it and `REACH` on either side left out.

    A segmentation in hindsight gets better with every macro-action and transition more; what its labels say
    of frames that had no voice in them does not.
    """
    return costs_without(charges.double(), task.lengths, task.max_transitions, REACH).argmin(1)


def _standard_error(gains: Float[Tensor, " frames"], task: Task) -> float:
    """Of the mean gain a frame, over groups of trajectories, or over stretches where groups are few."""
    frames = torch.arange(len(gains))
    part_of = task.groups.repeat_interleave(task.lengths)
    if task.n_groups < STRETCHES:
        part_of = frames * STRETCHES // len(gains)
    parts = part_of.unique(return_inverse=True)[1]
    sums = torch.zeros(int(parts.max()) + 1, dtype=gains.dtype).index_add(0, parts, gains)
    return float(sums.std() * len(sums) ** 0.5 / len(gains))
