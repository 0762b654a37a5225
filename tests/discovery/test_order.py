"""Whether demonstrations go through the same stages in the same order, as linear models tell."""

import pytest
import torch

from dpmacro.boosting.losses.vectors import HuberLoss
from dpmacro.discovery.order import ALLOWANCE, Order, order_of
from dpmacro.discovery.task import Task
from dpmacro.features.levels import SortedLevels


def ordered(orders, length=90, seed=0):
    """Every trajectory goes through three linear macro-actions in its own one of `orders`."""
    generator = torch.Generator().manual_seed(seed)
    n_frames = len(orders) * length
    levels = torch.randint(0, 256, (3, n_frames), dtype=torch.uint8, generator=generator)
    labels = torch.cat([torch.tensor(order).repeat_interleave(length // 3) for order in orders])
    seen = levels.float().T / 128 - 1
    models = torch.tensor([[2.0, 0, 0], [0, -2, 1], [-1, 0, 2]])
    actions = (models[labels] * seen).sum(1, keepdim=True) + 2 * (labels[:, None] - 1)
    actions = actions + 0.1 * torch.randn(actions.shape, generator=generator)
    actions = (actions - actions.mean()) / actions.std()
    lengths = torch.full((len(orders),), length)
    return SortedLevels.build(levels), Task(
        actions, lengths, torch.arange(len(orders)), HuberLoss(1), 3, 2, seed=0
    )


def test_the_same_stages_in_the_same_order_are_a_chain():
    data, task = ordered([(0, 1, 2)] * 10)
    found = order_of(data, task)
    assert found.chosen == "chain" and found.chain < 0.2


def test_stages_in_any_order_are_none():
    data, task = ordered([(0, 1, 2), (2, 1, 0), (1, 0, 2), (2, 0, 1)] * 3)
    found = order_of(data, task)
    assert found.chosen == "free" and found.free < found.chain


@pytest.mark.parametrize(("chain", "chosen"), [(1.0, "chain"), (1 + 0.9 * ALLOWANCE, "chain"), (1.2, "free")])
def test_one_order_may_explain_a_little_less(chain, chosen):
    assert Order(chain, 1.0).chosen == chosen
