"""Policies in Meta-World: dpmacro beside one learner, true stages, boosted trees, neighbours, a network, ACT.

    python benchmarks/table_metaworld.py --report=docs/metaworld.md
    python benchmarks/table_metaworld.py --tasks='[hammer-v3]' --rows='[dpmacro, trees]' --worlds=validation

Every task is learned from demonstrations of its scripted expert, with noise in its moves, by states alone.
Beside ten tasks of Meta-World there are two worlds whose phase cannot be seen, which need memory.
What is not there yet is recorded, trained and run, so that an interrupted table goes on where it was. Rows
are written after every cell to `<output_dir>/rows.json`.
"""

import csv
import json
import shlex
import signal
import sys
from collections.abc import Iterator
from dataclasses import dataclass, field
from datetime import datetime
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from metaworld_peers import PEERS
from metaworld_report import tables, write_report
from metaworld_run import HIDDEN, RESULT, VALIDATION_SEED, world_of
from report import header
from table_jobs import Job, read_stamp, run
from table_rows import as_json, stored
from tqdm import tqdm

from dpmacro.data.demonstrations import Demonstrations
from dpmacro.utils import cli
from dpmacro.utils.files import replacing
from dpmacro.worlds.metaworld import TASKS as WORLDS

# With at least three stages, and an expert that fails in a tenth of its runs at most.
TASKS = [
    "pick-place-v3",
    "assembly-v3",
    "coffee-push-v3",
    "hammer-v3",
    "box-close-v3",
    "hand-insert-v3",
    "pick-place-wall-v3",
    "bin-picking-v3",
    "disassemble-v3",
    "basketball-v3",
    *HIDDEN,
]
NOISE = 0.1
DEMONSTRATIONS, OF_HIDDEN = 20, 50  # in Meta-World, and where the phase is hidden
SEED_WORLDS = 1000  # of a training seed, whose demonstrations begin at 1000 times it
FIRST_SEED = {"test": 40_000, "validation": VALIDATION_SEED}
PATIENCE = 10  # times the training of dpmacro, for ACT's longer one
MOST = 4  # macro-actions that dpmacro may choose
ROUNDS = 300  # of every macro-action; the one learner has as many as all of them together

OURS = {
    "one": ("--planner.type=baseline", f"--planner.rounds={MOST * ROUNDS}"),
    "dpmacro": ("--planner.macros=auto", f"--planner.max_macros={MOST}", f"--planner.rounds={ROUNDS}"),
    "stages": (f"--planner.rounds={ROUNDS}",),
}
ACT = {"act": 1, "act-10": PATIENCE}  # times dpmacro's training
ROWS = ("expert", *OURS, *PEERS, *ACT)


@dataclass(frozen=True)
class TableOptions:
    """Which cells, and where they are kept."""

    tasks: list[str] = field(default_factory=lambda: list(TASKS))
    """Tasks of Meta-World, and two worlds with a hidden phase."""
    rows: list[str] = field(default_factory=lambda: list(ROWS))
    """expert, one (learner), dpmacro, stages (the true ones), trees, neighbours, network, act, act-10."""
    train_seeds: list[int] = field(default_factory=lambda: [0, 1, 2])
    """Training seeds of one, dpmacro and stages, each with its own demonstrations; others have the first."""
    worlds: str = "test"
    """test (seeds from 40000 on), or validation (from 5000 on)."""
    episodes: int = 100
    """Runs of every cell."""
    workers: int = 2
    """Processes that record and run, and threads of every training."""
    output_dir: Path = Path("outputs/table_metaworld")
    """Folder of demonstrations, policies and runs."""
    report: Path | None = None
    """Markdown file for the results, between its marks."""

    def __post_init__(self) -> None:
        for name, known in (("tasks", (*WORLDS, *HIDDEN)), ("rows", ROWS)):
            for value in getattr(self, name):
                if value not in known:
                    raise ValueError(f"{name} has {value!r}: choose from {', '.join(known)}")
        if self.worlds not in FIRST_SEED:
            raise ValueError(f"worlds is {self.worlds!r}: choose from {', '.join(FIRST_SEED)}")
        for name in ("tasks", "rows", "train_seeds"):
            if not getattr(self, name):
                raise ValueError(f"{name} is empty: give one at least")
        for seed in self.train_seeds:
            if not 0 <= seed < VALIDATION_SEED // SEED_WORLDS:
                raise ValueError(
                    f"train_seeds has {seed}: give 0 to {VALIDATION_SEED // SEED_WORLDS - 1}, "
                    "beyond lie validation worlds"
                )
        for name, most in (("episodes", 1000), ("workers", 64)):
            if not 1 <= getattr(self, name) <= most:
                raise ValueError(f"{name} is {getattr(self, name)}: give 1 to {most}")

    @property
    def plan(self) -> list["Cell"]:
        """The cells: the first training seed, then the others, then ACT's longer trainings."""
        first, *others = self.train_seeds
        ours, slow = (tuple(row for row in self.rows if row in kind) for kind in (OURS, ("act-10",)))
        parts = [([first], [row for row in self.rows if row not in slow]), (others, ours), ([first], slow)]
        return [
            Cell(task, row, seed)
            for seeds, rows in parts
            for seed in seeds
            for task in self.tasks
            for row in rows
        ]


@dataclass(frozen=True)
class Cell:
    """A row's planner in a task, trained by a seed."""

    task: str
    row: str
    seed: int

    @property
    def name(self) -> str:
        """For people, and of its folder."""
        return f"{self.task}_{self.row}" + ("" if self.row == "expert" else f"_{self.seed}")


@dataclass(frozen=True)
class Runs:
    """Makes what a cell needs, where it is not there yet.

    Attributes:
        options: of the table.
        commit: of the code, for stamps.
        bar: tells what is done.
    """

    options: TableOptions
    commit: str
    bar: tqdm

    def row(self, cell: Cell) -> dict[str, Any]:
        """The cell's results."""
        stamps, result = list(self._made(cell)), self._result(cell)
        trained = stamps[0]["cpu_seconds"] if cell.row in OURS else result.get("training_seconds")
        return {
            "task": cell.task,
            "row": cell.row,
            "train_seed": None if cell.row == "expert" else cell.seed,
            "successes": sum(result["per_episode"]),
            "n": len(result["per_episode"]),
            "training_cpu_seconds": trained,
            "milliseconds": result["milliseconds"],
            "numbers": result.get("numbers"),
            "macro_actions": result.get("macro_actions"),
            "act": result.get("act"),
            "seeds": result["seeds"],
            "per_episode": result["per_episode"],
            "commits": sorted({stamp["commit"] for stamp in stamps}),
            "commands": [stamp["command"] for stamp in stamps],
        }

    def _made(self, cell: Cell) -> Iterator[dict[str, Any]]:
        """Stamps of the cell's training, if it is dpmacro's, and of its runs."""
        run_options = [f"--task={cell.task}", f"--planner={cell.row}"]
        others = [f"--workers={self.options.workers}"]
        if cell.row in OURS:
            yield self._trained(cell)
            policy = self._place("train", cell) / "checkpoints/last/pretrained_model"
            run_options[1] = "--planner=policy"
            others.append(f"--policy={policy}")
        elif cell.row != "expert":
            others.append(f"--dataset={self._recorded(cell)}")
            run_options.append(f"--train_seed={cell.seed}")
        if cell.row in ACT:
            seconds = ACT[cell.row] * self._trained(Cell(cell.task, "dpmacro", cell.seed))["cpu_seconds"]
            run_options[1] = "--planner=act"
            others.append(f"--seconds={seconds:.0f}")
        seed, episodes = FIRST_SEED[self.options.worlds], self.options.episodes
        run_options += [f"--seed={seed}", f"--episodes={episodes}"]
        folder = self._place("runs", cell)
        others.append(f"--output_dir={folder}")
        yield self._stamp(
            Job(
                f"running {cell.name}",
                "benchmarks/metaworld_run.py",
                folder,
                tuple(run_options),
                tuple(others),
            )
        )

    def _recorded(self, cell: Cell) -> Path:
        root = self.options.output_dir / "data" / f"{cell.task}_{cell.seed}"
        options = (
            f"--world.id={world_of(cell.task)}",
            f"--episodes={OF_HIDDEN if cell.task in HIDDEN else DEMONSTRATIONS}",
            f"--noise={NOISE}",
            f"--seed={cell.seed * SEED_WORLDS}",
        )
        others = (f"--root={root}", f"--workers={self.options.workers}")
        self._stamp(Job(f"recording {root.name}", "datasets/record.py", root, options, others))
        return root

    def _trained(self, cell: Cell) -> dict[str, Any]:
        root, folder, options = self._recorded(cell), self._place("train", cell), OURS[cell.row]
        others: tuple[str, ...] = (f"--dataset.root={root}", f"--seed={cell.seed}", f"--output_dir={folder}")
        if cell.row == "stages":
            file = root.with_name(f"{root.name}_stages.csv")
            write_stages(root, file)
            options, others = (*options, *bound(file)), (*others, f"--dataset.labels={file}")
        return self._stamp(Job(f"training {cell.name}", "train.py", folder, options, others))

    def _stamp(self, job: Job) -> dict[str, Any]:
        """The stamp of a job that was done with these options, or is now."""
        stamp = read_stamp(job.folder)
        if stamp is not None and tuple(stamp["options"]) == job.options:
            return stamp
        self.bar.set_description(job.doing)
        return run(job, self.commit, self.options.workers, lambda _: None)

    def _result(self, cell: Cell) -> dict[str, Any]:
        return dict(json.loads((self._place("runs", cell) / RESULT).read_text()))

    def _place(self, kind: str, cell: Cell) -> Path:
        kind = kind if kind == "train" else f"{kind}_{self.options.worlds}"
        return self.options.output_dir / kind / cell.name


def write_stages(root: Path, file: Path) -> None:
    """A table of the expert's own stages, as train.py reads it by --dataset.labels."""
    demonstrations = Demonstrations.load(root)
    truth, names = demonstrations.truth, demonstrations.truth_classes
    assert truth is not None, "record.py wrote it"
    with replacing(file) as path, path.open("w", newline="") as out:
        table = csv.writer(out)
        table.writerow(["episode", "start_frame", "end_frame", "label"])
        ends = np.cumsum(demonstrations.lengths)
        for episode, labels in zip(demonstrations.numbers, np.split(truth, ends[:-1]), strict=True):
            edges = [0, *(np.flatnonzero(np.diff(labels)) + 1).tolist(), len(labels)]
            for start, end in pairwise(edges):
                table.writerow([episode, start, end, names[labels[start]]])


def bound(file: Path) -> tuple[str]:
    """The option of train.py that lets every demonstration have the changes that its stages have."""
    with file.open(newline="") as rows:
        episodes = [row["episode"] for row in csv.DictReader(rows)]
    return (f"--planner.max_transitions={max(map(episodes.count, episodes)) - 1}",)


def main(options: TableOptions) -> None:
    """Make what is missing, writing the rows as they come; print the table, also of an interrupted run."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    lines = header(shlex.join(["python", *sys.orig_argv[1:]]))
    print("\n".join(lines), flush=True)
    origin = {"date": datetime.now().isoformat(timespec="seconds")}
    origin |= dict(line.split(maxsplit=1) for line in lines)
    file = options.output_dir / ("rows.json" if options.worlds == "test" else f"rows_{options.worlds}.json")
    rows = stored(file, lambda row: (row["task"], row["row"], row["train_seed"]))
    try:
        with tqdm(options.plan, unit="cell", dynamic_ncols=True) as bar:
            runs = Runs(options, origin["commit"], bar)
            for cell in bar:
                made = runs.row(cell)
                rows[made["task"], made["row"], made["train_seed"]] = made
                with replacing(file) as path:
                    path.write_text(as_json({**origin, "rows": list(rows.values())}))
    finally:
        for shown in tables(list(rows.values())):
            print("\n".join(shown), end="\n\n")
        print(f"rows     {file}")
    if options.report is not None:
        write_report({**origin, "rows": list(rows.values())}, options.report)
        print(f"report   {options.report}")


if __name__ == "__main__":
    cli.run(main, TableOptions)
