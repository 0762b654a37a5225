"""Plans that fit the memory, and columns that do not depend on how they are computed."""

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from dpmacro.features import columns
from dpmacro.features.base import make_features, previous_images
from dpmacro.features.columns import GIB, LEAST_COLUMNS, LIBRARIES, Demand, Plan, prepare, with_mirror_images
from dpmacro.features.levels import SortedLevels
from dpmacro.features.quantising import Quantiser


def test_the_sizes_of_the_goal():
    plan = Plan.fitting(Demand(17_000, 9216, 18_432, 120), 2.5)
    assert (plan.columns, plan.drawn) == (18_432, 0)
    large = Plan.fitting(Demand(200_000, 9216, 4096, 7680), 6.0)  # 2 macro-actions, 32 restarts, 3 actions
    assert large.columns == 4096 and LEAST_COLUMNS < large.drawn < 4096
    assert 512 <= Plan.fitting(Demand(200_000, 9216, 18_432, 7680), 5.0).columns < 18_432
    mirrored = Plan.fitting(Demand(200_000, 9216, 4096, 11_520, copies=1, switch_bytes=3200), 6.0)
    assert mirrored.columns == 4096


@settings(deadline=None)
@given(
    n_frames=st.integers(10, 300_000),
    n_columns=st.integers(1, 20_000),
    table_bytes=st.integers(12, 10_000),
    limit=st.floats(0.7, 16),
    copies=st.integers(0, 3),
    switch_bytes=st.integers(0, 2_000),
)
def test_a_plan_stays_within_the_limit_and_uses_what_there_is(
    n_frames, n_columns, table_bytes, limit, copies, switch_bytes
):
    try:
        plan = Plan.fitting(Demand(n_frames, 9216, n_columns, table_bytes, copies, switch_bytes), limit)
    except ValueError as error:
        assert f"memory_limit is {limit:g} GiB" in str(error)
        least = max(6, 2 + copies) * min(LEAST_COLUMNS, n_columns)
        assert n_frames * (9216 + max(table_bytes, switch_bytes) + least) > (limit - 1.6) * GIB
        return
    assert plan.gibibytes <= limit
    assert min(LEAST_COLUMNS, n_columns) <= plan.columns <= n_columns
    assert plan.drawn <= plan.columns
    copied = 1 + copies if copies else 0
    boosting = plan.columns + table_bytes + (5 * plan.drawn if plan.drawn else 4 * plan.columns)
    switching = (1 + copied + (0 if plan.drawn else 4)) * plan.columns + switch_bytes
    assert plan.gibibytes * GIB > LIBRARIES + n_frames * (9216 + max(boosting, switching)) - 1
    if plan.drawn:  # a column more, kept or drawn, would not fit
        assert plan.columns == n_columns or plan.gibibytes + (1 + copied) * n_frames / GIB > limit
        more = LIBRARIES + n_frames * (9216 + boosting + 5)
        assert plan.drawn == plan.columns or more > limit * GIB


def example(n_frames=90):
    generator = torch.Generator().manual_seed(0)
    images = torch.randint(0, 256, (n_frames, 12, 16, 3), dtype=torch.uint8, generator=generator)
    return images, torch.tensor([40, n_frames - 40])


@pytest.mark.parametrize("kind", ["pixels", "rectangles"])
@pytest.mark.parametrize("at_a_time", [2**26, 1000])
def test_columns_are_those_computed_all_at_once(monkeypatch, kind, at_a_time):
    images, lengths = example()
    features = make_features(kind, 12, 16, 70, torch.Generator().manual_seed(1))
    values = features.values(images, previous_images(images, lengths))
    quantiser = Quantiser.fit(values)
    monkeypatch.setattr(columns, "VALUES", at_a_time)
    done = []
    same, cuts, data = prepare(
        images,
        lengths,
        features,
        Plan(features.count, features.count, 0, 1.0),
        torch.Generator(),
        done.append,
    )
    assert same is features and sum(done) == features.count
    assert torch.equal(cuts.cuts, quantiser.cuts)
    assert torch.equal(data.levels, quantiser.levels(values))
    assert torch.equal(data.order, SortedLevels.build(data.levels).order)


def test_a_sample_of_many_frames_chooses_the_cuts(monkeypatch):
    images, lengths = example()
    features = make_features("rectangles", 12, 16, 70, torch.Generator().manual_seed(1))
    values = features.values(images, previous_images(images, lengths))
    monkeypatch.setattr(columns, "SAMPLED", 30)
    monkeypatch.setattr(columns, "VALUES", 700)
    _, quantiser, data = prepare(images, lengths, features, Plan(70, 70, 20, 1.0), torch.Generator())
    assert torch.equal(data.levels, quantiser.levels(values))
    assert not torch.equal(quantiser.cuts, Quantiser.fit(values).cuts)
    assert len(data.columns) == 0


def test_columns_that_do_not_fit_are_left_out_at_random():
    images, lengths = example()
    features = make_features("rectangles", 12, 16, 70, torch.Generator().manual_seed(1))
    kept, quantiser, data = prepare(
        images, lengths, features, Plan(20, 70, 5, 1.0), torch.Generator().manual_seed(2)
    )
    assert kept.count == len(quantiser.cuts) == data.n_columns == 20
    rows = {tuple(box) for box in features.first.tolist()}
    assert all(tuple(box) in rows for box in kept.first.tolist())


@pytest.mark.parametrize("kind", ["pixels", "rectangles"])
@pytest.mark.parametrize("at_a_time", [2**26, 1000])
def test_mirror_images_come_after_the_frames(monkeypatch, kind, at_a_time):
    images, lengths = example()
    features = make_features(kind, 12, 16, 70, torch.Generator().manual_seed(1))
    plan = Plan(features.count, features.count, 0, 1.0)
    _, quantiser, data = prepare(images, lengths, features, plan, torch.Generator())
    monkeypatch.setattr(columns, "VALUES", at_a_time)
    both = with_mirror_images(data, images, lengths, features, quantiser)
    flipped = images.flip(2)
    values = features.values(flipped, previous_images(flipped, lengths))
    assert torch.equal(both.levels, torch.cat([data.levels, quantiser.levels(values)], 1))
    assert not torch.equal(both.levels[:, :90], both.levels[:, 90:]) and len(both.columns) == 0
