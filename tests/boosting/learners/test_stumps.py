"""The one-pass search against a plain loop over columns and thresholds, ties included."""

import itertools

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from dpmacro.boosting.learners.base import Frames
from dpmacro.boosting.learners.stumps import StumpClassifier, StumpLearner
from dpmacro.boosting.learners.sweep import sweep
from dpmacro.boosting.losses.vectors import HuberLoss
from dpmacro.features import levels as module
from dpmacro.features.levels import LEVELS, SortedLevels

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


def z_of(stumps, problem, levels, weights, targets):
    """Z / 2 of the stump that was found, in float64."""
    below = levels[int(stumps.columns[problem])] <= int(stumps.thresholds[problem])
    right, wrong = weights * targets, weights * ~targets
    return sum(np.sqrt(right[side].sum(0) * wrong[side].sum(0)).sum() for side in (below, ~below))


@pytest.mark.parametrize("device", DEVICES)
@settings(max_examples=25, deadline=None)
@given(
    seed=st.integers(0, 2**16),
    n_frames=st.integers(2, 40),
    n_classes=st.integers(1, 3),
    n_levels=st.sampled_from([1, 2, 4, LEVELS]),
    whole=st.booleans(),
    block=st.sampled_from([7, module.BLOCK]),
)
def test_equals_a_plain_loop(device, seed, n_frames, n_classes, n_levels, whole, block):
    rng = np.random.default_rng(seed)
    levels = rng.integers(0, n_levels, (5, n_frames)).astype(np.uint8)
    levels[4] = levels[0]  # a tie between columns: the first must win
    levels[3, : n_frames // 2] = 200  # a bin that holds half of the frames
    weights = rng.integers(1, 5, (n_frames, 2, n_classes)) if whole else rng.random((n_frames, 2, n_classes))
    weights = weights.astype(np.float32)
    weights[rng.random(n_frames) < 0.3, 1] = 0
    targets = rng.random((n_frames, 1, n_classes)) < 0.5
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "BLOCK", block)
        learner = StumpLearner(SortedLevels.build(torch.tensor(levels, device=device)), smoothing=0.0)
    stumps, _ = learner.fit(
        torch.tensor(weights, device=device), torch.tensor(targets, device=device), torch.Generator()
    )
    for problem in range(2):
        own = weights[:, problem].astype(float), targets[:, 0]
        z, column, threshold = plain_search(levels, *own)
        found = z_of(stumps, problem, levels, *own)
        assert int(stumps.columns[problem]) != 4
        assert found == pytest.approx(z, abs=2e-3 * own[0].sum() ** 0.5)
        if whole and n_classes == 1 and found == z:  # one class, whole weights: no rounding between equals
            assert int(stumps.columns[problem]) == column
            below, plainly = levels[column] <= int(stumps.thresholds[problem]), levels[column] <= threshold
            if not plainly.all() and plainly.any():  # levels that no frame has are not searched
                assert (below == plainly).all()


@pytest.mark.parametrize("option", [{"drawn": 40}, {"reuse": 3}, {"drawn": 40, "reuse": 2}])
def test_what_is_traded_is_only_which_columns_are_searched(option):
    generator = torch.Generator().manual_seed(3)
    levels = torch.randint(0, 256, (40, 60), dtype=torch.uint8, generator=generator)
    weights, targets = torch.rand(60, 2, 3, generator=generator), torch.rand(60, 1, 3) < 0.5
    exact, _ = StumpLearner(SortedLevels.build(levels)).fit(weights, targets, generator)
    for data in (SortedLevels.build(levels), SortedLevels.unsorted(levels)):
        if not data.is_sorted and "drawn" not in option:
            continue
        learner, memory = StumpLearner(data, **option), None
        for _ in range(3):
            stumps, memory = learner.fit(weights, targets, generator, memory)
            assert torch.equal(stumps.columns, exact.columns)
            assert torch.equal(stumps.thresholds, exact.thresholds)
            torch.testing.assert_close(stumps.votes, exact.votes)


@pytest.mark.parametrize("device", DEVICES)
def test_ties_go_to_the_first_column_and_the_lowest_threshold(device):
    column = torch.tensor([10, 10, 20, 20], dtype=torch.uint8, device=device)
    learner = StumpLearner(SortedLevels.build(column.repeat(3, 1)))
    targets = torch.tensor([True, True, False, False], device=device)[:, None, None]
    stumps, _ = learner.fit(torch.ones(4, 1, 1, device=device), targets, torch.Generator())
    assert (int(stumps.columns[0]), int(stumps.thresholds[0])) == (0, 10)
    assert stumps.votes[0, 0, 0] > 0 > stumps.votes[0, 1, 0]


def test_many_columns_are_searched_in_chunks():
    levels = torch.randint(0, 256, (600, 50), dtype=torch.uint8, generator=torch.Generator().manual_seed(0))
    targets = levels[570, :, None, None] > 100
    learner = StumpLearner(SortedLevels.build(levels))
    stumps, _ = learner.fit(torch.ones(50, 1, 1), targets, torch.Generator())
    assert int(stumps.columns[0]) == 570


def test_drawn_columns_restrict_the_search():
    levels = torch.randint(0, 256, (400, 50), dtype=torch.uint8, generator=torch.Generator().manual_seed(0))
    learner = StumpLearner(SortedLevels.build(levels), drawn=10)
    generator, targets = torch.Generator().manual_seed(0), levels[0, :, None, None] > 100
    columns = {int(learner.fit(torch.ones(50, 1, 1), targets, generator)[0].columns[0]) for _ in range(20)}
    assert len(columns) > 5


def test_votes_are_half_the_smoothed_log_odds():
    levels = torch.tensor([[0, 0, 0, 9, 9]], dtype=torch.uint8)
    targets = torch.tensor([True, True, False, False, False])[:, None, None]
    stumps, _ = StumpLearner(SortedLevels.build(levels), smoothing=0.5).fit(
        torch.ones(5, 1, 1), targets, torch.Generator()
    )
    expected = torch.tensor([(2.5 / 1.5), (0.5 / 2.5)]).log() / 2
    torch.testing.assert_close(stumps.votes[0, :, 0], expected)


def test_a_problem_without_frames_gets_no_votes():
    learner = StumpLearner(SortedLevels.build(torch.tensor([[0, 9]], dtype=torch.uint8)))
    targets = torch.tensor([True, False])[:, None, None]
    stumps, _ = learner.fit(torch.zeros(2, 1, 1), targets, torch.Generator())
    assert (stumps.votes == 0).all()


def test_a_strong_classifier_sums_its_rounds_and_survives_renumbering():
    levels = torch.randint(0, 256, (30, 40), dtype=torch.uint8, generator=torch.Generator().manual_seed(1))
    learner = StumpLearner(SortedLevels.build(levels))
    generator = torch.Generator().manual_seed(2)
    rounds, total = [], torch.zeros(40, 2, 3)
    for _ in range(4):
        weights = torch.rand(40, 2, 3, generator=generator)
        targets = torch.rand(40, 1, 3, generator=generator) < 0.5
        rounds.append(learner.fit(weights, targets, generator)[0])
        total += learner.outputs(rounds[-1])
    frames, steps = Frames(levels), torch.ones(4, 2)
    strong = learner.strong(rounds, steps)
    torch.testing.assert_close(strong.scores(frames), total)
    torch.testing.assert_close(learner.strong(rounds, steps / 2).scores(frames), total / 2)
    torch.testing.assert_close(strong.select(torch.tensor([1])).scores(frames), total[:, 1:])
    used = strong.used_columns()
    torch.testing.assert_close(strong.renumbered(used).scores(Frames(levels[used])), total)


def test_rounds_that_reuse_a_search_look_at_its_best_columns_only():
    generator = torch.Generator().manual_seed(0)
    levels = torch.randint(0, 256, (300, 80), dtype=torch.uint8, generator=generator)
    learner = StumpLearner(SortedLevels.build(levels), reuse=3)
    targets, memory, sizes = levels[7, :, None, None] > 100, None, []
    for _ in range(4):
        stumps, memory = learner.fit(torch.rand(80, 1, 1, generator=generator), targets, generator, memory)
        sizes.append(None if memory is None else len(memory.data.columns))
        assert int(stumps.columns[0]) == 7
    assert sizes == [64, 64, None, 64]


@pytest.mark.parametrize("option", [{"reuse": 0}, {"drawn": -1}])
def test_options_out_of_range_are_named(option):
    with pytest.raises(ValueError, match=r"reuse is \S+ and drawn"):
        StumpLearner(SortedLevels.build(torch.zeros(2, 3, dtype=torch.uint8)), **option)


def test_columns_that_are_not_sorted_can_only_be_drawn():
    with pytest.raises(ValueError, match="drawn is 0 but no column is sorted"):
        StumpLearner(SortedLevels.unsorted(torch.zeros(2, 3, dtype=torch.uint8)))


def test_importances_are_the_steps_of_the_votes_on_each_column():
    votes = torch.zeros(3, 2, 2, 2)
    votes[0, 0] = torch.tensor([[1.0, -1.0], [-0.5, 2.0]])  # steps of 1.5 and 3
    votes[1, 0, 1] = torch.tensor([0.25, 0.0])
    votes[2, 1] = 7.0  # the same on both sides: no step
    columns = torch.tensor([[4, 0], [4, 1], [2, 3]])
    strong = StumpClassifier(columns, torch.zeros(3, 2, dtype=torch.uint8), votes)
    assert strong.importances(5).tolist() == [[0, 0, 0, 0, 4.75], [0] * 5]
    assert strong.select(torch.tensor([1, 0])).importances(6)[1, 4] == 4.75


@pytest.mark.parametrize("bins", [1, 5, 64])
def test_sums_up_to_the_thresholds_of_bins_taken_together(bins):
    generator = torch.Generator().manual_seed(bins)
    levels = torch.randint(0, 256, (6, 400), dtype=torch.uint8, generator=generator)
    levels[:, :90] = 17  # the fullest level has neighbours in its bin
    weights = torch.rand(400, 2, 1, generator=generator)
    responses = torch.randn(400, 2, 3, generator=generator)
    loss = HuberLoss(3)
    rows = loss.table(weights, responses)
    first = 0
    for chunk, below, _ in sweep(SortedLevels.build(levels), weights, responses, loss, bins=bins):
        assert below.shape[1] <= bins
        for column, thresholds in enumerate(chunk.thresholds):
            for place, threshold in enumerate(thresholds.tolist()):
                expected = rows[levels[first + column] <= threshold].sum(0)
                torch.testing.assert_close(below[column, place], expected, atol=1e-3, rtol=1e-4)
        first += len(chunk.thresholds)
    assert first == len(levels)
