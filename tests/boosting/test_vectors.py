"""Boosting of vectors: Huber's loss against its formula, its stumps against a plain search."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from dpmacro.boosting.learners.base import Frames
from dpmacro.boosting.learners.convnet import ConvNetLearner
from dpmacro.boosting.learners.stumps import StumpLearner
from dpmacro.boosting.loop import Boosting
from dpmacro.boosting.losses.vectors import LOSSES, RIDGE, HuberLoss
from dpmacro.features.levels import SortedLevels

DEVICES = ["cpu", *(["cuda"] if torch.cuda.is_available() else [])]
DELTAS = list(LOSSES.values())
SMOOTHING = 0.5  # the stump learner's


def rho(residuals, delta):
    """Huber's function (1964), as it is written."""
    return np.where(np.abs(residuals) <= delta, residuals**2 / 2, delta * (np.abs(residuals) - delta / 2))


def problem(seed, frames=40, columns=5, problems=2, dims=3):
    rng = np.random.default_rng(seed)
    levels = rng.integers(0, 8, (columns, frames)).astype(np.uint8)
    actions = rng.standard_normal((frames, dims)).astype(np.float32) * 2
    base = rng.integers(0, 3, (frames, problems)).astype(np.float32)
    base[0] = 1  # every problem has a frame
    return levels, actions, base


def plain_search(levels, residuals, base):
    """The least loss of any stump with ridged means as votes, and that stump."""
    held = base > 0
    ridge = RIDGE * SMOOTHING * base.sum() / held.sum()
    found = []
    for column, values in enumerate(levels):
        for threshold in np.unique(values):
            sides = values <= threshold, values > threshold
            sums = [(base[side, None] * residuals[side]).sum(0) for side in sides]
            weights = [base[side].sum() + ridge for side in sides]
            gain = sum((part**2).sum() / weight for part, weight in zip(sums, weights, strict=True))
            votes = [part / weight for part, weight in zip(sums, weights, strict=True)]
            found.append((-gain / 2, column, int(threshold), votes))
    return min(found, key=lambda one: one[:3])


@pytest.mark.parametrize("delta", DELTAS)
def test_costs_are_hubers(delta):
    scores = torch.randn(30, 2, 3, generator=torch.Generator().manual_seed(0)) * 3
    targets = torch.randn(30, 1, 3, generator=torch.Generator().manual_seed(1)) * 3
    found = HuberLoss(3, delta).terms(scores, targets)
    wanted = rho((targets - scores).double().numpy(), delta)
    torch.testing.assert_close(found.double(), torch.from_numpy(wanted), rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("device", DEVICES)
@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 2**16), delta=st.sampled_from(DELTAS))
def test_the_stump_found_is_the_best_there_is(device, seed, delta):
    levels, actions, base = problem(seed)
    loss = HuberLoss(3, delta)
    scores = torch.zeros(40, 2, 3)
    targets = loss.targets(torch.from_numpy(actions))
    given_ = loss.working(loss.terms(scores, targets), scores, targets, torch.from_numpy(base))
    learner = StumpLearner(SortedLevels.build(torch.from_numpy(levels).to(device)), smoothing=SMOOTHING)
    stumps, _ = learner.fit(*(part.to(device) for part in given_), torch.Generator(), loss=loss)
    residuals = np.clip(actions.astype(np.float64), -delta, delta)
    for own in range(2):
        value, _, _, _ = plain_search(levels, residuals, base[:, own])
        column, threshold = int(stumps.columns[own]), int(stumps.thresholds[own])
        ridge = RIDGE * SMOOTHING * base[:, own].sum() / (base[:, own] > 0).sum()
        found = 0.0
        for place, side in enumerate((levels[column] <= threshold, levels[column] > threshold)):
            sums = (base[side, own, None] * residuals[side]).sum(0)
            weight = base[side, own].sum() + ridge
            found -= (sums**2).sum() / weight / 2
            np.testing.assert_allclose(stumps.votes[own, place].cpu(), sums / weight, rtol=1e-3, atol=1e-4)
        assert found == pytest.approx(value, rel=1e-4)


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 2**16), delta=st.sampled_from(DELTAS), shrinkage=st.sampled_from([0.1, 0.5, 1.0]))
def test_the_loss_never_rises(seed, delta, shrinkage):
    levels, actions, base = problem(seed)
    loss = HuberLoss(3, delta)
    learner = StumpLearner(SortedLevels.build(torch.from_numpy(levels)))
    targets, generator = loss.targets(torch.from_numpy(actions)), torch.Generator().manual_seed(0)
    boosting = Boosting(learner, targets, 2, shrinkage, generator, loss=loss)
    weights, before = torch.from_numpy(base), torch.inf
    for _ in range(12):
        boosting.round(weights)
        now = float((weights * boosting.losses()).double().sum())
        assert now <= before * (1 + 1e-6)
        before = now
    strong = boosting.strong()
    torch.testing.assert_close(
        strong.scores(Frames(learner.data.levels)), boosting.scores, rtol=1e-4, atol=1e-4
    )


def test_a_vector_that_columns_tell_is_learned():
    generator = torch.Generator().manual_seed(0)
    levels = torch.randint(0, 256, (6, 500), dtype=torch.uint8, generator=generator)
    actions = torch.stack([(levels[0] > 128).float() * 2 - 1, levels[1].float() / 128 - 1], 1)
    loss = HuberLoss(2)
    boosting = Boosting(
        StumpLearner(SortedLevels.build(levels)), loss.targets(actions), 1, 0.2, generator, loss=loss
    )
    for _ in range(150):
        boosting.round(torch.ones(500, 1))
    assert loss.error(boosting.scores[:, 0], actions) < 0.02


def test_networks_learn_vectors_too():
    generator = torch.Generator().manual_seed(0)
    images = torch.randint(0, 60, (60, 8, 8, 3), dtype=torch.uint8, generator=generator)
    bright = torch.arange(60) % 2 == 0
    images[bright] += 190
    actions = torch.stack([bright.float() * 2 - 1, 1 - bright.float() * 2], 1)
    learner = ConvNetLearner(images, torch.arange(60), epochs=8, channels=(4, 4))
    loss = HuberLoss(2)
    boosting = Boosting(learner, loss.targets(actions), 1, 0.5, generator, loss=loss)
    for _ in range(8):
        boosting.round(torch.ones(60, 1))
    assert loss.error(boosting.scores[:, 0], actions) < 0.3


def test_left_out_residuals_are_charged_in_their_own_deviations_and_bounded():
    loss, actions = HuberLoss(2), torch.tensor([[0.0, 0], [3, 0], [0, -30]])
    scale = loss.scale(torch.zeros(3, 2), actions)
    torch.testing.assert_close(scale, (actions**2).mean(0).sqrt())
    charges = loss.charge(torch.zeros(3, 1, 2), loss.targets(actions), 1.0, torch.tensor([3.0, 3]))
    torch.testing.assert_close(charges[:, 0], torch.tensor([0.0, 0.5, 2.0]))
    more = loss.charge(torch.zeros(3, 1, 2), loss.targets(actions), 3.0, torch.tensor([3.0, 3]))
    torch.testing.assert_close(more[:, 0], torch.tensor([0.0, 0.5, 18.0]))
    assert loss.per_nat(torch.tensor([0.5, 1.0])) == pytest.approx(0.625)


def test_the_error_is_the_variance_that_is_not_explained():
    actions = torch.tensor([[1.0, -1], [-1, 1]])
    loss = HuberLoss(2)
    assert loss.error(torch.zeros(2, 2), actions) == 1.0
    assert loss.error(actions, actions) == 0.0
    assert loss.error(actions / 2, actions) == pytest.approx(0.25)
    assert loss.error(actions * 9, actions) == 1.0, "worse than nothing is no worse than 1"
