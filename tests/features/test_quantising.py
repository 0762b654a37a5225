"""Quantisers keep the order of values, and keep apart what must be."""

import pytest
import torch

from dpmacro.features.levels import LEVELS
from dpmacro.features.quantising import Quantiser


@pytest.mark.parametrize("dtype", [torch.int32, torch.float32])
def test_quantiser_keeps_order_and_uses_all_levels(dtype):
    values = (1000 * torch.randn(3, 5000, generator=torch.Generator().manual_seed(0))).to(dtype)
    quantiser = Quantiser.fit(values)
    levels = quantiser.levels(values).long()
    assert quantiser.cuts.shape == (3, LEVELS - 1)
    for column, level in zip(values, levels, strict=True):
        order = column.argsort()
        assert (level[order].diff() >= 0).all()
        assert len(level.unique()) > LEVELS // 2
    direct = (quantiser.cuts[:, None, :] <= values[:, :, None]).sum(2)
    assert torch.equal(direct, levels)


def test_quantiser_keeps_few_integers_apart():
    values = torch.tensor([[0, 1, 2, 3, 100, 101]], dtype=torch.int32).repeat(1, 50)
    assert len(Quantiser.fit(values).levels(values).unique()) == 6


def test_quantiser_keeps_a_rare_extreme_apart():
    values = torch.zeros(1, 10000, dtype=torch.int32)
    values[0, :3] = torch.tensor([500, 700, 1000])
    assert len(Quantiser.fit(values).levels(values).unique()) == 4
