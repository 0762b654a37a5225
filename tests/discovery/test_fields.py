"""Which trajectories are searched where there are many, and what they say of the others."""

from dataclasses import replace

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from visible import task_of as classes_task
from visible import visible_change

from dpmacro.discovery import fields
from dpmacro.discovery.fields import extended, field_of
from dpmacro.discovery.model_order import choose
from dpmacro.discovery.refinement import fewer
from dpmacro.discovery.search import adopt, discover, spread
from dpmacro.discovery.settings import SearchSettings
from dpmacro.features.levels import SortedLevels
from dpmacro.segmentation.segments import transition_counts
from tests.discovery.test_given import keeps, with_given
from tests.discovery.test_order import ordered
from tests.discovery.test_starts_vectors import accuracy, task_of, toy  # noqa: F401  a fixture

QUICK = SearchSettings(rounds=10, warmup=4, drawn=6)


@pytest.fixture
def small(monkeypatch):
    """Fields of three trajectories of 60 frames."""
    monkeypatch.setattr(fields, "FRAMES", 150)
    monkeypatch.setattr(fields, "TRAJECTORIES", 2)


@pytest.mark.parametrize(
    ("count", "length", "drawn"),
    [
        (20, 1_000, 20),  # as many as are wanted, whatever their length
        (30, 1_000, 20),
        (78, 230, 27),  # more, for the frames
        (500, 50, 120),
        (500, 5_000, 5),  # fewer, for the frames
        (3, 90_000, 1),
    ],
)
def test_how_many_trajectories_are_searched(count, length, drawn):
    assert int(fields.drawn_of(torch.full((count,), length), 0).sum()) == drawn


@settings(deadline=None)
@given(
    st.lists(st.integers(1, 40), min_size=1, max_size=30),
    st.integers(1, 300),
    st.integers(1, 8),
    st.integers(0, 5),
)
def test_a_field_has_whole_trajectories_and_enough_of_them(lengths, frames, trajectories, seed):
    lengths = torch.tensor(lengths)
    n_frames = int(lengths.sum())
    levels = torch.arange(n_frames, dtype=torch.uint8)[None]
    task = replace(classes_task(torch.arange(n_frames), lengths), seed=seed)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(fields, "FRAMES", frames)
        patch.setattr(fields, "TRAJECTORIES", trajectories)
        field = field_of(SortedLevels.build(levels), task)
        again = field_of(SortedLevels.build(levels), replace(task, macros=5, max_transitions=7))
    assert len(field.task.lengths) >= min(trajectories, len(lengths))
    assert int(field.task.lengths.sum()) >= min(frames, n_frames)
    if field.drawn is None:
        assert field.task is task
        return
    assert not bool(field.drawn.all()) and torch.equal(field.drawn, again.drawn)
    places = field.drawn.repeat_interleave(lengths).nonzero()[:, 0]
    assert torch.equal(field.task.lengths, lengths[field.drawn])
    assert torch.equal(field.task.groups, task.groups[field.drawn])
    assert torch.equal(field.task.actions, task.actions[places])
    assert torch.equal(field.data.levels, levels[:, places])


def test_columns_are_sorted_where_all_of_the_data_are(small):
    data, actions, lengths, _ = visible_change(n=8, length=60)
    part = field_of(data, classes_task(actions, lengths)).data
    assert len(part.columns) == len(data.columns) > 0
    bare = SortedLevels.unsorted(data.levels)
    assert len(field_of(bare, classes_task(actions, lengths)).data.columns) == 0


def test_trajectories_with_given_labels_are_searched_first(small):
    data, actions, lengths, truth = visible_change(n=8, length=60)
    for kept in ((0, 7), (3, 4)):
        task = with_given(classes_task(actions, lengths), truth, *kept)
        field = field_of(data, task)
        assert bool(field.drawn[list(kept)].all()) and int(field.drawn.sum()) == 3
        assert keeps(truth[field.drawn.repeat_interleave(lengths)], field.task)


@pytest.mark.parametrize("order", ["free", "chain"])
def test_labels_of_a_field_carry_over_to_all_frames(toy, small, order):  # noqa: F811
    levels, actions, lengths, truth = toy
    data, task = SortedLevels.build(levels), task_of(actions, lengths, 3, 2, order)
    field = field_of(data, task)
    assert int(field.drawn.sum()) == 3
    labels = extended(data, task, field, truth[field.drawn.repeat_interleave(lengths)])
    assert float((labels == truth).float().mean()) > 0.95
    assert (transition_counts(labels, lengths) <= 2).all()
    if order == "free":
        few = extended(data, task, field, truth[field.drawn.repeat_interleave(lengths)], 1)
        assert (transition_counts(few, lengths) <= 1).all()


def test_macro_actions_without_frames_are_not_given_away(small):
    data, actions, lengths, truth = visible_change(n=8, length=60)
    task = classes_task(actions, lengths, 4, 3)
    field = field_of(data, task)
    labels = extended(data, task, field, 1 + 2 * truth[field.drawn.repeat_interleave(lengths)])
    assert labels.unique().tolist() == [1, 3]
    assert float((labels == 1 + 2 * truth).float().mean()) > 0.95


@pytest.mark.parametrize("vectors", [False, True])
def test_a_search_in_a_field_is_spread_over_all(toy, small, vectors):  # noqa: F811
    if vectors:
        levels, actions, lengths, truth = toy
        data, task = SortedLevels.build(levels), task_of(actions, lengths, 3, 2)
    else:
        data, actions, lengths, truth = visible_change(n=8, length=60)
        task = classes_task(actions, lengths)
    reports = []
    found = discover(data, task, QUICK, 8, 0.3, reports.append)
    assert reports and all(report.labels is None for report in reports)  # they would be of some frames
    assert int(found.drawn.sum()) == 3 and len(found.kept.labels) == 180
    whole = spread(data, task, found, QUICK)
    assert whole.drawn is None and whole.task is task and len(whole.candidates) <= 1 + 4 * 3
    searched = found.drawn.repeat_interleave(lengths)
    assert accuracy(whole.kept.labels[searched], found.kept.labels) > 0.95
    assert accuracy(whole.kept.labels, truth) > accuracy(found.kept.labels, truth[searched]) - 0.05
    assert spread(data, task, whole, QUICK) is whole


def test_the_recipe_of_the_paper_sees_all_trajectories(small):
    data, actions, lengths, _ = visible_change(n=8, length=60)
    paper = replace(SearchSettings.paper(), rounds=6)
    found = discover(data, classes_task(actions, lengths), paper, 4, 0.3)
    assert found.drawn is None and len(found.kept.labels) == 480


def test_ever_fewer_macro_actions_of_the_best():
    data, task = ordered([(0, 1, 2)] * 10)  # three linear rules, each for 30 frames
    place = torch.arange(90).repeat(10)
    truth = place // 30
    fine = torch.where((truth == 1) & (place >= 45), 3, truth)  # the second rule in halves
    found = adopt(data, replace(task, macros=4, max_transitions=6), fine)
    three, two = fewer(data, found)
    assert [one.macros for one in (three, two)] == [3, 2]
    assert 4 <= len(three.candidates) <= 6 and accuracy(three.kept.labels, truth) == 1
    assert three.max_transitions == 2 and len(two.candidates) == 3
    assert fewer(data, adopt(data, replace(task, macros=2), (truth > 0).long())) == []
    assert choose([found, three, two]).setting == (3, 2)
