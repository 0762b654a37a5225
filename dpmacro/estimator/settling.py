"""The final fit: classifiers and switch functions whose own segmentation is the one that they were fitted to.

Fitting changes what is preferred: classifiers and switch functions, once fitted to a segmentation, may want
another one. So they are fitted to what they want until that stays as it is, a few times at most. The labels
that come back are always those which the fitted functions want, exactly; `unsettled` tells on how many frames
the switch functions were fitted to other ones.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float, Int64
from torch import Tensor

from dpmacro.boosting.learners.base import StrongClassifier, WeakLearner
from dpmacro.boosting.loop import Boosting, Round
from dpmacro.boosting.stopping import validated_rounds
from dpmacro.discovery.alternation import alternate
from dpmacro.discovery.task import Task
from dpmacro.estimator.hindsight import CHUNK, SwitchTerms, action_costs, switch_terms_costs
from dpmacro.segmentation.recursion import segment
from dpmacro.segmentation.segments import macro_segments
from dpmacro.switching.alignment import realigned
from dpmacro.switching.costs import SwitchCosts, change_log_odds
from dpmacro.switching.functions import SwitchFunctions
from dpmacro.switching.settings import SwitchSettings
from dpmacro.switching.threshold import recognised_share
from dpmacro.switching.training import fit_switches
from dpmacro.utils.stages import stage

__all__ = ["FinalFit", "Settled", "settle"]

PASSES = 3  # fits, at most
HELD = 0.5  # share of the rounds in which the labels that a fit starts from are held


@dataclass(frozen=True)
class FinalFit:
    """What the final fit learns with.

    Attributes:
        learner: of the strong classifiers.
        switch_learner: of the switch functions; may hold copies of the frames after them.
        rounds: boosting rounds of the strong classifiers.
        shrinkage: factor in (0, 1] on their weak hypotheses.
        early_stopping: whether left-out trajectories say how many of the rounds are kept.
        switches: how the switch functions learn.
        weight: how much they count in the segmentation beside the actions; 0 for nothing.
        held: share of the rounds in which labels are held, 0..1.
    """

    learner: WeakLearner
    switch_learner: WeakLearner
    rounds: int
    shrinkage: float
    early_stopping: bool
    switches: SwitchSettings
    weight: float
    held: float = HELD


@dataclass(frozen=True)
class Settled:
    """The segmentation and what was fitted to it; see the module."""

    labels: Int64[Tensor, " frames"]  # 0..Q-1, each used
    loss: Float[Tensor, " rounds"]  # objective per frame after every round
    classifiers: StrongClassifier  # problems are macro-actions
    switches: SwitchFunctions
    terms: SwitchTerms | None  # how the switch functions joined the costs; None where they did not
    max_transitions: int  # S of the segmentation
    unsettled: int  # frames whose label is not the one that the switch functions were fitted to


def settle(
    fit: FinalFit,
    task: Task,
    labels: Int64[Tensor, " frames"],
    on_round: Callable[[Round], None] = lambda _: None,
    wanted: Callable[[Int64[Tensor, " frames"]], bool] = lambda _: True,
) -> Settled | None:
    """Fit classifiers and switch functions to a segmentation, or to what becomes of it.

    None where that is to be fitted once more and is not `wanted`.

    Args:
        fit: with what.
        task: the actions and what is left out together; its bound holds for the segmentation.
        labels: the segmentation to begin with, 0..Q-1, each used; it keeps to what is given.
        on_round: called after every boosting round.
        wanted: asked of the labels that the first fit ends with.
    """

    def fitted(settings: SwitchSettings, own: Int64[Tensor, " frames"]) -> SwitchFunctions:
        generator = torch.Generator().manual_seed(task.seed)
        actions = task.actions if settings.cues and task.actions.ndim == 1 else None
        settings = replace(settings, tolerance=task.tolerance)
        given = fit.switch_learner, own[None], task.lengths, generator, settings
        [found] = fit_switches(*given, groups=task.groups, actions=actions, on_round=on_round)
        return found

    chosen = labels
    if fit.switches.aligned:
        unfocused = replace(fit.switches, focused=False)
        labels = realigned(lambda own: fitted(unfocused, own), labels, task.lengths)
        labels = labels if task.given is None else task.known.nearest(labels[None])[0]
    rounds = fit.rounds
    if fit.early_stopping:
        held = labels, task.actions, task.lengths, rounds, fit.shrinkage, task.loss
        generator = torch.Generator().manual_seed(task.seed)
        rounds = validated_rounds(fit.learner, *held, generator, task.groups, on_round)
    passes = 0
    while True:
        passes += 1
        n_macros = int(labels.max()) + 1
        switches, terms, costs = None, None, None
        if fit.weight > 0:
            switches = fitted(fit.switches, labels)
            terms = _terms(switches, labels, task, fit.weight)
            costs = _switch_costs(fit.switch_learner, switches, terms, task)
        found, loss, classifiers = _classifiers(
            fit, task.numbered_as(labels), labels, rounds, costs, on_round
        )
        used, pruned = found.unique(return_inverse=True)
        if switches is None:
            switches = fitted(fit.switches, pruned)
            result = Settled(pruned, loss, classifiers.select(used), switches, None, task.max_transitions, 0)
            break
        differing = int((found != labels).sum())
        if differing == 0 or (passes >= PASSES and len(used) == n_macros):
            result = Settled(found, loss, classifiers, switches, terms, task.max_transitions, differing)
            break
        if passes == 1 and not wanted(pruned):
            return None
        names = torch.full((n_macros + 1,), -1)  # the last one for frames that lost theirs before
        names[used] = torch.arange(len(used))
        labels, chosen = pruned, names[chosen]
    if fit.weight > 0:
        return replace(result, switches=_reported(result.switches, chosen, task))
    return result


def _reported(switches: SwitchFunctions, labels: Int64[Tensor, " frames"], task: Task) -> SwitchFunctions:
    """Switch functions whose recognised shares are of the changes as the search had cut them.

    Change points that were moved to where a switch function fires say nothing of it.
    """
    segments = macro_segments(labels, task.lengths)
    shares = []
    for place, pair in enumerate(switches.pairs):
        own = [one for one in segments if (one.macro, one.following) == pair]
        known = recognised_share(own, switches.margins[:, place], task.tolerance) if own else 0.0
        shares.append(known)
    return replace(switches, recognised=torch.tensor(shares))


@stage
def _classifiers(
    fit: FinalFit,
    task: Task,
    labels: Int64[Tensor, " frames"],
    rounds: int,
    costs: SwitchCosts | None,
    on_round: Callable[[Round], None],
) -> tuple[Int64[Tensor, " frames"], Float[Tensor, " rounds"], StrongClassifier]:
    """Strong classifiers by the alternation from `labels`, and the labels that they want in the end."""
    generator = torch.Generator().manual_seed(task.seed)
    targets = task.loss.targets(task.actions)
    boosting = Boosting(fit.learner, targets, task.macros, fit.shrinkage, generator, loss=task.loss)
    given = boosting, task.actions, task.lengths, labels[None], task.macros, task.max_transitions
    ended = alternate(*given, rounds, int(fit.held * rounds), "fit", on_round, costs, task.order, task.held)
    classifiers = boosting.strong()
    shown, chunks = fit.learner.shown(classifiers, len(labels), CHUNK)
    own = action_costs(chunks, shown, task.actions, task.loss)
    changing = None
    if costs is not None:
        own, changing = own + costs.staying.to(own.device), costs.changing.to(own.device)
    held = task.held(own, changing)
    found = segment(held, task.lengths, task.max_transitions, changing, task.order).labels.cpu()
    return found, ended.loss[:, 0], classifiers


def _terms(
    switches: SwitchFunctions, labels: Int64[Tensor, " frames"], task: Task, weight: float
) -> SwitchTerms:
    log_odds = change_log_odds(labels, task.lengths, int(labels.max()) + 1)
    return SwitchTerms(switches.pairs, switches.cues, log_odds, weight)


def _switch_costs(
    learner: WeakLearner, switches: SwitchFunctions, terms: SwitchTerms, task: Task
) -> SwitchCosts | None:
    if switches.classifier is None:
        return None
    shown, chunks = learner.shown(switches.classifier, len(task.actions), CHUNK)
    return switch_terms_costs(chunks, shown, terms, task.actions, task.lengths)
