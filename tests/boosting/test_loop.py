"""The boosting loop: what theory says of its loss, and that its scores are those of the strong classifier."""

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from dpmacro.boosting.learners.base import Frames
from dpmacro.boosting.learners.stumps import StumpLearner
from dpmacro.boosting.loop import TRIES, Boosting
from dpmacro.boosting.losses.classes import class_targets
from dpmacro.features.levels import SortedLevels

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
    torch.testing.assert_close(boosting.strong().scores(Frames(learner.data.levels)), boosting.scores)


def test_a_strong_classifier_may_end_after_fewer_rounds_problem_by_problem():
    learner, labels, base = problem(1)
    frames = Frames(learner.data.levels)
    boosting = Boosting(learner, class_targets(labels, 3), 4, 0.3, torch.Generator())
    after = []
    for _ in range(6):
        boosting.round(base)
        after.append(boosting.scores.clone())
    kept = torch.tensor([2, 6, 1, 4])
    expected = torch.stack([after[rounds - 1][:, p] for p, rounds in enumerate(kept.tolist())], 1)
    torch.testing.assert_close(boosting.strong(kept).scores(frames), expected)


def test_a_problem_in_which_nothing_beats_chance_ends_and_the_others_go_on():
    levels = torch.tensor([[0, 0, 9, 9]], dtype=torch.uint8)
    targets = torch.tensor([[True, False], [False, False], [True, True], [False, True]])[:, :, None]
    boosting = Boosting(StumpLearner(SortedLevels.build(levels)), targets, 2, 0.5, torch.Generator())
    base = torch.ones(4, 2)
    assert [boosting.round(base).tolist() for _ in range(TRIES + 1)] == [[], [], [0], []]
    assert boosting.ended.tolist() == [True, False]
    assert (boosting.scores[:, 0] == 0).all()
    scores = boosting.strong().scores(Frames(levels))
    torch.testing.assert_close(scores, boosting.scores)
    assert float(scores[3, 1]) > 0 > float(scores[0, 1])


def two_halves():
    """Frames of which the first four say nothing, the last four everything: column 0 is their class."""
    levels = torch.tensor([[0, 0, 0, 0, 0, 0, 9, 9]], dtype=torch.uint8)
    classes = torch.tensor([0, 1, 0, 1, 0, 0, 1, 1])
    first = torch.tensor([1.0, 1, 1, 1, 0, 0, 0, 0])[:, None]
    learner = StumpLearner(SortedLevels.build(levels))
    return Boosting(learner, class_targets(classes, 2), 1, 0.5, torch.Generator()), first


def loss_of(boosting, base):
    """The exponential loss a frame; 2 where nothing was learned of two classes."""
    return float((base * boosting.losses()).sum() / base.sum())


def test_a_problem_that_ended_comes_back_when_it_is_given_other_frames():
    boosting, first = two_halves()
    for _ in range(TRIES + 2):
        boosting.round(first)
    assert boosting.ended.tolist() == [True] and loss_of(boosting, 1 - first) == 2.0
    for _ in range(10):
        boosting.round(1 - first)
    assert boosting.ended.tolist() == [False] and loss_of(boosting, 1 - first) < 0.1


def test_a_problem_that_ended_stays_ended_while_its_weights_are_the_same():
    boosting, first = two_halves()
    told = [boosting.round(first.clone()).tolist() for _ in range(2 * TRIES + 2)]
    assert told == [[0] if number == TRIES else [] for number in range(1, 2 * TRIES + 3)], "it ends once"
    assert boosting.ended.tolist() == [True] and not boosting.scores.any()


def test_other_weights_revive_only_the_problem_that_they_belong_to():
    levels = torch.zeros(1, 4, dtype=torch.uint8)
    targets = class_targets(torch.tensor([0, 1, 0, 1]), 2)
    boosting = Boosting(StumpLearner(SortedLevels.build(levels)), targets, 2, 0.5, torch.Generator())
    base = torch.ones(4, 2)
    for _ in range(TRIES):
        boosting.round(base)
    assert boosting.ended.tolist() == [True, True]
    changed = base.clone()
    changed[:2, 1] = 2
    boosting.round(changed)
    assert boosting.ended.tolist() == [True, False]


def test_other_weights_give_a_problem_all_its_tries_again():
    boosting, first = two_halves()
    for weight in range(1, 5):
        told = [boosting.round(weight * first).tolist() for _ in range(TRIES)]
        assert told == [[]] * (TRIES - 1) + [[0]]


def test_a_problem_without_frames_waits_for_some():
    learner, labels, base = problem(4)
    boosting = Boosting(learner, class_targets(labels, 3), 4, 0.3, torch.Generator())
    empty = base.clone()
    empty[:, 1] = 0
    assert not len(boosting.round(empty)) and not boosting.ended.any()
    boosting.round(base)
    assert (boosting.scores[:, 1] != 0).any()


@pytest.mark.parametrize(
    ("value", "message"),
    [
        (float("nan"), "a base weight is nan"),
        (-1.0, r"a base weight is -1\.0"),
        (float("inf"), "weights of problem 2 sum to inf"),
        (1e38, "weights of problem 2 sum to"),
    ],
)
def test_weights_that_cannot_be_are_refused(value, message):
    learner, labels, base = problem(5)
    base[7, 2] = value
    with pytest.raises(ValueError, match=message):
        Boosting(learner, class_targets(labels, 3), 4, 0.3, torch.Generator()).round(base)


@pytest.mark.parametrize("shrinkage", [0.0, -0.1, 1.5])
def test_a_wrong_shrinkage_is_named(shrinkage):
    learner, labels, _ = problem(3)
    with pytest.raises(ValueError, match=str(shrinkage)):
        Boosting(learner, class_targets(labels, 3), 1, shrinkage, torch.Generator())
