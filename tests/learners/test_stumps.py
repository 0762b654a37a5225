"""The one-pass search against a plain loop over columns and thresholds, ties included."""

import itertools

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from dpmacro.learners.stumps import LEVELS, SortedLevels, StumpLearner

DEVICES = ["cpu", *(["cuda"] if torch.cuda.is_available() else [])]


def plain_search(levels, weights, targets):
    """First (column, threshold) of least Z, and Z, by a plain loop in float64."""
    best = (np.inf, 0, 0)
    for column, threshold in itertools.product(range(len(levels)), range(LEVELS)):
        z = 0.0
        for side in (levels[column] <= threshold, levels[column] > threshold):
            right = (weights * targets)[side].sum(0)
            wrong = (weights * ~targets)[side].sum(0)
            z += np.sqrt(right * wrong).sum()
        if z < best[0] - 1e-12:
            best = (z, column, threshold)
    return best


@pytest.mark.parametrize("device", DEVICES)
@settings(max_examples=15, deadline=None)
@given(
    seed=st.integers(0, 2**16), n_frames=st.integers(2, 40), n_classes=st.integers(1, 3), coarse=st.booleans()
)
def test_equals_a_plain_loop(device, seed, n_frames, n_classes, coarse):
    rng = np.random.default_rng(seed)
    levels = rng.integers(0, 4 if coarse else LEVELS, (5, n_frames)).astype(np.uint8)
    levels[4] = levels[0]  # a tie between columns: the first must win
    weights = rng.integers(1, 5, (n_frames, 2, n_classes)).astype(np.float32)
    weights[rng.random(n_frames) < 0.3, 1] = 0
    targets = rng.random((n_frames, 1, n_classes)) < 0.5
    learner = StumpLearner(SortedLevels.build(torch.tensor(levels, device=device)), smoothing=0.0)
    stumps = learner.fit(
        torch.tensor(weights, device=device), torch.tensor(targets, device=device), torch.Generator()
    )
    for problem in range(2):
        z, column, _ = plain_search(levels, weights[:, problem].astype(float), targets[:, 0])
        found = int(stumps.columns[problem]), int(stumps.thresholds[problem])
        side = levels[found[0]] <= found[1]
        z_found = sum(
            np.sqrt(
                (weights[:, problem] * targets[:, 0])[half].sum(0)
                * (weights[:, problem] * ~targets[:, 0])[half].sum(0)
            ).sum()
            for half in (side, ~side)
        )
        assert z_found == pytest.approx(z, abs=1e-4)
        if n_classes == 1:  # with one class Z is a single square root a side: no rounding between equals
            assert found[0] <= column or z_found < z


@pytest.mark.parametrize("device", DEVICES)
def test_ties_go_to_the_first_column_and_the_lowest_threshold(device):
    column = torch.tensor([10, 10, 20, 20], dtype=torch.uint8, device=device)
    learner = StumpLearner(SortedLevels.build(column.repeat(3, 1)))
    targets = torch.tensor([True, True, False, False], device=device)[:, None, None]
    stumps = learner.fit(torch.ones(4, 1, 1, device=device), targets, torch.Generator())
    assert (int(stumps.columns[0]), int(stumps.thresholds[0])) == (0, 10)
    assert stumps.votes[0, 0, 0] > 0 > stumps.votes[0, 1, 0]


def test_many_columns_are_searched_in_chunks():
    levels = torch.randint(0, 256, (600, 50), dtype=torch.uint8, generator=torch.Generator().manual_seed(0))
    targets = levels[570, :, None, None] > 100
    stumps = StumpLearner(SortedLevels.build(levels)).fit(torch.ones(50, 1, 1), targets, torch.Generator())
    assert int(stumps.columns[0]) == 570


def test_drawn_columns_restrict_the_search():
    levels = torch.randint(0, 256, (400, 50), dtype=torch.uint8, generator=torch.Generator().manual_seed(0))
    learner = StumpLearner(SortedLevels.build(levels), drawn=10)
    generator, targets = torch.Generator().manual_seed(0), levels[0, :, None, None] > 100
    columns = {int(learner.fit(torch.ones(50, 1, 1), targets, generator).columns[0]) for _ in range(20)}
    assert len(columns) > 5


def test_votes_are_half_the_smoothed_log_odds():
    levels = torch.tensor([[0, 0, 0, 9, 9]], dtype=torch.uint8)
    targets = torch.tensor([True, True, False, False, False])[:, None, None]
    stumps = StumpLearner(SortedLevels.build(levels), smoothing=0.5).fit(
        torch.ones(5, 1, 1), targets, torch.Generator()
    )
    expected = torch.tensor([(2.5 / 1.5), (0.5 / 2.5)]).log() / 2
    torch.testing.assert_close(stumps.votes[0, :, 0], expected)


def test_a_problem_without_frames_gets_no_votes():
    learner = StumpLearner(SortedLevels.build(torch.tensor([[0, 9]], dtype=torch.uint8)))
    targets = torch.tensor([True, False])[:, None, None]
    stumps = learner.fit(torch.zeros(2, 1, 1), targets, torch.Generator())
    assert (stumps.votes == 0).all()


def test_a_strong_classifier_sums_its_rounds_and_survives_renumbering():
    levels = torch.randint(0, 256, (30, 40), dtype=torch.uint8, generator=torch.Generator().manual_seed(1))
    learner = StumpLearner(SortedLevels.build(levels))
    generator = torch.Generator().manual_seed(2)
    rounds, total = [], torch.zeros(40, 2, 3)
    for _ in range(4):
        weights = torch.rand(40, 2, 3, generator=generator)
        targets = torch.rand(40, 1, 3, generator=generator) < 0.5
        rounds.append(learner.fit(weights, targets, generator))
        total += learner.outputs(rounds[-1])
    strong = learner.strong(rounds)
    torch.testing.assert_close(strong.scores(levels), total)
    torch.testing.assert_close(strong.scaled(0.5).scores(levels), total / 2)
    torch.testing.assert_close(strong.select(torch.tensor([1])).scores(levels), total[:, 1:])
    used = strong.used_columns()
    torch.testing.assert_close(strong.renumbered(used).scores(levels[used]), total)
