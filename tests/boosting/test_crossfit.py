"""Left-out scores know nothing of what they are scores of."""

import pytest
import torch

from dpmacro.boosting import crossfit
from dpmacro.boosting.crossfit import CLASSIFIER_FOLDS, left_out_scores, pace_of
from dpmacro.boosting.folds import frame_folds
from dpmacro.boosting.loop import Round
from dpmacro.boosting.losses.classes import ExponentialLoss
from dpmacro.features.levels import SortedLevels

LENGTHS = torch.tensor([20, 31, 25, 24, 30, 20])
SEED = 3


@pytest.fixture(autouse=True)
def few_rounds(monkeypatch):
    quick = crossfit.Pace(shared=4, own=8, shrinkage=0.2, columns=5, bins=256)
    monkeypatch.setattr(crossfit, "CLASSES", quick)


def noise(seed=0, columns=9):
    generator = torch.Generator().manual_seed(seed)
    n_frames = int(LENGTHS.sum())
    levels = torch.randint(0, 256, (columns, n_frames), dtype=torch.uint8, generator=generator)
    actions = torch.randint(0, 3, (n_frames,), generator=generator)
    candidates = torch.randint(0, 2, (2, n_frames), generator=generator)
    return SortedLevels.build(levels), actions, candidates


def scores_of(data, actions, candidates, lengths=LENGTHS, **options):
    return left_out_scores(data, actions, lengths, candidates, 2, ExponentialLoss(3), SEED, **options)


@pytest.mark.parametrize(
    ("lengths", "groups"),
    [(LENGTHS, None), (LENGTHS, torch.tensor([0, 1, 2, 3, 0, 1])), (torch.tensor([100, 50]), None)],
    ids=["trajectories", "groups", "stretches"],
)
@pytest.mark.parametrize("fold", range(CLASSIFIER_FOLDS))
def test_scores_of_a_fold_do_not_depend_on_its_frames(lengths, groups, fold):
    data, actions, candidates = noise()
    out = frame_folds(lengths, CLASSIFIER_FOLDS, torch.Generator().manual_seed(SEED), groups) == fold
    assert 0 < int(out.sum()) < len(out)
    before = scores_of(data, actions, candidates, lengths, groups=groups)
    others = scores_of(
        data,
        torch.where(out, (actions + 1) % 3, actions),
        torch.where(out, 1 - candidates, candidates),
        lengths,
        groups=groups,
    )
    torch.testing.assert_close(others.macros[:, out], before.macros[:, out])
    torch.testing.assert_close(others.alone[out], before.alone[out])
    assert not torch.allclose(others.macros[:, ~out], before.macros[:, ~out])
    assert not torch.allclose(others.alone[~out], before.alone[~out])


def test_a_candidate_with_one_macro_action_is_the_baseline():
    data, actions, candidates = noise()
    candidates = torch.cat([candidates, torch.zeros_like(candidates[:1]), torch.ones_like(candidates[:1])])
    found = scores_of(data, actions, candidates)
    torch.testing.assert_close(found.macros[2, :, 0], found.alone)
    torch.testing.assert_close(found.macros[3, :, 1], found.alone)
    common = found.macros[2, :, 1]
    assert common.any(), "a macro-action without a frame knows what all have in common"
    assert torch.equal(common, found.macros[3, :, 0]) and not torch.allclose(common, found.alone)
    assert not torch.allclose(found.macros[0, :, 0], found.alone)


def test_a_macro_action_is_scored_on_frames_that_it_does_not_hold():
    generator = torch.Generator().manual_seed(1)
    levels = torch.randint(0, 256, (3, 150), dtype=torch.uint8, generator=generator)
    macro = torch.arange(150) % 2
    actions = (levels[macro, torch.arange(150)] > 127).long()  # column q decides in macro-action q
    found = scores_of(SortedLevels.build(levels), actions, torch.stack([macro, 1 - macro]))
    for place, names in enumerate([(0, 1), (1, 0)]):
        for column, name in enumerate(names):
            told = found.macros[place, :, name, :2].argmax(1)
            assert float((told == (levels[column] > 127)).float().mean()) > 0.9


def test_a_candidate_does_not_see_the_others_and_a_seed_repeats():
    data, actions, candidates = noise()
    both, second = scores_of(data, actions, candidates), scores_of(data, actions, candidates[1:])
    torch.testing.assert_close(both.macros[1:], second.macros)
    torch.testing.assert_close(both.alone, second.alone)


def test_what_does_not_fit_into_memory_together_gets_the_same_scores(monkeypatch):
    data, actions, candidates = noise()
    together = scores_of(data, actions, candidates)
    monkeypatch.setattr(crossfit, "TABLE", 1)
    reports: list[Round] = []
    apart = scores_of(data, actions, candidates, on_round=reports.append)
    torch.testing.assert_close(apart.macros, together.macros)
    torch.testing.assert_close(apart.alone, together.alone)
    assert len(reports) == 12 * len(candidates)


def test_classifiers_of_vectors_are_grown_further():
    actions = torch.randn(6, 2)
    assert pace_of(actions) is crossfit.VECTORS and pace_of((actions[:, 0] > 0).long()) is crossfit.CLASSES
    assert (
        crossfit.VECTORS.own * crossfit.VECTORS.shrinkage
        > 2 * crossfit.CLASSES.own * crossfit.CLASSES.shrinkage
    )


def test_every_round_is_reported():
    data, actions, candidates = noise()
    reports: list[Round] = []
    scores_of(data, actions, candidates, on_round=reports.append)
    assert [(report.stage, report.number, report.total) for report in reports] == [
        ("score", number, 12) for number in range(1, 13)
    ]
    assert reports[-1].loss < reports[0].loss < 3 and reports[-1].accuracy > 0.5
