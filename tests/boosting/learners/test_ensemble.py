"""Learners in turn: who boosts when, and that the sum of their parts survives a file."""

import pytest
import torch
from safetensors.torch import load, save

from dpmacro.boosting.learners.base import Frames, StrongClassifier, WeakLearner
from dpmacro.boosting.learners.ensemble import Ensemble, InTurn, classifier_from, classifier_tensors
from dpmacro.boosting.learners.stumps import StumpClassifier, StumpLearner
from dpmacro.boosting.loop import Boosting, class_targets
from dpmacro.features.levels import SortedLevels


def learners(n_frames=60):
    """A learner that sees columns 0 to 9 only and one that sees all, over the same levels."""
    generator = torch.Generator().manual_seed(0)
    levels = torch.randint(0, 256, (20, n_frames), dtype=torch.uint8, generator=generator)
    hidden = levels.clone()
    hidden[10:] = 0
    then = StumpLearner(SortedLevels.build(levels), drawn=15, reuse=2)
    return StumpLearner(SortedLevels.build(hidden)), then


def boosted(rounds, first_rounds=3):
    first, then = learners()
    learner = InTurn(first, first_rounds, then)
    assert isinstance(learner, WeakLearner)
    targets = class_targets((then.data.levels[15] > 128).long(), 2)
    boosting = Boosting(learner, targets, 2, 0.5, torch.Generator().manual_seed(1))
    for _ in range(rounds):
        boosting.round(torch.ones(60, 2))
    return boosting, Frames(then.data.levels)


def test_the_second_learner_follows_the_first():
    boosting, _ = boosted(6)
    classifier = boosting.strong()
    assert isinstance(classifier, Ensemble) and isinstance(classifier, StrongClassifier)
    first, then = classifier.parts
    assert len(first.columns) == len(then.columns) == 3
    assert int(first.columns.max()) < 10 and int(then.columns[0, 0]) == 15


def test_before_its_turn_the_second_learner_leaves_no_trace():
    assert isinstance(boosted(3)[0].strong(), StumpClassifier)


@pytest.mark.parametrize("kept", [None, torch.tensor([5, 2])])
def test_scores_are_the_sum_over_both_and_end_where_asked(kept):
    boosting, frames = boosted(5)
    scores = boosting.strong(kept).scores(frames)
    if kept is None:
        torch.testing.assert_close(scores, boosting.scores)
    else:
        torch.testing.assert_close(scores[:, 0], boosting.scores[:, 0])
        torch.testing.assert_close(scores[:, 1], boosted(2)[0].scores[:, 1])


def test_select_and_renumber_reach_every_part():
    boosting, frames = boosted(5)
    classifier = boosting.strong()
    torch.testing.assert_close(
        classifier.select(torch.tensor([1])).scores(frames), classifier.scores(frames)[:, 1:]
    )
    used = classifier.used_columns()
    assert used.tolist() == sorted(set(used.tolist()))
    fewer = Frames(frames.levels[used])
    torch.testing.assert_close(classifier.renumbered(used).scores(fewer), classifier.scores(frames))


@pytest.mark.parametrize(("rounds", "parts"), [(3, {"0.stumps"}), (5, {"0.stumps", "1.stumps"})])
def test_every_part_survives_a_file(rounds, parts):
    boosting, frames = boosted(rounds)
    tensors = load(save(classifier_tensors(boosting.strong())))
    assert {name.rpartition(".")[0] for name in tensors} == parts
    assert torch.equal(classifier_from(tensors).scores(frames), boosting.strong().scores(frames))


def test_an_unknown_kind_is_named():
    with pytest.raises(KeyError, match="forest"):
        classifier_from({"0.forest.trees": torch.zeros(1)})


def test_wrong_arguments_are_named():
    first, then = learners()
    with pytest.raises(ValueError, match="rounds of the first learner is 0"):
        InTurn(first, 0, then)
    with pytest.raises(ValueError, match="hold 60 and 50 frames"):
        InTurn(first, 3, learners(50)[1])
