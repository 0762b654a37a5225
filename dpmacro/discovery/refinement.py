"""Candidates made of candidates: what switch functions make of the best, and fewer macro-actions."""

import itertools
from collections.abc import Callable, Sequence
from dataclasses import replace

import torch
from jaxtyping import Int64
from torch import Tensor

from dpmacro.boosting.loop import Round
from dpmacro.discovery.candidates import Candidate, action_charges, left_out_charges, score_candidates
from dpmacro.discovery.criteria import best_candidate
from dpmacro.discovery.result import Discovery
from dpmacro.discovery.task import Task
from dpmacro.features.levels import SortedLevels
from dpmacro.segmentation.recursion import segment
from dpmacro.switching.costs import change_log_odds, charges_of

__all__ = ["REFINED", "fewer", "merged", "recut", "resegmented", "simplified"]

SWEEPS = 3  # in which switch functions cut, at most
MERGED = 6  # segmentations with two macro-actions made one that are scored at a time: all of up to four
REFINED = 4  # candidates anew in each
COST_LIMIT = 3.0  # at which the charges of actions are cut off, likewise later than for selection


def recut(
    scored: Sequence[Candidate],
    data: SortedLevels,
    task: Task,
    weight: float,
    on_round: Callable[[Round], None] = lambda _: None,
) -> list[Candidate]:
    """The candidates, and the best of them cut again with the costs of their switch functions.

    That is repeated for as long as the best of all is among the new ones, `SWEEPS` times at most.
    `weight` is how much the switch functions count beside the actions, above 0.
    """
    scored = list(scored)
    fresh = list(scored)
    for _ in range(SWEEPS):
        fresh.sort(key=lambda one: _promise(one, task))
        chosen, fresh = fresh[:REFINED], fresh[REFINED:]
        again = _unknown([resegmented(one, task, weight) for one in chosen], scored)
        if not again:
            break
        found = score_candidates(data, task, torch.stack(again), on_round)
        known, scored, fresh = len(scored), scored + found, fresh + found
        if best_candidate([one.scores for one in scored], task.vectors) < known:
            break
    return scored


def _promise(candidate: Candidate, task: Task) -> tuple[bool, float]:
    """By which candidates are ordered, the most promising first: as they are chosen, but for equals."""
    if candidate.scores.given is not None:
        return False, float(candidate.scores.given.sum())
    if task.vectors:
        return False, float(candidate.scores.hindsight.sum())
    return not candidate.scores.runnable, float(candidate.scores.causal.sum())


def resegmented(candidate: Candidate, task: Task, weight: float = 1.0) -> Int64[Tensor, " frames"]:
    """The segmentation that left-out classifiers and left-out switch functions of a candidate agree on.

    It has no more transitions in a trajectory than the candidate has in any. `weight` is how much the switch
    functions count beside the actions. On their own training data switch functions recognise any few changes,
    so the scores are those of functions that never saw the trajectory.
    """
    costs = action_charges(candidate.left_out, task, COST_LIMIT, candidate.scale).double()
    log_odds = change_log_odds(candidate.labels, task.lengths, task.macros)
    switches = candidate.switches
    extra = charges_of(switches.scores, switches.pairs, log_odds, task.lengths, weight)
    bound = min(task.max_transitions, candidate.transitions(task.lengths))
    held = replace(task, max_transitions=bound).held(costs + extra.staying, extra.changing)
    return segment(held, task.lengths, bound, extra.changing, task.order).labels


def simplified(
    scored: Sequence[Candidate],
    data: SortedLevels,
    task: Task,
    on_round: Callable[[Round], None] = lambda _: None,
) -> list[Candidate]:
    """The candidates, and the best of them with two macro-actions made one, for as long as that is better.

    One macro-action more always lowers the training loss. On left-out data it has to pay for the changes into
    and out of it, which a policy may miss.
    """
    scored = list(scored)
    while True:
        best = best_candidate([one.scores for one in scored], task.vectors)
        simpler = _unknown(_cheapest(merged(scored[best].labels), scored[best], task), scored)
        if not simpler:
            return scored
        scored += score_candidates(data, task, torch.stack(simpler), on_round)
        if best_candidate([one.scores for one in scored], task.vectors) == best:
            return scored


def fewer(
    data: SortedLevels, found: Discovery, on_round: Callable[[Round], None] = lambda _: None
) -> list[Discovery]:
    """The segmentation to keep with ever fewer macro-actions, down to two: two are made one each time.

    Each step makes those two one that left-out data prefers as one; S is then what is left of transitions.
    `data` are the levels of the frames that were searched.
    """
    results: list[Discovery] = []
    kept, task = found.kept, found.task
    while len(kept.used) > 2:
        labellings = _cheapest(merged(kept.labels), kept, task)
        task = replace(task, macros=len(kept.used) - 1)
        candidates = score_candidates(data, task, torch.stack(labellings), on_round)
        best = best_candidate([one.scores for one in candidates], task.vectors)
        kept = candidates[best]
        task = replace(task, max_transitions=kept.transitions(task.lengths))
        results.append(replace(found, task=task, candidates=tuple(candidates), best=best))
    return results


def _cheapest(
    labellings: Sequence[Int64[Tensor, " frames"]], candidate: Candidate, task: Task
) -> list[Int64[Tensor, " frames"]]:
    """The merged segmentations that lose least where either of the two macro-actions serves for both.

    `MERGED` of them at most: of many macro-actions there are too many pairs to score all.
    """
    if len(labellings) <= MERGED:
        return list(labellings)
    charges = left_out_charges(candidate, task)
    lost = []
    for labels in labellings:
        of_macro = torch.stack([charges[labels == macro].sum(0) for macro in labels.unique().tolist()])
        lost.append(float(of_macro.amin(1).sum()))
    order = sorted(range(len(lost)), key=lost.__getitem__)[:MERGED]
    return [labellings[place] for place in order]


def merged(labels: Int64[Tensor, " frames"]) -> list[Int64[Tensor, " frames"]]:
    """Every segmentation in which two macro-actions are one, of two or more; numbered 0, 1, ... anew.

    None for two macro-actions: one alone is no segmentation.
    """
    used = labels.unique().tolist()
    if len(used) < 3:
        return []
    return [
        torch.where(labels == second, first, labels).unique(return_inverse=True)[1]
        for first, second in itertools.combinations(used, 2)
    ]


def _unknown(
    labellings: Sequence[Int64[Tensor, " frames"]], scored: Sequence[Candidate]
) -> list[Int64[Tensor, " frames"]]:
    """Those that were not scored yet, each once."""
    known, fresh = [one.labels for one in scored], []
    for labels in labellings:
        if not any(torch.equal(labels, other) for other in known):
            known.append(labels)
            fresh.append(labels)
    return fresh
