"""Rooms with flags beyond Table I: what stays fixed from run to run, a better teacher, more flags.

    python benchmarks/table_flags.py --report=docs/results.md
    python benchmarks/table_flags.py --worlds='[flags-0, still-0]' --planners='[teacher, baseline]'

In the worlds flags-k the places of the flags are fixed, by layout k, as in Table I; in still-k textures and
start are, too, but for the heading. In searching a teacher demonstrates that looks behind flags. In four and
six there are more flags, to be touched in order, with clear ways. Whatever is there already is not made
again; rows are written after every cell to `<output_dir>/rows.json`.
"""

import json
import shlex
import signal
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Any

from flags_cells import PLANNERS, RECOVERY, TEACHER, WORLDS, title
from report import header, inserted, markdown
from table_jobs import Job, read_stamp, run
from table_rows import Row, as_json, stored
from tqdm import tqdm

from dpmacro.metrics.success import wilson_interval
from dpmacro.utils import cli
from dpmacro.utils.files import replacing
from dpmacro.utils.hparams import read_scores
from dpmacro.worlds.base import SUCCESS

SEED_WORLDS = 1_000  # of a training seed, whose demonstrations begin at 1000 times it
VALIDATION_SEED, TEST_SEED = 5_000, 50_000
MARKS = ("<!-- flags -->", "<!-- /flags -->")


@dataclass(frozen=True)
class FlagsOptions:
    """Which cells, and where they are kept."""

    worlds: list[str] = field(default_factory=lambda: list(WORLDS))
    """flags-0 to flags-4, still-0 to still-4, searching, four, six."""
    planners: list[str] = field(default_factory=list)
    """teacher, baseline, two, four, six, auto, dagger, paper-1, paper-2, paper-4, and with recovery
    two-recovery, four-recovery, six-recovery, auto-recovery; by default all that belong to a world."""
    train_seeds: list[int] = field(default_factory=lambda: [0])
    """Training seeds, each with demonstrations of its own."""
    demonstrations: int = 20
    """Demonstrations that every planner learns from."""
    validation: bool = False
    """Whether to run in validation worlds (seeds from 5000 on) in place of test worlds (from 50000 on)."""
    episodes: int = 100
    """Runs of every cell."""
    workers: int = 2
    """Processes that record and run, and threads of every training."""
    output_dir: Path = Path("outputs/table_flags")
    """Folder of demonstrations, policies and runs."""
    report: Path | None = None
    """Markdown file for the results, between its marks."""

    def __post_init__(self) -> None:
        known = {name for world in WORLDS.values() for name in world.planners}
        for name, choices in (("worlds", WORLDS), ("planners", sorted(known))):
            for value in getattr(self, name):
                if value not in choices:
                    raise ValueError(f"{name} has {value!r}: choose from {', '.join(choices)}")
        for name in ("worlds", "train_seeds"):
            if not getattr(self, name):
                raise ValueError(f"{name} is empty: give one at least")
        for seed in self.train_seeds:
            if not 0 <= seed < VALIDATION_SEED // SEED_WORLDS:
                raise ValueError(f"train_seeds has {seed}: give 0 to {VALIDATION_SEED // SEED_WORLDS - 1}")
        for name, most in (("demonstrations", SEED_WORLDS), ("episodes", 1000), ("workers", 64)):
            if not 1 <= getattr(self, name) <= most:
                raise ValueError(f"{name} is {getattr(self, name)}: give 1 to {most}")

    @property
    def plan(self) -> list["Cell"]:
        """The cells, all of a training seed before the next; the teacher's once."""
        return [
            Cell(world, name, seed)
            for place, seed in enumerate(self.train_seeds)
            for world in self.worlds
            for name in WORLDS[world].planners
            if (not self.planners or name in self.planners) and (name != TEACHER or place == 0)
        ]


@dataclass(frozen=True)
class Cell:
    """A planner in a world, trained by a seed."""

    world: str
    planner: str
    seed: int

    @property
    def trained(self) -> str:
        """The planner whose policy it runs."""
        return self.planner.removesuffix(RECOVERY)


@dataclass(frozen=True)
class Runs:
    """Makes what a cell needs, where it is not there yet."""

    options: FlagsOptions
    commit: str
    bar: tqdm

    def row(self, cell: Cell) -> Row:
        """The cell's results."""
        stamps, teacher = list(self._made(cell)), cell.planner == TEACHER
        found = json.loads((self._runs(cell) / "eval_info.json").read_text())["dpmacro"]
        return {
            "world": cell.world,
            "planner": cell.planner,
            "train_seed": None if teacher else cell.seed,
            "per_episode": [outcome == SUCCESS for outcome in found["outcomes"]],
            "seeds": found["seeds"],
            "outcomes": found["outcomes"],
            "causes": found["causes"],
            "training": None if teacher else read_scores(self._policy(cell)),
            "commits": sorted({stamp["commit"] for stamp in stamps}),
            "commands": [stamp["command"] for stamp in stamps],
        }

    def _made(self, cell: Cell) -> Iterator[dict[str, Any]]:
        """Stamps of the recording and training, and of the runs."""
        world, options = WORLDS[cell.world], self.options
        seed = VALIDATION_SEED if options.validation else TEST_SEED
        told = [f"--seed={seed}", f"--episodes={options.episodes}"]
        others = [f"--workers={options.workers}"]
        if cell.planner == TEACHER:
            told += ["--policy.type=teacher", *world.options]
        else:
            root = options.output_dir / "data" / f"{cell.world}_{cell.seed}"
            recorded = (
                f"--seed={cell.seed * SEED_WORLDS}",
                f"--episodes={options.demonstrations}",
                *world.options,
            )
            yield self._stamp("datasets/record.py", root, recorded, (f"--root={root}", *others))
            folder = options.output_dir / "train" / f"{cell.world}_{cell.trained}_{cell.seed}"
            given = PLANNERS[cell.trained][1] + world.more * (cell.trained != "baseline")
            where = (f"--dataset.root={root}", f"--output_dir={folder}")
            yield self._stamp("train.py", folder, (*given, f"--seed={cell.seed}"), where)
            others.append(f"--policy.path={self._policy(cell)}")
            told += ["--policy.recovery=true"] * cell.planner.endswith(RECOVERY)
        folder = self._runs(cell)
        yield self._stamp("eval.py", folder, tuple(told), (*others, f"--output_dir={folder}"))

    def _stamp(
        self, script: str, folder: Path, options: tuple[str, ...], others: tuple[str, ...]
    ) -> dict[str, Any]:
        """The stamp of a job that was done with these options, or is now."""
        stamp = read_stamp(folder)
        if stamp is not None and tuple(stamp["options"]) == options:
            return stamp
        job = Job(f"{script} {folder.name}", script, folder, options, others)
        self.bar.set_description(job.doing)
        return run(job, self.commit, self.options.workers, lambda _: None)

    def _policy(self, cell: Cell) -> Path:
        name = f"{cell.world}_{cell.trained}_{cell.seed}"
        return self.options.output_dir / "train" / name / "checkpoints/last/pretrained_model"

    def _runs(self, cell: Cell) -> Path:
        kind = "validation" if self.options.validation else "test"
        name = f"{cell.world}_{cell.planner}" + ("" if cell.planner == TEACHER else f"_{cell.seed}")
        return self.options.output_dir / f"runs_{kind}" / name


def tables(rows: Sequence[Row]) -> list[list[str]]:
    """A table for every kind of world: a line for every planner, a column for every world."""
    kinds: dict[str, list[str]] = {}
    for name in WORLDS:
        if any(row["world"] == name for row in rows):
            kinds.setdefault(name.split("-")[0], []).append(name)
    return [_table([row for row in rows if row["world"] in worlds], worlds) for worlds in kinds.values()]


def _table(rows: Sequence[Row], worlds: Sequence[str]) -> list[str]:
    lines = []
    for name in dict.fromkeys(name for world in worlds for name in WORLDS[world].planners):
        own = [row for row in rows if row["planner"] == name]
        if own:
            runs = [one for row in own for one in row["per_episode"]]
            low, high = wilson_interval(sum(runs), len(runs))
            cells = [_cell([row for row in own if row["world"] == world]) for world in worlds]
            pooled = f"{sum(runs)} of {len(runs)} ({low:.1%} to {high:.1%})"
            lines.append([title(name), *cells, pooled])
    return markdown(["successes", *(WORLDS[world].title for world in worlds), "in all"], lines)


def _cell(rows: Sequence[Row]) -> str:
    """Successes by training seed, and the macro-actions that were found."""
    return ", ".join(
        f"{sum(row['per_episode'])}"
        + (
            f" (Q={row['training']['macro_actions']:.0f})"
            if (row["training"] or {}).get("recognised")
            else ""
        )
        for row in rows
    )


def main(options: FlagsOptions) -> None:
    """Make what is missing, writing the rows as they come; print the tables, also of an interrupted run."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    lines = header(shlex.join(["python", *sys.orig_argv[1:]]))
    print("\n".join(lines), flush=True)
    origin = {"date": datetime.now().isoformat(timespec="seconds")}
    origin |= dict(line.split(maxsplit=1) for line in lines)
    file = options.output_dir / ("rows_validation.json" if options.validation else "rows.json")
    rows = stored(file, lambda row: (row["world"], row["planner"], row["train_seed"]))
    try:
        with tqdm(options.plan, unit="cell", dynamic_ncols=True) as bar:
            runs = Runs(options, origin["commit"], bar)
            for cell in bar:
                made = runs.row(cell)
                rows[made["world"], made["planner"], made["train_seed"]] = made
                with replacing(file) as path:
                    path.write_text(as_json({**origin, "rows": list(rows.values())}))
    finally:
        for shown in tables(list(rows.values())):
            print("\n".join(shown), end="\n\n")
        print(f"rows     {file}")
    if options.report is not None:
        text = "\n\n".join("\n".join(block) for block in tables(list(rows.values())))
        told = f"At commit {', '.join(sorted({c for row in rows.values() for c in row['commits']}))}:\n\n"
        kept = options.report.read_text() if options.report.exists() else ""
        with replacing(options.report) as path:
            path.write_text(inserted(kept, f"{told}    {origin['command']}\n\n{text}", MARKS))
        print(f"report   {options.report}")


if __name__ == "__main__":
    cli.run(main, FlagsOptions)
