"""The selector prefers a segmentation that a switch function can follow to one that explains as well."""

import pytest
import torch

from dpmacro.learners.sorting import SortedLevels
from dpmacro.selection import Verdict, best_verdict, distinct, judge


def visible_change(n=12, length=80):
    """Column 0 is high for three frames from the change on; column 1 decides before it, column 2 after."""
    generator = torch.Generator().manual_seed(0)
    levels = torch.randint(0, 120, (6, n * length), dtype=torch.uint8, generator=generator)
    truth = torch.zeros(n, length, dtype=torch.int64)
    for row, cut in enumerate(torch.randint(25, 55, (n,), generator=generator).tolist()):
        truth[row, cut:] = 1
        levels[0, row * length + cut : row * length + cut + 3] = 250
    truth = truth.flatten()
    actions = (levels[1 + truth, torch.arange(n * length)] > 60).long()
    return SortedLevels.build(levels), actions, torch.full((n,), length), truth


def test_the_true_segmentation_has_the_least_causal_error():
    data, actions, lengths, truth = visible_change()
    shifted = truth.view(12, 80).roll(9, 1).flatten()
    one = torch.zeros_like(truth)
    verdicts = judge(data, actions, lengths, torch.stack([shifted, truth, one]), 2, seed=0)
    errors = [verdicts[k].causal_error for k in range(3)]
    assert min(errors) == errors[1] < 0.6 * errors[2]
    assert verdicts[1].detected == 1.0
    assert verdicts[0].detected < 0.5


def test_a_single_trajectory_cannot_be_judged():
    data, actions, _, truth = visible_change()
    with pytest.raises(ValueError, match="give two or more"):
        judge(data, actions, torch.tensor([960]), truth[None], 2, seed=0)


@pytest.mark.parametrize(
    ("verdicts", "best"),
    [
        ({4: Verdict(0.1, 1.0, 0.10), 7: Verdict(0.9, 1.0, 0.12)}, 4),
        ({4: Verdict(0.1, 1.0, 0.10), 7: Verdict(0.9, 1.0, 0.105)}, 7),
    ],
)
def test_the_best_verdict_is_the_least_error_unless_it_is_close(verdicts, best):
    assert best_verdict(verdicts) == best


def test_distinct_keeps_the_first_of_a_group():
    base = torch.arange(200) // 100
    near = base.clone()
    near[0] = 1
    assert distinct(torch.stack([base, near, 1 - base, base])).tolist() == [0, 2]
