"""Plans hold as many columns as fit, and name the memory that would do where none fit."""

from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dpmacro.features.memory import GATHERED, GIB, LEAST_COLUMNS, LIBRARIES, VALUES, Demand, Plan


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


@settings(deadline=None)
@given(
    n_frames=st.integers(10, 300_000),
    n_columns=st.integers(1, 20_000),
    limit=st.floats(1.5, 16),
    ranks=st.integers(2, 8),
)
def test_ranks_hold_a_share_each_within_the_limit(n_frames, n_columns, limit, ranks):
    demand = Demand(n_frames, 100, n_columns, 240, switch_bytes=100)
    try:
        one = Plan.fitting(demand, limit)
        several = Plan.fitting(replace(demand, ranks=ranks), limit)
    except ValueError:
        assert n_frames > 20_000
        return
    assert several.gibibytes <= limit and several.columns >= one.columns
    if one.drawn == 0:
        assert (several.columns, several.drawn) == (one.columns, 0) and several.gibibytes <= one.gibibytes


def test_columns_that_are_never_left_out_set_the_least():
    demand = Demand(150_000, 6912, 4096 + 1078, 200, always=1078, inputs=4)
    limits = [n / 8 for n in range(8, 80)]
    plans = []
    for limit in limits:
        try:
            plans.append(Plan.fitting(demand, limit))
        except ValueError:
            assert not plans, "a larger limit does what a smaller one did"
    assert all(plan.columns >= 1078 and plan.drawn in range(0, plan.columns + 1) for plan in plans)
    assert plans[0].columns < 2000 and plans[-1].columns == 4096 + 1078 and plans[-1].drawn == 0
    assert LEAST_COLUMNS <= plans[0].drawn < 1078, "a round may search fewer than are kept"


@pytest.mark.parametrize(
    ("always", "inputs", "remedies"),
    [
        (0, 1, "give that, shrink images by --dataset.image_size, or take fewer --dataset.episodes"),
        (
            100,
            3,
            "give that, leave out some --dataset.inputs, shrink images by --dataset.image_size, "
            "or take fewer --dataset.episodes",
        ),
        (4096, 2, "give that, leave out some --dataset.inputs, or take fewer --dataset.episodes"),
        (4096, 1, "give that, or take fewer --dataset.episodes"),
    ],
)
def test_what_does_not_fit_has_remedies(always, inputs, remedies):
    with pytest.raises(ValueError) as error:
        Plan.fitting(Demand(10**6, 9216, 4096, 200, always=always, inputs=inputs), 1.0)
    assert str(error.value).endswith(remedies)


def test_copies_of_large_observations_are_made_a_part_at_a_time():
    large = Plan.fitting(Demand(20_000, 200_000, 1000, 12), 100.0)
    assert large.gibibytes * GIB < LIBRARIES + 20_000 * (200_000 + 1000) + GATHERED + 4 * VALUES + 1
