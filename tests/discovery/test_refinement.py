"""Candidates made of candidates: cut again, and with fewer macro-actions."""

from dataclasses import replace

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from visible import functions_of, task_of, visible_change

from dpmacro.boosting.losses.classes import ExponentialLoss
from dpmacro.discovery import refinement
from dpmacro.discovery.candidates import Candidate, action_charges, score_candidates
from dpmacro.discovery.criteria import CandidateScores, best_candidate
from dpmacro.discovery.refinement import (
    COST_LIMIT,
    MERGED,
    SWEEPS,
    _cheapest,
    merged,
    recut,
    resegmented,
    simplified,
)
from dpmacro.discovery.task import Task
from dpmacro.features.levels import SortedLevels
from dpmacro.segmentation.recursion import segment
from dpmacro.segmentation.segments import macro_segments, transition_counts

NONE = CandidateScores(1.0, torch.ones(1), 0.1, torch.ones(1), torch.ones(1), torch.ones(1))


def best(scored):
    return scored[best_candidate([one.scores for one in scored])]


@settings(deadline=None)
@given(st.lists(st.integers(0, 4), min_size=1, max_size=30))
def test_merging_makes_two_macro_actions_one_and_keeps_the_others_apart(labels):
    labels = torch.tensor(labels)
    n_used = len(labels.unique())
    found = merged(labels)
    assert len(found) == (n_used * (n_used - 1) // 2 if n_used > 2 else 0)
    for other in found:
        assert other.unique().tolist() == list(range(n_used - 1))
        # Frames that shared a macro-action still do, and just one pair of macro-actions has become one.
        pairs = {(int(old), int(new)) for old, new in zip(labels, other, strict=True)}
        assert len(pairs) == n_used
    assert len({tuple(other.tolist()) for other in found}) == len(found)


def test_a_macro_action_that_does_not_pay_is_merged_away():
    data, actions, lengths, truth = visible_change()
    place = torch.arange(80).repeat(12)
    idle = torch.where(
        (truth == 1) & (place > 65), 2, truth
    )  # the rule after the change, cut in two by the clock
    task = task_of(actions, lengths, macros=3, bound=2)
    scored = score_candidates(data, task, idle[None])
    found = simplified(scored, data, task)
    assert torch.equal(best(found).labels, truth)
    assert found[0] is scored[0]


def test_macro_actions_that_pay_stay():
    data, actions, lengths, truth = visible_change()
    task = task_of(actions, lengths)
    scored = score_candidates(data, task, truth[None])
    assert simplified(scored, data, task) == scored


def test_cutting_again_adds_candidates_that_are_no_worse():
    data, actions, lengths, truth = visible_change()
    task = task_of(actions, lengths)
    shift = torch.randint(-6, 7, (12,), generator=torch.Generator().manual_seed(0))
    cuts = truth.view(12, 80).argmax(1) + shift
    moved = (torch.arange(80) >= cuts[:, None]).long().flatten()
    scored = score_candidates(data, task, moved[None])
    found = recut(scored, data, task, 1.0)
    assert found[0] is scored[0]
    assert len({tuple(one.labels.tolist()) for one in found}) == len(found) > 1
    assert float((best(found).labels == truth).float().mean()) > float((moved == truth).float().mean())
    assert float(best(found).scores.causal.sum()) < float(scored[0].scores.causal.sum())


def made_up(labels, lengths, macros, switch_scores=None, left_out=None, bound=99, seed=0):
    """A candidate with the switch functions that its changes ask for, all scores random unless given."""
    generator = torch.Generator().manual_seed(seed)
    labels, lengths = torch.as_tensor(labels), torch.tensor(lengths)
    segments = macro_segments(labels, lengths)
    pairs = sorted({(one.macro, one.following) for one in segments if one.following is not None})
    if switch_scores is None:
        switch_scores = 3 * torch.randn(len(labels), len(pairs), generator=generator)
    if left_out is None:
        left_out = torch.randn(len(labels), macros, 2, generator=generator)
    actions = torch.randint(0, 2, (len(labels),), generator=generator)
    task = Task(actions, lengths, torch.arange(len(lengths)), ExponentialLoss(2), macros, bound, seed=0)
    return Candidate(labels, NONE, left_out, torch.ones(2), functions_of(switch_scores, pairs)), task


def misplaced():
    """Actions say nothing within 8 frames of a change at 20, labels place it at 20, 20, 20, 25 and 15."""
    truth = torch.tensor([0] * 20 + [1] * 20).repeat(5)
    labels = torch.cat([(torch.arange(40) >= cut).long() for cut in (20, 20, 20, 25, 15)])
    frame = torch.arange(200) % 40
    switch_scores = torch.where(frame == 20, 2.0, -2.0)[:, None]
    candidate, task = made_up(labels, [40] * 5, 2, switch_scores, bound=1)
    sides = torch.nn.functional.one_hot(task.actions, 2) * 2.0 - 1
    telling = ((frame < 12) | (frame >= 28)).float()
    noise = 0.2 * torch.randn(200, 2, 1, generator=torch.Generator().manual_seed(1))
    own = torch.nn.functional.one_hot(truth, 2)[:, :, None] * 2.0 - 1
    left_out = sides[:, None] * (own * telling[:, None, None] + noise)
    return Candidate(labels, NONE, left_out, torch.ones(2), candidate.switches), task, truth


def deviances_by_hand(candidate, task):
    """Bounded deviances by their formula."""
    right = torch.nn.functional.one_hot(task.actions, 2).bool()[:, None]
    scores = candidate.left_out
    margins = torch.where(right, scores, -scores).clamp(-COST_LIMIT, COST_LIMIT).double()
    return torch.log1p((-2 * margins).exp()).sum(2)


def test_a_visible_change_that_actions_place_badly_is_placed_by_the_switch_functions():
    candidate, task, truth = misplaced()
    by_hand = deviances_by_hand(candidate, task)
    torch.testing.assert_close(
        action_charges(candidate.left_out, task, COST_LIMIT, candidate.scale).double(), by_hand
    )
    alone = resegmented(candidate, task, weight=0.0)
    assert torch.equal(alone, segment(by_hand, task.lengths, 1).labels)
    assert 0 < int((alone != truth).sum()) <= 5 * 8, "the actions say roughly where"
    assert torch.equal(resegmented(candidate, task), truth)


@settings(max_examples=30, deadline=None)
@given(st.integers(2, 4), st.integers(0, 3), st.integers(0, 2**16))
def test_the_bound_is_kept_and_no_looser_than_the_candidate_is(macros, bound, seed):
    generator = torch.Generator().manual_seed(seed)
    labels = torch.randint(0, macros, (30,), generator=generator)
    candidate, task = made_up(labels, [12, 1, 17], macros, bound=bound, seed=seed)
    found = resegmented(candidate, task)
    assert bool((transition_counts(found, task.lengths) <= bound).all())
    assert found.shape == (30,) and int(found.min()) >= 0 and int(found.max()) < macros
    calm, task = made_up((torch.arange(30) >= 20).long(), [12, 1, 17], macros, bound=9, seed=seed)
    assert bool((transition_counts(resegmented(calm, task), task.lengths) <= 1).all())


def test_a_few_misplaced_changes_are_corrected_by_what_was_learned_from_the_others():
    """Column 0 shows the change; columns 1 and 2 decide the action, before and after; near it alike."""
    n, length, misplaced = 12, 60, [3, 8]
    generator = torch.Generator().manual_seed(0)
    levels = torch.randint(0, 120, (6, n, length), dtype=torch.uint8, generator=generator)
    frames = torch.arange(length)
    cuts = torch.randint(20, 40, (n, 1), generator=generator)
    truth = (frames >= cuts).long()
    near = (frames - cuts).abs() < 7
    levels[2, near] = levels[1, near]
    levels[0, (frames >= cuts) & (frames < cuts + 3)] = 250
    cuts[misplaced] += 5
    labels = (frames >= cuts).long()
    actions = (torch.where(truth == 0, levels[1], levels[2]) > 60).long()
    task = Task(
        actions.flatten(), torch.full((n,), length), torch.arange(n), ExponentialLoss(2), 2, 1, seed=0
    )
    (candidate,) = score_candidates(SortedLevels.build(levels.flatten(1)), task, labels.flatten()[None])
    alone, found = (resegmented(candidate, task, weight).view(n, length) for weight in (0.0, 1.0))
    assert int((alone != truth).sum()) > 40
    assert torch.equal(found[misplaced], truth[misplaced])
    assert int((found != truth).sum()) <= 5


def test_of_many_macro_actions_those_are_merged_first_that_do_alike():
    """Macro-actions 1 and 3 have the same classifier: making them one loses nothing."""
    labels = torch.arange(5).repeat_interleave(8).repeat(4)
    generator = torch.Generator().manual_seed(2)
    left_out = torch.randn(len(labels), 5, 2, generator=generator)
    candidate, task = made_up(labels, [40] * 4, 5, left_out=left_out)
    right = torch.nn.functional.one_hot(task.actions, 2) * 4.0 - 2
    own = torch.nn.functional.one_hot(labels, 5)[:, :, None] * right[:, None]
    left_out = own - (1 - torch.nn.functional.one_hot(labels, 5)[:, :, None]) * right[:, None]
    alike = (labels == 1) | (labels == 3)
    left_out[alike, 1] = left_out[alike, 3] = right[alike]
    candidate = replace(candidate, left_out=left_out)
    kept = _cheapest(merged(labels), candidate, task)
    together = torch.where(labels == 3, 1, labels).unique(return_inverse=True)[1]
    assert len(kept) == MERGED < len(merged(labels))
    assert torch.equal(kept[0], together)
    few = merged(labels.clamp(max=3))
    assert _cheapest(few, candidate, task) == few, "of up to four macro-actions all are scored"


@pytest.mark.parametrize(("better", "sweeps"), [(False, 1), (True, SWEEPS)])
def test_cutting_again_goes_on_for_as_long_as_it_helps(monkeypatch, better, sweeps):
    data, actions, lengths, truth = visible_change()
    task = task_of(actions, lengths)
    scored = score_candidates(data, task, truth[None])
    calls = []

    def score(data, task, labels, *_):
        calls.append(len(labels))
        of = scored[0].scores
        causal = of.causal - 0.01 * len(calls) if better else of.causal + 1
        return [replace(scored[0], labels=one, scores=replace(of, causal=causal)) for one in labels]

    monkeypatch.setattr(refinement, "score_candidates", score)
    monkeypatch.setattr(refinement, "resegmented", lambda *_: truth.roll(1 + len(calls)))
    recut(scored, data, task, 1.0)
    assert len(calls) == sweeps
