"""Losses against their formulas, and where they are cut off."""

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from dpmacro.boosting.losses.classes import MARGIN_LIMIT, bounded_deviance, class_targets, exponentials_of


def test_losses_are_exponentials_up_to_the_margin_limit():
    scores = 3 * torch.randn(80, 2, 3, generator=torch.Generator().manual_seed(0))
    targets = class_targets(torch.arange(80) % 3, 3)
    torch.testing.assert_close(exponentials_of(scores, targets), torch.exp(-(2.0 * targets - 1) * scores))
    far = exponentials_of(torch.full((80, 1, 3), 1000.0), targets).sum(2)
    torch.testing.assert_close(far, (2 * torch.tensor(MARGIN_LIMIT).exp()).expand(80, 1))


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
