"""Macro-actions cut once more: which, in what order, within which bounds; and four that one search misses."""

from dataclasses import replace
from types import SimpleNamespace

import pytest
import torch
from visible import task_of

from dpmacro.discovery import search
from dpmacro.discovery.criteria import CandidateScores, standard_error
from dpmacro.discovery.division import divided, pays
from dpmacro.discovery.search import discover
from dpmacro.discovery.settings import SearchSettings
from dpmacro.features.levels import SortedLevels
from dpmacro.metrics.frames import frame_accuracy

N, LENGTH = 10, 80
LENGTHS = torch.full((N,), LENGTH)
FOUR = torch.arange(LENGTH).repeat(N) // 20
HALVES = FOUR // 2
NUMBERS = torch.arange(N * LENGTH)  # actions by which a search knows the frames it is given
DATA = SortedLevels.build(torch.zeros(1, N * LENGTH, dtype=torch.uint8))


def scores_of(gain, error=0.0, recognised=1.0):
    """Scores with this gain, and this standard error of it."""
    spread = torch.linspace(-1, 1, N)
    saved = gain / N + spread * error / (spread.std() * N**0.5)
    zeros = torch.zeros(N)
    return CandidateScores(recognised, zeros, 0.0, zeros, zeros, saved)


def cuts_of_truth(gains, asked=None):
    """A search that cuts where the truth changes last; `gains` by the macro-action that begins there."""

    def found(_, task):
        own = FOUR[task.actions]
        if asked is not None:
            asked.append((own.unique().tolist(), task.lengths.tolist(), task.groups.tolist()))
            assert (task.macros, task.max_transitions) == (2, 1)
        labels = (own == own.max()).long()
        scores = scores_of(gains[int(own.max())])
        return SimpleNamespace(kept=SimpleNamespace(labels=labels, used=labels.unique(), scores=scores))

    return found


def task_with(macros=4, bound=3):
    return task_of(NUMBERS, LENGTHS, macros, bound)


@pytest.mark.parametrize(
    ("scores", "worth"),
    [
        (scores_of(0.05, 0.04), True),
        (scores_of(0.05, 0.06), False),
        (scores_of(-0.05, 0.0), False),
        (scores_of(0.05, 0.0, recognised=0.4), False),
    ],
)
def test_a_cut_pays_that_can_be_run_and_gains_more_than_a_standard_error(scores, worth):
    assert pays(scores) == worth
    if scores.gain > 0 and scores.runnable:
        assert standard_error(scores.alone - scores.causal) == pytest.approx(0.04 if worth else 0.06)


def test_each_macro_action_is_cut_in_its_own_stretches():
    asked = []
    labels = divided(DATA, task_with(), HALVES, cuts_of_truth({0: -1.0, 1: 0.1, 2: -1.0, 3: 0.1}, asked))
    assert frame_accuracy(labels.numpy(), FOUR.numpy()) == 1.0
    assert asked[:2] == [([0, 1], [40] * N, list(range(N))), ([2, 3], [40] * N, list(range(N)))]


def test_what_was_cut_is_cut_again():
    whole = torch.zeros_like(FOUR)
    labels = divided(DATA, task_with(), whole, cuts_of_truth({1: 0.1, 2: 0.1, 3: 0.1, 0: -1.0}))
    assert frame_accuracy(labels.numpy(), FOUR.numpy()) == 1.0


@pytest.mark.parametrize(("gains", "cut"), [({1: 0.1, 3: 0.2}, 3), ({1: 0.2, 3: 0.1}, 1)])
def test_what_saves_most_comes_first_where_one_more_is_allowed(gains, cut):
    labels = divided(DATA, task_with(macros=3), HALVES, cuts_of_truth(gains))
    assert len(labels.unique()) == 3
    assert bool(((labels == 2) == (cut == FOUR)).all())


def test_a_cut_that_does_not_pay_is_not_made():
    labels = divided(DATA, task_with(), HALVES, cuts_of_truth({1: -0.1, 3: 0.1, 2: -0.1}))
    assert bool(((labels == 2) == (FOUR == 3)).all()) and len(labels.unique()) == 3


@pytest.mark.parametrize("bounds", [{"macros": 2}, {"bound": 1}])
def test_nothing_is_searched_where_nothing_more_is_allowed(bounds):
    asked = []
    assert torch.equal(divided(DATA, task_with(**bounds), HALVES, cuts_of_truth({}, asked)), HALVES)
    assert asked == []


def test_no_trajectory_gets_more_transitions_than_it_may():
    bounded = divided(DATA, task_with(bound=2), HALVES, cuts_of_truth({1: 1.0, 3: 2.0, 2: -1.0}))
    assert len(bounded.unique()) == 3


def test_a_macro_action_of_one_trajectory_is_left_alone():
    """Nothing could be left out to tell whether cutting it pays; its single frames cannot be cut."""
    labels = torch.zeros_like(FOUR)
    labels[:40] = 1
    asked = []
    divided(DATA, task_with(), labels, cuts_of_truth({3: -1.0}, asked))
    assert len(asked) == 1, "the other macro-action's alone"


def four_phases(n=8, length=120):
    """Column k is high for three frames from the k-th change on; columns 4 to 7 decide in turn."""
    generator = torch.Generator().manual_seed(0)
    levels = torch.randint(0, 120, (8, n * length), dtype=torch.uint8, generator=generator)
    truth = torch.zeros(n, length, dtype=torch.int64)
    for row in range(n):
        for change in range(3):
            cut = 30 * (change + 1) + int(torch.randint(-8, 9, (1,), generator=generator))
            truth[row, cut:] = change + 1
            levels[change, row * length + cut : row * length + cut + 3] = 250
    truth = truth.flatten()
    actions = (levels[4 + truth, torch.arange(n * length)] > 60).long()
    return SortedLevels.build(levels), actions, torch.full((n,), length), truth


def test_four_in_a_row_are_found_where_no_candidate_has_more_than_two(monkeypatch):
    data, actions, lengths, truth = four_phases()
    monkeypatch.setattr(search, "_smaller", lambda task: [replace(task, macros=2, max_transitions=1)])
    settings = SearchSettings(rounds=10, warmup=4, drawn=8)
    found = discover(data, task_of(actions, lengths, 4, 3), settings, 6, 0.3)
    assert frame_accuracy(found.kept.labels.numpy(), truth.numpy()) > 0.9
    assert found.best == len(found.candidates) - 1 and found.changes <= 3
