"""The table of policies in Meta-World as markdown."""

from collections import defaultdict
from collections.abc import Iterable, Sequence
from pathlib import Path
from statistics import fmean
from typing import Any

from metaworld_peers import PEERS
from metaworld_run import HIDDEN
from report import inserted, markdown
from table_rows import as_json

from dpmacro.metrics.success import wilson_interval
from dpmacro.utils.files import replacing

__all__ = ["MARKS", "TITLES", "tables", "write_report"]

MARKS = ("<!-- table -->", "<!-- /table -->")
TITLES = {
    "expert": "expert",
    "one": "one learner, 1,200 rounds",
    "dpmacro": "dpmacro, macro-actions by the data",
    "stages": "dpmacro, the expert's stages",
    **{name: recipe.title for name, recipe in PEERS.items()},
    "act": "ACT, trained as long as dpmacro",
    "act-10": "ACT, trained ten times as long",
}
Row = dict[str, Any]


def tables(rows: Sequence[Row]) -> list[list[str]]:
    """The table of Meta-World, and that of the worlds whose phase is hidden."""
    parts = [[row for row in rows if (row["task"] in HIDDEN) == hidden] for hidden in (False, True)]
    return [main_table(part) for part in parts if part]


def main_table(rows: Sequence[Row]) -> list[str]:
    """A line for every planner, a column for every task, then the mean and what the planner costs."""
    tasks = list(dict.fromkeys(row["task"] for row in rows))
    lines = []
    for name in (name for name in TITLES if any(row["row"] == name for row in rows)):
        own = [row for row in rows if row["row"] == name]
        by_task = {task: [row for row in own if row["task"] == task] for task in tasks}
        complete = all(by_task.values())
        lines.append(
            [
                TITLES[name],
                *(_percent(*_pooled(found)) if found else "" for found in by_task.values()),
                f"{fmean(_rate(found) for found in by_task.values()):.1%}" if complete else "",
                _interval(*_pooled(own)),
                _mean([row["training_cpu_seconds"] for row in own], "{:.0f}"),
                _mean([row["milliseconds"]["mean"] for row in own], "{:.2f}"),
                _mean([row["numbers"] for row in own], "{:,.0f}"),
            ]
        )
    short = [task.removesuffix("-v3") for task in tasks]
    costs = ["mean", "95% interval", "training, CPU s", "an action, ms", "numbers stored"]
    return markdown(["success, %", *short, *costs], lines)


def write_report(found: Row, path: Path) -> None:
    """Put the tables between the marks of a markdown file, the rows beside it."""
    rows, name = found["rows"], f"{path.stem}.json"
    origin = [
        f"Trained and run at commit {', '.join(sorted({c for row in rows for c in row['commits']}))}; "
        f"written {found['date']}.",
        f"{found['machine']}; {found['versions']}.",
        f"Every run's outcome and every command is in [{name}]({name}).",
        "",
        f"    {found['command']}",
    ]
    text = "\n\n".join("\n".join(block) for block in (origin, *tables(rows), seeds_table(rows)))
    kept = path.read_text() if path.exists() else ""
    with replacing(path) as temporary:
        temporary.write_text(inserted(kept, text, MARKS))
    with replacing(path.with_name(name)) as temporary:
        temporary.write_text(as_json(found))


def seeds_table(rows: Sequence[Row]) -> list[str]:
    """Successes and runs of every training seed, and the macro-actions that were chosen."""
    cells: dict[tuple[str, str], list[str]] = defaultdict(list)
    for row in sorted(rows, key=lambda row: (row["row"], row["train_seed"] or 0)):
        if row["macro_actions"] is not None and row["row"] != "one":
            macros = f" ({row['macro_actions']})" if row["row"] == "dpmacro" else ""
            cells[row["row"], row["task"]].append(f"{row['successes']}{macros}")
        elif row["row"] == "one":
            cells["one", row["task"]].append(str(row["successes"]))
    tasks = list(dict.fromkeys(row["task"] for row in rows))
    names = [name for name in TITLES if any(own == name for own, _ in cells)]
    lines = [[TITLES[name], *(", ".join(cells[name, task]) for task in tasks)] for name in names]
    short = [task.removesuffix("-v3") for task in tasks]
    return markdown(["successes by training seed (macro-actions)", *short], lines)


def _pooled(rows: Iterable[Row]) -> tuple[int, int]:
    found = list(rows)
    return sum(row["successes"] for row in found), sum(row["n"] for row in found)


def _rate(rows: Iterable[Row]) -> float:
    successes, runs = _pooled(rows)
    return successes / runs


def _percent(successes: int, runs: int) -> str:
    return f"{100 * successes / runs:.0f}"


def _interval(successes: int, runs: int) -> str:
    low, high = wilson_interval(successes, runs)
    return f"{low:.1%} to {high:.1%}"


def _mean(values: Iterable[float | None], form: str) -> str:
    known = [value for value in values if value is not None]
    return form.format(fmean(known)) if known else ""
