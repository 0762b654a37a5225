"""Table I: how often teacher, baseline and DPBoost succeed, with fixed and with random flags.

    python benchmarks/table1.py --report=docs/results.md
    python benchmarks/table1.py --parts='[main]' --flags='[random]' --planners='[teacher, dpboost-2]'
    python benchmarks/table1.py --quick=true
    python benchmarks/table1.py --worlds=fresh --flags='[random]' --report=docs/results.md

Records demonstrations, trains and tests whatever is not there yet, so that an interrupted run goes on where
it was. Rows are written after every cell to `<output_dir>.json`; those of other cells stay.
"""

import shlex
import signal
import sys
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from datetime import datetime
from pathlib import Path
from typing import Any

from report import header
from table_cells import (
    FLAGS,
    PARTS,
    PLANNERS,
    SEED_WORLDS,
    TEST,
    TRAIN_SEEDS,
    WORLDS,
    Cell,
    Key,
    cells,
    demonstrations_needed,
)
from table_report import main_table, marks, write_report
from table_rows import Row, as_json, stored
from table_runs import Runs, work
from tqdm import tqdm

from dpmacro.utils import cli
from dpmacro.utils.files import replacing
from dpmacro.worlds.base import SUCCESS

QUICK_EPISODES = 30


@dataclass(frozen=True)
class TableOptions:
    """Which cells, and where they are kept."""

    parts: list[str] = field(default_factory=lambda: list(PARTS))
    """main (the table), and in test worlds curve (numbers of demonstrations) and paper (its 320x240)."""
    flags: list[str] = field(default_factory=lambda: list(FLAGS))
    """random, fixed; curve and paper have random flags."""
    planners: list[str] = field(default_factory=lambda: list(PLANNERS))
    """teacher, baseline, dpboost-2, dpboost-2-recovery, dpboost-4, dpboost-2-dagger, paper."""
    worlds: str = TEST
    """Worlds to run in, test (seeds from 10000 on) or fresh (40000 to 40099, no choice was made by them)."""
    train_seeds: list[int] = field(default_factory=lambda: [0, 1, 2])
    """Training seeds, each with demonstrations of its own; curve and paper have the first."""
    demonstrations: int = 20
    """Demonstrations that every planner learns from."""
    curve: list[int] = field(default_factory=lambda: [5, 10, 20, 50, 100])
    """Numbers of demonstrations on the learning curve."""
    episodes: int = 200
    """Runs of every cell; curve, paper and fresh worlds have at most 100. A row keeps those that it has."""
    quick: bool = False
    """Random flags, one training seed, 30 episodes, main table only; rows go to <output_dir>_quick.json."""
    workers: int = 2
    """Processes that record and run; the results do not depend on it."""
    threads: int = 1
    """Threads of every script that is run; leave it at 1 where other work shares the processors."""
    output_dir: Path | None = None
    """Folder of demonstrations, policies and runs; by default outputs/table1, or outputs/table1_fresh."""
    report: Path | None = None
    """Markdown file for the results, between its marks of the worlds; picture and rows go beside it."""

    def __post_init__(self) -> None:
        if self.worlds not in WORLDS:
            raise ValueError(f"worlds is {self.worlds!r}: choose from {', '.join(WORLDS)}")
        for name, known in (("parts", PARTS), ("flags", FLAGS), ("planners", PLANNERS)):
            for value in getattr(self, name):
                if value not in known:
                    raise ValueError(f"{name} has {value!r}: choose from {', '.join(known)}")
        for seed in self.train_seeds:
            if seed not in TRAIN_SEEDS:
                raise ValueError(
                    f"train_seeds has {seed}: give 0 to {TRAIN_SEEDS[-1]}, beyond lie validation worlds"
                )
        for name in ("parts", "flags", "planners", "train_seeds", "curve"):
            if not getattr(self, name):
                raise ValueError(f"{name} is empty: give one at least")
        bounds = {
            "demonstrations": SEED_WORLDS,
            "episodes": len(WORLDS[TEST]),
            "workers": None,
            "threads": None,
        }
        for name, most in bounds.items():
            _check(f"{name} is", getattr(self, name), most)
        for number in self.curve:
            _check("curve has", number, SEED_WORLDS)
        if not self.plan:
            asked = f"{', '.join(self.planners)} in {'quick' if self.quick else ', '.join(self.parts)}"
            raise ValueError(
                f"there is no cell of {asked} with {', '.join(self.flags)} flags: ask for others"
            )

    @property
    def folder(self) -> Path:
        """The folder that is filled."""
        return self.output_dir or Path("outputs") / (
            "table1" if self.worlds == TEST else f"table1_{self.worlds}"
        )

    @property
    def rows(self) -> Path:
        """The file of rows; a quick run has one of its own."""
        return self.folder.with_name(self.folder.name + ("_quick.json" if self.quick else ".json"))

    @property
    def plan(self) -> list[Cell]:
        """The cells."""
        episodes = min(self.episodes, len(WORLDS[self.worlds]))
        if self.quick:
            planners = [name for name in self.planners if not PLANNERS[name].slow]
            episodes = min(episodes, QUICK_EPISODES)
            found = cells(
                ["main"], ["random"], planners, self.train_seeds[:1], self.demonstrations, [], episodes
            )
        else:
            parts = [part for part in self.parts if part == "main" or self.worlds == TEST]
            found = cells(
                parts,
                self.flags,
                self.planners,
                self.train_seeds,
                self.demonstrations,
                self.curve,
                episodes,
            )
        return [replace(cell, role=self.worlds) for cell in found]


def _check(name: str, value: int, most: int | None) -> None:
    """Raise ValueError unless it is from 1 to `most`, beyond which lie worlds with another use."""
    if value < 1 or (most is not None and value > most):
        raise ValueError(f"{name} {value}: give 1 or more" + f", {most} at most" * (most is not None))


def main(options: TableOptions) -> None:
    """Make what is missing, writing the rows as they come; print the table, also of an interrupted run."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    lines = header(shlex.join(["python", *sys.orig_argv[1:]]))
    print("\n".join(lines), flush=True)
    origin = {"date": datetime.now().isoformat(timespec="seconds")}
    origin |= dict(line.split(maxsplit=1) for line in lines)
    rows = read_rows(options.rows, options.worlds)
    plan = [with_all_runs(cell, rows) for cell in options.plan]
    needed = demonstrations_needed(plan)
    try:
        with tqdm(total=work(plan, needed), unit="episode", dynamic_ncols=True) as bar:
            runs = Runs(options.folder, options.workers, options.threads, origin["commit"], needed, bar)
            for cell in plan:
                made = row(cell, *runs.outcomes(cell))
                rows = read_rows(options.rows, options.worlds) | {cell.key: made}
                with replacing(options.rows) as path:
                    path.write_text(as_json({**origin, "rows": list(rows.values())}))
    finally:
        if rows:
            print("\n".join(main_table(list(rows.values()), options.demonstrations)))
            print(f"rows     {options.rows}")
    if options.report is not None:
        found = {**origin, "rows": list(rows.values())}
        write_report(found, options.demonstrations, options.report, options.rows.name, marks(options.worlds))
        print(f"report   {options.report}")


def with_all_runs(cell: Cell, rows: Mapping[Key, Row]) -> Cell:
    """The cell, in as many worlds as its row has runs, where those are more."""
    held = rows[cell.key]["n"] if cell.key in rows else 0
    return replace(cell, episodes=max(cell.episodes, held))


def row(cell: Cell, outcomes: dict[int, str], stamps: list[dict[str, Any]]) -> Row:
    """A cell's results; `per_episode` says of every seed whether its run succeeded."""
    successes = [outcome == SUCCESS for outcome in outcomes.values()]
    trained = stamps[0] if cell.train_seed is not None else None
    return {
        "flags": cell.flags,
        "planner": cell.planner,
        "demonstrations": cell.demonstrations,
        "train_seed": cell.train_seed,
        "render_size": list(cell.render_size),
        "successes": sum(successes),
        "n": len(successes),
        "outcomes": dict(Counter(outcomes.values())),
        "seeds": list(outcomes),
        "per_episode": successes,
        "commits": sorted({stamp["commit"] for stamp in stamps}),
        "training": trained and trained["command"],
        "training_seconds": trained and trained["seconds"],
    }


def read_rows(path: Path, worlds: str = TEST) -> dict[Key, Row]:
    """The rows of every cell in the file, if it is there.

    Raises ValueError where it holds something else, such as runs in worlds of another role.
    """

    def key(row: Row) -> Key:
        if row["planner"] not in PLANNERS or row["n"] != len(row["per_episode"]):
            raise ValueError(f"a row of {row['planner']} that is none")
        if not set(row["seeds"]) <= set(WORLDS[worlds]):
            raise ValueError(f"a row of {row['planner']} in others than {worlds} worlds")
        cell = row["flags"], row["planner"], row["demonstrations"], row["train_seed"]
        return *cell, tuple(row["render_size"])

    return stored(path, key)


if __name__ == "__main__":
    cli.run(main, TableOptions)
