"""What the rows of Table I say: counts, planners side by side in the same worlds, points of the curve."""

import json
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

from table_cells import DEFAULT_SIZE, PLANNERS, SWEEP, TEACHER

from dpmacro.metrics.success import Paired, mcnemar

__all__ = ["Row", "as_json", "count", "curve_points", "groups", "paired", "pooled", "stored", "sweep_seed"]

Row = dict[str, Any]


def as_json(found: Row) -> str:
    """The text of a file of rows, one a line, after where they come from."""
    origin = json.dumps({name: value for name, value in found.items() if name != "rows"}, indent=1)
    lines = ",\n".join(json.dumps(row) for row in found["rows"])
    return origin.removesuffix("\n}") + f',\n "rows": [\n{lines}\n ]\n}}\n'


def stored(path: Path, key: Callable[[Row], Any]) -> dict[Any, Row]:
    """The rows of a file by their key, {} where it is not there.

    `key` may raise ValueError for a row that does not belong there. Raises ValueError where the file holds
    something else than rows of the table.
    """
    if not path.exists():
        return {}
    try:
        return {key(row): row for row in json.loads(path.read_text())["rows"]}
    except (ValueError, KeyError, TypeError) as error:
        raise ValueError(
            f"{path} holds no rows of this table ({error}): give another --output_dir"
        ) from error


def count(row: Row, runs: int | None = None) -> tuple[int, int]:
    """Successes and runs; at most the first `runs`."""
    of = row["per_episode"][:runs]
    return sum(of), len(of)


def pooled(group: Iterable[Row]) -> tuple[int, int]:
    """Successes and runs of all rows."""
    counts = [count(row) for row in group]
    return sum(successes for successes, _ in counts), sum(runs for _, runs in counts)


def groups(
    rows: Iterable[Row], flags: str, demonstrations: int, size: tuple[int, int] = DEFAULT_SIZE
) -> dict[str, list[Row]]:
    """Planner -> its rows, one for every training seed; the teacher's whatever demonstrations and size."""
    found: dict[str, list[Row]] = {}
    for name in PLANNERS:
        for row in rows:
            learned = row["demonstrations"] == demonstrations and tuple(row["render_size"]) == size
            if row["flags"] == flags and row["planner"] == name and (learned or name == TEACHER):
                found.setdefault(name, []).append(row)
    return {name: sorted(group, key=lambda row: row["train_seed"] or 0) for name, group in found.items()}


def paired(first: Sequence[Row], second: Sequence[Row], runs: int | None = None) -> Paired | None:
    """Compare rows in the worlds that they share, training seed by training seed; None where there is none.

    A row without a training seed, the teacher's, is paired with every row of the other. At most the first
    `runs` worlds of a row count.
    """
    one: list[bool] = []
    other: list[bool] = []
    for a in first:
        for b in second:
            if a["train_seed"] == b["train_seed"] or None in (a["train_seed"], b["train_seed"]):
                mine, its = _successes(a, runs), _successes(b, runs)
                worlds = [seed for seed in mine if seed in its]
                one += [mine[seed] for seed in worlds]
                other += [its[seed] for seed in worlds]
    return mcnemar(one, other) if one else None


def sweep_seed(rows: Iterable[Row]) -> int:
    """The first training seed there is: the learning curve and the paper's rendering have no other."""
    return min((row["train_seed"] for row in rows if row["train_seed"] is not None), default=0)


def curve_points(rows: Iterable[Row], seed: int) -> dict[str, dict[int, tuple[int, int]]]:
    """Planner -> demonstrations -> (successes, runs), random flags; {} unless some planner has two points."""
    points: dict[str, dict[int, tuple[int, int]]] = {}
    for row in sorted(rows, key=lambda row: row["demonstrations"]):
        of_curve = row["train_seed"] == seed and tuple(row["render_size"]) == DEFAULT_SIZE
        if row["flags"] == "random" and of_curve and PLANNERS[row["planner"]].swept:
            points.setdefault(row["planner"], {})[row["demonstrations"]] = count(row, SWEEP)
    return points if any(len(counts) > 1 for counts in points.values()) else {}


def _successes(row: Row, runs: int | None) -> dict[int, bool]:
    return dict(zip(row["seeds"][:runs], row["per_episode"][:runs], strict=True))
