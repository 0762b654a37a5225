"""Given labels in the parts of the search: every segmentation keeps to them."""

from dataclasses import replace

import pytest
import torch
from visible import task_of as classes_task
from visible import visible_change

from dpmacro.discovery.criteria import best_candidate
from dpmacro.discovery.race import raced, taught
from dpmacro.discovery.search import discover
from dpmacro.discovery.settings import SearchSettings
from dpmacro.features.levels import SortedLevels
from dpmacro.segmentation.given import FREE
from dpmacro.segmentation.recursion import segment
from dpmacro.segmentation.segments import transition_counts
from tests.discovery.test_criteria import losses, scored
from tests.discovery.test_starts_vectors import accuracy, task_of, toy  # noqa: F401  a fixture


def with_given(task, labels, *kept):
    """The task with these labels in the trajectories that are kept."""
    place = torch.arange(len(task.lengths)).repeat_interleave(task.lengths)
    return replace(task, given=torch.where(torch.isin(place, torch.tensor(kept)), labels, FREE))


def keeps(labels, task):
    return bool((labels == task.given)[..., task.known.held].all())


def test_costs_and_labellings_stay_as_they_are_where_nothing_is_given():
    _, actions, lengths, truth = visible_change(4)
    task = classes_task(actions, lengths)
    costs = torch.rand(len(truth), 2)
    assert task.held(costs) is costs and task.kept_to(truth[None])[0] is not None
    assert torch.equal(task.kept_to(truth[None])[0], truth)
    assert task.numbered_as(truth).given is None


def test_costs_hold_what_is_given_once_and_several_times_the_frames():
    _, actions, lengths, truth = visible_change(4)
    task = with_given(classes_task(actions, lengths), 1 - truth, 1, 3)
    for times in (1, 3):
        costs = torch.rand(times * len(truth), 2)
        found = segment(task.held(costs), lengths.repeat(times), 1).labels.view(times, -1)
        assert keeps(found, task)
        free = segment(costs, lengths.repeat(times), 1).labels.view(times, -1)
        assert torch.equal(found[:, ~task.known.held], free[:, ~task.known.held])


def test_labellings_are_numbered_as_the_given_ones_where_the_order_is_free():
    _, actions, lengths, truth = visible_change(4)
    task = with_given(classes_task(actions, lengths), truth, 1)
    assert torch.equal(task.kept_to((1 - truth)[None])[0], truth)
    chain = replace(task, order="chain")
    assert torch.equal(chain.kept_to(truth[None])[0], truth)


def test_a_task_numbered_anew_has_the_same_frames_given():
    _, actions, lengths, truth = visible_change(4)
    task = with_given(classes_task(actions, lengths, macros=5), 1 + 3 * truth, 0)
    own = task.numbered_as(truth)
    assert own.macros == 2
    assert torch.equal(own.known.held, task.known.held)
    assert torch.equal(own.given[own.known.held], truth[own.known.held])


def test_what_is_taught_carries_over_to_all_frames():
    data, actions, lengths, truth = visible_change()
    task = classes_task(actions, lengths)
    assert taught(data, task).shape == (0, len(truth))
    task = with_given(task, truth, 2, 5)
    [found] = taught(data, task)
    assert keeps(found, task) and accuracy(found, truth) > 0.9
    [found] = taught(data, replace(task, macros=3))  # nobody showed the third
    assert keeps(found, task)


@pytest.mark.parametrize("order", ["free", "chain"])
def test_a_race_ends_with_starts_that_keep_to_what_is_given(toy, order):  # noqa: F811
    levels, actions, lengths, _ = toy
    wanted = (torch.arange(60) // 9).clamp(max=2).repeat(10)  # not what a race finds
    task = with_given(task_of(actions, lengths, 3, 2, order), wanted, 0, 4)
    found = raced(SortedLevels.build(levels), task, 20)
    assert len(found) and keeps(found, task)
    for row in found:
        assert (transition_counts(row, lengths) <= 2).all()


@pytest.mark.parametrize("criterion", ["causal", "loss"])
def test_every_candidate_of_a_search_keeps_to_what_is_given(criterion):
    data, actions, lengths, truth = visible_change(8)
    moved = (torch.arange(80) >= 12).long().repeat(8)  # before every true change
    task = with_given(classes_task(actions, lengths), 1 - moved, 3)
    settings = replace(SearchSettings(), rounds=6, warmup=2)
    if criterion == "loss":
        settings = replace(SearchSettings.paper(), rounds=6, warmup=2)
    found = discover(data, task, settings, 4, 0.5)
    assert keeps(found.alternated.labels, task)
    for candidate in found.candidates:
        assert keeps(candidate.labels, task)
        assert len(candidate.scores.given) and bool(candidate.scores.given.isfinite().all())
    others = ~task.known.held
    assert accuracy(found.kept.labels[others], truth[others]) > 0.8


def test_what_is_given_is_asked_before_all_else():
    told = scored(causal=0.45, recognised=0.1, hindsight=0.4)
    better = scored(causal=0.1, recognised=1.0, hindsight=0.1)
    for explaining in (False, True):
        assert best_candidate([told, better], explaining) == 1
        pair = [replace(told, given=losses(0.1)), replace(better, given=losses(0.5))]
        assert best_candidate(pair, explaining) == 0
        alike = [replace(one, given=losses(0.1)) for one in (told, better)]
        assert best_candidate(alike, explaining) == 1
