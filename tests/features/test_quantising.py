"""Quantisers keep the order of values, and keep apart what must be."""

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from safetensors.torch import load, save

from dpmacro.features.levels import LEVELS
from dpmacro.features.quantising import Quantiser


@pytest.mark.parametrize("dtype", [torch.int32, torch.float32, torch.float64])
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


@settings(deadline=None)
@given(
    seed=st.integers(0, 2**16),
    n_frames=st.integers(1, 40),
    exponent=st.integers(-30, 30),
    dtype=st.sampled_from([torch.int32, torch.float32, torch.float64]),
)
def test_levels_are_the_cuts_not_above_before_and_after_a_file(seed, n_frames, exponent, dtype):
    generator = torch.Generator().manual_seed(seed)
    values = torch.randn(3, n_frames, generator=generator, dtype=torch.float64) * 10.0**exponent
    values = values.clamp(-(2**30), 2**30).to(dtype) if dtype == torch.int32 else values.to(dtype)
    values[1] = values[1, 0]
    quantiser = Quantiser(load(save({"cuts": Quantiser.fit(values).cuts}))["cuts"])
    assert quantiser.cuts.dtype == dtype and torch.equal(quantiser.cuts, Quantiser.fit(values).cuts)
    expected = (quantiser.cuts[:, None, :] <= values[:, :, None]).sum(2)
    assert torch.equal(quantiser.levels(values).long(), expected)
    single = [quantiser.levels(values[:, n : n + 1].contiguous()) for n in range(n_frames)]
    assert torch.equal(torch.cat(single, 1).long(), expected)
    assert (expected[1] == LEVELS - 1).all(), "a constant column has one level"


@pytest.mark.parametrize("dtype", [torch.int32, torch.float32])
def test_cuts_of_another_type_that_holds_the_values(dtype):
    values = (1000 * torch.randn(3, 500, generator=torch.Generator().manual_seed(0))).to(dtype)
    narrow, wide = Quantiser.fit(values), Quantiser.fit(values, torch.float64)
    assert torch.equal(wide.cuts, Quantiser.fit(values.double()).cuts)
    for quantiser in (narrow, wide):
        levels = quantiser.levels(values)
        assert torch.equal(levels[:, :1], quantiser.levels(values[:, :1].contiguous()))
        order = values.argsort(1)
        assert (levels.long().gather(1, order).diff() >= 0).all()
    if dtype == torch.int32:
        assert torch.equal(narrow.levels(values), wide.levels(values))


@pytest.mark.parametrize("wrong", [torch.nan, torch.inf, -torch.inf])
def test_values_that_are_not_finite_are_refused(wrong):
    values = torch.tensor([[1.0, 2.0, 3.0], [1.0, wrong, 3.0]])
    with pytest.raises(ValueError, match="not finite"):
        Quantiser.fit(values)
