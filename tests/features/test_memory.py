"""Plans hold as many columns as fit, and name the memory that would do where none fit."""

from hypothesis import given, settings
from hypothesis import strategies as st

from dpmacro.features.memory import GIB, LEAST_COLUMNS, LIBRARIES, Demand, Plan


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
