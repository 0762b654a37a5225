"""Statistics of new columns, as meta/stats.json and meta/episodes have them."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pyarrow as pa
from jaxtyping import Bool, Float, Int64, Shaped

__all__ = ["episode_columns", "is_statistic_of", "with_statistics"]

QUANTILES = {"q01": 0.01, "q10": 0.1, "q50": 0.5, "q90": 0.9, "q99": 0.99}


def with_statistics(
    stored: Mapping[str, Any], numbers: Mapping[str, Shaped[np.ndarray, " frames"]], dropped: set[str]
) -> dict[str, Any]:
    """The content of meta/stats.json with entries for new columns, and without those of dropped ones."""
    kept = {name: value for name, value in stored.items() if name not in dropped}
    new = {name: {key: [one] for key, one in _of(values).items()} for name, values in numbers.items()}
    return {**kept, **new}


def episode_columns(
    numbers: Mapping[str, Shaped[np.ndarray, " frames"]], trajectories: list[slice]
) -> dict[str, pa.Array]:
    """Columns `stats/<name>/<statistic>` of meta/episodes, a list of one number for every episode."""
    columns = {}
    for name, values in numbers.items():
        rows = [_of(values[part]) for part in trajectories]
        for key in rows[0]:
            kind = pa.int64() if key == "count" else pa.float64()
            columns[f"stats/{name}/{key}"] = pa.array([[row[key]] for row in rows], pa.list_(kind))
    return columns


def is_statistic_of(column: str, names: set[str]) -> bool:
    """Whether a column of meta/episodes is a statistic of one of these features."""
    return column.startswith("stats/") and column.removeprefix("stats/").rpartition("/")[0] in names


def _of(
    values: Int64[np.ndarray, " frames"] | Float[np.ndarray, " frames"] | Bool[np.ndarray, " frames"],
) -> dict[str, float]:
    real = values.astype(np.float64)
    return {
        "min": float(real.min()),
        "max": float(real.max()),
        "mean": float(real.mean()),
        "std": float(real.std()),
        "count": len(real),
        **{name: float(np.quantile(real, level)) for name, level in QUANTILES.items()},
    }
