"""Options that would fill memory or never end are refused by name, before anything is read."""

from pathlib import Path

import pytest

from dpmacro.training.dagger_options import DaggerOptions
from dpmacro.training.options import DatasetOptions, PlannerOptions, TrainOptions


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (
            lambda: PlannerOptions(rectangles=300_000_000),
            r"rectangles is 300000000: give 1000000",
        ),
        (lambda: PlannerOptions(macros=10**9), r"planner\.macros is 1000000000: give 1000 or less"),
        (lambda: PlannerOptions(macros=True), r"planner\.macros is True: give a whole number"),
        (lambda: PlannerOptions(max_macros=10**9), r"planner\.max_macros is 1000000000: give 1000 or less"),
        (
            lambda: PlannerOptions(max_transitions=10**9),
            r"max_transitions is 1000000000: give 1048576",
        ),
        (lambda: PlannerOptions(restarts=10**9), r"planner\.restarts is 1000000000: give 100000 or less"),
        (lambda: PlannerOptions(rounds=10**9), r"planner\.rounds is 1000000000: give 1000000 or less"),
        (
            lambda: DaggerOptions(seed=2**64),
            r"dagger\.seed is 18446744073709551616: give",
        ),
        (lambda: DaggerOptions(workers=10**9), r"dagger\.workers is 1000000000: give 100000 or less"),
        (lambda: DatasetOptions(image_size=(40000, 30000)), r"dataset\.image_size is \[40000, 30000\]: give"),
        (
            lambda: TrainOptions(DatasetOptions(Path("x")), seed=10**30),
            r"seed is 10+: give 92233",
        ),
        (
            lambda: TrainOptions(DatasetOptions(Path("x")), device="meta"),
            r"device 'meta' is not available here",
        ),
    ],
)
def test_an_option_beyond_all_bounds_is_named(make, message):
    with pytest.raises(ValueError, match=message):
        make()
