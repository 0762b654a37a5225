"""Left-out scores know nothing of what they are scores of."""

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from dpmacro.boosting import crossfit
from dpmacro.boosting.crossfit import FOLDS, bounded_deviance, left_out_scores
from dpmacro.boosting.folds import frame_folds
from dpmacro.boosting.loop import Round
from dpmacro.features.levels import SortedLevels

LENGTHS = torch.tensor([20, 31, 25, 24, 30, 20])
SEED = 3


@pytest.fixture(autouse=True)
def few_rounds(monkeypatch):
    monkeypatch.setattr(crossfit, "SHARED_ROUNDS", 4)
    monkeypatch.setattr(crossfit, "OWN_ROUNDS", 8)
    monkeypatch.setattr(crossfit, "COLUMNS", 5)


def noise(seed=0, columns=9):
    generator = torch.Generator().manual_seed(seed)
    n_frames = int(LENGTHS.sum())
    levels = torch.randint(0, 256, (columns, n_frames), dtype=torch.uint8, generator=generator)
    actions = torch.randint(0, 3, (n_frames,), generator=generator)
    rivals = torch.randint(0, 2, (2, n_frames), generator=generator)
    return SortedLevels.build(levels), actions, rivals


def scores_of(data, actions, rivals, lengths=LENGTHS, **options):
    return left_out_scores(data, actions, lengths, rivals, 2, 3, SEED, **options)


@pytest.mark.parametrize(
    ("lengths", "groups"),
    [(LENGTHS, None), (LENGTHS, torch.tensor([0, 1, 2, 3, 0, 1])), (torch.tensor([100, 50]), None)],
    ids=["trajectories", "groups", "stretches"],
)
@pytest.mark.parametrize("fold", range(FOLDS))
def test_scores_of_a_fold_do_not_depend_on_its_frames(lengths, groups, fold):
    data, actions, rivals = noise()
    out = frame_folds(lengths, FOLDS, torch.Generator().manual_seed(SEED), groups) == fold
    assert 0 < int(out.sum()) < len(out)
    before = scores_of(data, actions, rivals, lengths, groups=groups)
    others = scores_of(
        data,
        torch.where(out, (actions + 1) % 3, actions),
        torch.where(out, 1 - rivals, rivals),
        lengths,
        groups=groups,
    )
    torch.testing.assert_close(others.macros[:, out], before.macros[:, out])
    torch.testing.assert_close(others.alone[out], before.alone[out])
    assert not torch.allclose(others.macros[:, ~out], before.macros[:, ~out])
    assert not torch.allclose(others.alone[~out], before.alone[~out])


def test_a_rival_with_one_macro_action_is_the_baseline():
    data, actions, rivals = noise()
    rivals = torch.cat([rivals, torch.zeros_like(rivals[:1]), torch.ones_like(rivals[:1])])
    found = scores_of(data, actions, rivals)
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


def test_a_rival_does_not_see_the_others_and_a_seed_repeats():
    data, actions, rivals = noise()
    both, second = scores_of(data, actions, rivals), scores_of(data, actions, rivals[1:])
    torch.testing.assert_close(both.macros[1:], second.macros)
    torch.testing.assert_close(both.alone, second.alone)


def test_every_round_is_reported():
    data, actions, rivals = noise()
    reports: list[Round] = []
    scores_of(data, actions, rivals, on_round=reports.append)
    assert [(report.stage, report.number, report.total) for report in reports] == [
        ("judge", number, 12) for number in range(1, 13)
    ]
    assert reports[-1].loss < reports[0].loss < 3 and reports[-1].accuracy > 0.5


@settings(max_examples=80, deadline=None)
@given(
    st.lists(st.floats(-9, 9, width=32), min_size=2, max_size=4),
    st.integers(0, 3),
    st.sampled_from([0.5, 1.0, 3.0]),
)
def test_the_bounded_deviance_is_its_formula(scores, right, limit):
    scores = torch.tensor(scores, requires_grad=True)
    targets = torch.arange(len(scores)) == right % len(scores)
    found = bounded_deviance(scores, targets, limit)
    margins = torch.where(targets, scores, -scores).tolist()
    wanted = sum(torch.log1p((-2 * torch.tensor(m).double().clamp(-limit, limit)).exp()) for m in margins)
    assert float(found.detach()) == pytest.approx(float(wanted), rel=1e-5)
    least, most = (len(margins) * float(torch.tensor(2.0 * side).exp().log1p()) for side in (-limit, limit))
    assert least * (1 - 1e-5) <= float(found.detach()) <= most * (1 + 1e-5)
    found.backward()
    within = scores.detach().abs() < limit
    downwards = torch.where(targets, scores.grad < 0, scores.grad > 0)
    assert bool(downwards[within].all()), "a better margin costs less"
    assert not bool(scores.grad[scores.detach().abs() > limit].any()), "and beyond the limit the same"


def test_the_bounded_deviance_takes_targets_for_several_classifiers():
    scores = torch.randn(5, 2, 3, generator=torch.Generator().manual_seed(0))
    targets = torch.nn.functional.one_hot(torch.tensor([0, 1, 2, 0, 1]), 3).bool()
    found = bounded_deviance(scores, targets[:, None], 1.0)
    for macro in range(2):
        torch.testing.assert_close(found[:, macro], bounded_deviance(scores[:, macro], targets, 1.0))
