"""What is reported of left-out data: thresholds and cues are chosen by the other folds."""

import pytest
import torch
from visible import trajectories

from dpmacro.boosting.folds import folds_of
from dpmacro.boosting.learners.stumps import StumpLearner
from dpmacro.features.levels import SortedLevels
from dpmacro.segmentation.segments import macro_segments
from dpmacro.switching.examples import COVERED
from dpmacro.switching.settings import SWITCH_FOLDS
from dpmacro.switching.threshold import best_threshold, recognised_share
from tests.switching.test_training import fit


def changes_of(labels, lengths):
    return [one for one in macro_segments(labels, lengths) if (one.macro, one.following) == (0, 1)]


def dealt(lengths):
    """The fold of every trajectory, as `fit` deals them."""
    return folds_of(len(lengths), SWITCH_FOLDS, torch.Generator().manual_seed(0))


def unrecognisable(seed, n=20, length=11, n_actions=6):
    """Noise that changes its macro-action after two to four frames, and says nothing of it."""
    generator = torch.Generator().manual_seed(seed)
    labels = (torch.arange(length) >= torch.randint(2, 5, (n, 1), generator=generator)).long().flatten()
    levels = torch.randint(0, 256, (6, n * length), dtype=torch.uint8, generator=generator)
    actions = torch.randint(0, n_actions, (n * length,), generator=generator)
    return StumpLearner(SortedLevels.build(levels)), labels, torch.full((n,), length), actions


def test_a_margin_is_the_score_less_the_threshold_of_the_other_folds():
    learner, labels, lengths, _ = unrecognisable(0)
    switches = fit(learner, labels, lengths, rounds=20)
    fold_of, changes = dealt(lengths), changes_of(labels, lengths)
    chosen = []
    for fold in range(SWITCH_FOLDS):
        others = [one for one in changes if fold_of[one.trajectory] != fold]
        chosen.append(best_threshold(others, switches.scores[:, 0]))
    own = torch.tensor(chosen)[fold_of].repeat_interleave(lengths)
    torch.testing.assert_close(switches.margins[:, 0], switches.scores[:, 0] - own)
    assert len(set(chosen)) > 1, "or the folds could all have chosen together"
    assert switches.thresholds.tolist() == pytest.approx([best_threshold(changes, switches.scores[:, 0])])
    share = recognised_share(changes, switches.margins[:, 0])
    assert switches.recognised.tolist() == pytest.approx([share])


def test_a_change_counts_where_the_cues_of_the_other_folds_allow_it():
    """Ten changes of fifteen follow action 1, five action 2: without some of the ten, both are cues."""
    learner, labels, lengths = trajectories(n=15)
    change = (labels.diff(prepend=labels[:1]) > 0).nonzero()[:, 0]
    actions = torch.zeros_like(labels)
    fold_of = dealt(lengths)
    late = torch.zeros(15, dtype=torch.bool)
    late[torch.cat([(fold_of == fold).nonzero()[:2, 0] for fold in (0, 1)])] = True
    actions[change - 1] = 1 + late.long()  # 2 before four changes: two in either fold
    switches = fit(learner, labels, lengths, actions=actions)
    assert switches.cues == ((1, 2),)
    before = actions.roll(1)
    before[lengths.cumsum(0) - lengths] = 0
    for fold in range(SWITCH_FOLDS):
        others = actions[change - 1][fold_of != fold].bincount(minlength=3)
        cues = [1] if int(others[1]) >= COVERED * int(others.sum()) else [1, 2]
        inside = (fold_of == fold).repeat_interleave(lengths)
        barred = ~torch.isin(before, torch.tensor(cues))
        assert torch.equal(switches.margins[:, 0].isinf()[inside], barred[inside])
        assert (cues == [1]) == (fold in (0, 1))
    assert switches.recognised.tolist() == pytest.approx([11 / 15]), "all but the four that follow action 2"


def test_changes_that_cannot_be_recognised_are_recognised_by_chance_alone():
    """Thresholds and cues that are tuned on the changes they are tried on claim twice as much and more.

    Of scores at random the change's is the only one of k + 1 above a threshold k^k / (k + 1)^(k + 1) times
    at best: 0.15, 0.11 and 0.08 for the k = 2, 3, 4 frames before it.
    """
    nested, tuned = [], []
    for seed in range(10):
        learner, labels, lengths, actions = unrecognisable(seed)
        switches = fit(learner, labels, lengths, actions=actions)
        nested.append(switches.mean_recognised)
        changes = changes_of(labels, lengths)
        tuned.append(recognised_share(changes, switches.scores[:, 0] - switches.thresholds))
    assert sum(nested) / 10 <= (0.15 + 0.11 + 0.08) / 3
    assert sum(tuned) / 10 > 2 * sum(nested) / 10
