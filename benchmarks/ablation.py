"""What each addition to the paper is worth: each left out alone, each in alone, on several kinds of data.

    python benchmarks/ablation.py --report=docs/ablation.md
    python benchmarks/ablation.py --sources='[pick-place-v3, basketball-v3]' --only=false

Every variant is trained from the same demonstrations and run in the same validation worlds (seeds from 5000
on); of a source without a world the segmentation is compared with the truth. What is there already is not
made again. Rows are written after every cell to `<output_dir>/rows.json`. A difference to all additions
together is paired: by run and training seed where policies run, else by data set and seed.
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

from ablated import PARTS
from ablation_report import ALL, NONE, dots, table
from report import header, inserted
from table_jobs import Job, read_stamp, run
from table_rows import Row, as_json, stored
from tqdm import tqdm

from dpmacro import figures
from dpmacro.utils import cli
from dpmacro.utils.files import replacing
from dpmacro.worlds.base import SUCCESS

VALIDATION_SEED, SEED_WORLDS = 5_000, 1_000
MARKS = ("<!-- ablation -->", "<!-- /ablation -->")
AUTO = ("--planner.macros=auto", "--planner.max_macros=4", "--planner.rounds=300")


@dataclass(frozen=True)
class Source:
    """Data that variants learn from.

    Attributes:
        camera, vectors: whether there is a camera, and whether actions are vectors.
        world: options of record.py; () for what bench_segmentation.py segments.
        options: of train.py, or of bench_segmentation.py.
    """

    camera: bool
    vectors: bool
    world: tuple[str, ...] = ()
    options: tuple[str, ...] = ()

    @property
    def parts(self) -> list[str]:
        """The additions that this source can be without."""
        return [
            name
            for name, part in PARTS.items()
            if not (part.camera and not self.camera)
            and not (part.classes and self.vectors)
            and (self.world or part.patches)
        ]


def _metaworld(task: str) -> Source:
    return Source(False, True, (f"--world.id=Meta-World/{task}", "--noise=0.1"), AUTO)


SOURCES = {
    "two-flags": Source(True, False, ("--world.flags=random",), ("--planner.macros=2",)),
    "four-flags": Source(
        True,
        False,
        ("--world.id=FourFlags-v0", "--world.render_size=[64,48]"),
        ("--planner.macros=4",),
    ),
    **{task: _metaworld(task) for task in ("pick-place-v3", "disassemble-v3", "basketball-v3")},
    "digits": Source(False, False, (), ("--sources=[digits]",)),
    "babyai": Source(True, False, (), ("--sources=[babyai]", "--truth=purpose")),
}


@dataclass(frozen=True)
class AblationOptions:
    """Which cells, and where they are kept."""

    sources: list[str] = field(default_factory=lambda: list(SOURCES))
    """two-flags, four-flags, pick-place-v3, disassemble-v3, basketball-v3, digits, babyai."""
    only: bool = True
    """Whether each addition is also tried alone, and none of them."""
    train_seeds: list[int] = field(default_factory=lambda: [0, 1, 2])
    """Training seeds, each with demonstrations of its own."""
    demonstrations: int = 20
    """Demonstrations of every source that is recorded."""
    episodes: int = 100
    """Runs of every policy."""
    workers: int = 2
    """Processes that record and run, and threads of every training."""
    babyai: Path = Path("datasets/babyai")
    """Folder of recorded BabyAI levels."""
    output_dir: Path = Path("outputs/ablation")
    """Folder of demonstrations, policies and runs."""
    report: Path | None = None
    """Markdown file for the results, between its marks; the dot plot goes beside it."""

    def __post_init__(self) -> None:
        for name in self.sources:
            if name not in SOURCES:
                raise ValueError(f"sources has {name!r}: choose from {', '.join(SOURCES)}")
        for name in ("sources", "train_seeds"):
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
        """The cells, those of a training seed before the next."""
        return [
            Cell(source, variant, seed)
            for seed in self.train_seeds
            for source in self.sources
            for variant in variants(SOURCES[source].parts, self.only)
        ]


def variants(parts: Sequence[str], only: bool) -> dict[str, tuple[str, ...]]:
    """What each variant is without: all additions, each left out; and each alone, and none, if asked for."""
    found: dict[str, tuple[str, ...]] = {ALL: ()}
    found |= {f"without {name}": (name,) for name in parts}
    if only:
        found |= {f"only {name}": tuple(other for other in parts if other != name) for name in parts}
        found[NONE] = tuple(parts)
    return found


@dataclass(frozen=True)
class Cell:
    """A variant on a source, by a training seed."""

    source: str
    variant: str
    seed: int

    @property
    def name(self) -> str:
        """Of folders."""
        return f"{self.source}_{self.variant.replace(' ', '-')}_{self.seed}"

    @property
    def without(self) -> tuple[str, ...]:
        """The additions that are left out."""
        return variants(SOURCES[self.source].parts, True)[self.variant]


@dataclass(frozen=True)
class Runs:
    """Makes what a cell needs, where it is not there yet."""

    options: AblationOptions
    commit: str
    bar: tqdm

    def row(self, cell: Cell) -> Row:
        """The cell's results: `values` are successes of runs, or accuracies of frames."""
        values, stamps = self._made(cell)
        told = {"source": cell.source, "variant": cell.variant, "train_seed": cell.seed, "values": values}
        return told | {
            "commits": sorted({stamp["commit"] for stamp in stamps}),
            "commands": [stamp["command"] for stamp in stamps],
        }

    def _made(self, cell: Cell) -> tuple[list[float], list[dict[str, Any]]]:
        source, folder = SOURCES[cell.source], self.options.output_dir
        named = [f"--without={name}" for name in cell.without]
        if not source.world:
            found = folder / "segmented" / cell.name / "rows.json"
            options = (*named, "benchmarks/bench_segmentation.py", "--methods=[dpmacro]", *source.options)
            others = (f"--output={found}", f"--babyai={self.options.babyai}")
            job = self._stamp(
                "benchmarks/ablated.py", found.parent, (*options, f"--seeds=[{cell.seed}]"), others
            )
            rows = [row for row in json.loads(found.read_text()) if row["metric"] == "accuracy"]
            return [float(row["value"]) for row in rows], [job]
        root, training = folder / "data" / f"{cell.source}_{cell.seed}", folder / "train" / cell.name
        given = tuple(option for name in cell.without for option in PARTS[name].options)
        stamps = [
            self._stamp(
                "datasets/record.py",
                root,
                (
                    f"--seed={cell.seed * SEED_WORLDS}",
                    f"--episodes={self.options.demonstrations}",
                    *source.world,
                ),
                (f"--root={root}", f"--workers={self.options.workers}"),
            ),
            self._stamp(
                "benchmarks/ablated.py",
                training,
                (*named, "train.py", *source.options, *given, f"--seed={cell.seed}"),
                (f"--dataset.root={root}", f"--output_dir={training}"),
            ),
            *self._run(cell, training),
        ]
        info = json.loads((folder / "runs" / cell.name / "eval_info.json").read_text())
        return [float(outcome == SUCCESS) for outcome in info["dpmacro"]["outcomes"]], stamps

    def _run(self, cell: Cell, training: Path) -> Iterator[dict[str, Any]]:
        source, folder = SOURCES[cell.source], self.options.output_dir / "runs" / cell.name
        told = [f"--seed={VALIDATION_SEED}", f"--episodes={self.options.episodes}"]
        if not source.vectors:
            told.append(f"--policy.recovery={'recovery' not in cell.without}".lower())
        policy = training / "checkpoints/last/pretrained_model"
        others = (
            f"--policy.path={policy}",
            f"--workers={self.options.workers}",
            f"--output_dir={folder}",
        )
        yield self._stamp("eval.py", folder, tuple(told), others)

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


def main(options: AblationOptions) -> None:
    """Make what is missing, writing the rows as they come; print the table, also of an interrupted run."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    lines = header(shlex.join(["python", *sys.orig_argv[1:]]))
    print("\n".join(lines), flush=True)
    origin = {"date": datetime.now().isoformat(timespec="seconds")}
    origin |= dict(line.split(maxsplit=1) for line in lines)
    file = options.output_dir / "rows.json"
    rows = stored(file, lambda row: (row["source"], row["variant"], row["train_seed"]))
    try:
        with tqdm(options.plan, unit="cell", dynamic_ncols=True) as bar:
            runs = Runs(options, origin["commit"], bar)
            for cell in bar:
                made = runs.row(cell)
                rows[made["source"], made["variant"], made["train_seed"]] = made
                with replacing(file) as path:
                    path.write_text(as_json({**origin, "rows": list(rows.values())}))
    finally:
        if rows:
            print("\n".join(table(list(rows.values()))))
        print(f"rows     {file}")
    if options.report is not None:
        kept = options.report.read_text() if options.report.exists() else ""
        text = f"    {origin['command']}\n\n" + "\n".join(table(list(rows.values())))
        figures.save(dots(list(rows.values())), options.report.with_suffix(".png"))
        with replacing(options.report) as path:
            path.write_text(inserted(kept, text, MARKS))
        print(f"report   {options.report}")


if __name__ == "__main__":
    cli.run(main, AblationOptions)
