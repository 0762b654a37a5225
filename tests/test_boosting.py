"""The boosting loop: what theory says of its loss, and that its scores are those of the strong classifier."""

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from dpmacro.boosting import MARGIN_LIMIT, Boosting, class_targets
from dpmacro.learners.stumps import SortedLevels, StumpLearner

DEVICES = ["cpu", *(["cuda"] if torch.cuda.is_available() else [])]


def problem(seed, device="cpu", n_frames=80, n_classes=3):
    generator = torch.Generator().manual_seed(seed)
    levels = torch.randint(0, 256, (12, n_frames), dtype=torch.uint8, generator=generator)
    labels = torch.randint(0, n_classes, (n_frames,), generator=generator)
    base = torch.randint(0, 3, (n_frames, 4), generator=generator).float()
    return StumpLearner(SortedLevels.build(levels.to(device))), labels.to(device), base.to(device)


@pytest.mark.parametrize("device", DEVICES)
@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 2**16), shrinkage=st.sampled_from([0.05, 0.3, 1.0]))
def test_the_loss_of_every_problem_never_rises_with_weights_held(device, seed, shrinkage):
    learner, labels, base = problem(seed, device)
    boosting = Boosting(learner, class_targets(labels, 3), 4, shrinkage, torch.Generator().manual_seed(0))
    before = (base * boosting.losses()).sum(0)
    for _ in range(15):
        boosting.round(base)
        after = (base * boosting.losses()).sum(0)
        assert (after <= before * (1 + 1e-4)).all()
        before = after


def test_problems_do_not_disturb_one_another():
    learner, labels, base = problem(0)
    together = Boosting(learner, class_targets(labels, 3), 4, 0.3, torch.Generator())
    alone = Boosting(learner, class_targets(labels, 3), 1, 0.3, torch.Generator())
    for _ in range(5):
        together.round(base)
        alone.round(base[:, 2:3])
    torch.testing.assert_close(together.scores[:, 2:3], alone.scores)


def test_the_strong_classifier_has_the_scores_of_the_training():
    learner, labels, base = problem(1)
    boosting = Boosting(learner, class_targets(labels, 3), 4, 0.3, torch.Generator())
    for _ in range(7):
        boosting.round(base)
    torch.testing.assert_close(boosting.strong().scores(learner.data.levels), boosting.scores)


def test_losses_are_sums_of_exponentials_up_to_the_margin_limit():
    learner, labels, _ = problem(2)
    boosting = Boosting(learner, class_targets(labels, 3), 1, 1.0, torch.Generator())
    boosting.scores = 3 * torch.randn(80, 1, 3, generator=torch.Generator().manual_seed(0))
    signs = 2.0 * class_targets(labels, 3) - 1
    torch.testing.assert_close(boosting.losses(), torch.exp(-signs * boosting.scores).sum(2))
    boosting.scores = torch.full((80, 1, 3), 1000.0)
    expected = 2 * torch.tensor(MARGIN_LIMIT).exp()
    torch.testing.assert_close(boosting.losses(), expected.expand(80, 1), rtol=1e-5, atol=0)


@pytest.mark.parametrize("shrinkage", [0.0, -0.1, 1.5])
def test_a_wrong_shrinkage_is_named(shrinkage):
    learner, labels, _ = problem(3)
    with pytest.raises(ValueError, match=str(shrinkage)):
        Boosting(learner, class_targets(labels, 3), 1, shrinkage, torch.Generator())
