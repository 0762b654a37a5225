"""Our times, accuracies and memory beside those of the libraries one could use instead, as one table.

python benchmarks/bench.py --only='[round, segmentation]' --matrices='[random]' --quick=true

Every number comes from a process of its own, one after another. A peer that is not installed is skipped.
"""

import shlex
import signal
import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import acting
import alternation
import matrices
import rounds
import segmentations
import stumps
import training
from plan import Plan
from report import Row, header, table, write

from dpmacro.utils import cli

NOTES = """\
Seconds are medians after a warm-up; ratio is ours / peer's; accuracies are of training / held-out frames.
round: LightGBM, XGBoost and HistGradientBoosting add a tree for every class; ours and AdaBoost add one stump
with votes for all classes. The accuracies are after the same number of rounds.
accuracy: from the uint8 matrix to LightGBM's held-out accuracy after its last round, binning included; ours
stops at the first round that has it, looked up on the held-out frames, or after as long; one run each.
memory: the peak of the whole process, libraries and the matrix included; held-out frames only where it boosts
to an accuracy.
segmentation: Numba finds the same optimum; hmmlearn decodes a hidden Markov model of that size instead."""


def steps(plan: Plan) -> Iterator[Row]:
    """Environment steps per second."""
    found = plan.attempt("steps.rows", repeats=plan.repeats, quick=plan.quick)
    for row in found["rows"] if found else []:
        yield Row(**{name: value for name, value in row.items() if name != "ratio"})


BENCHMARKS: dict[str, Callable[[Plan], Iterator[Row]]] = {
    "round": rounds.rows,
    "accuracy": rounds.rows_to_accuracy,
    "dpboost": alternation.rows,
    "segmentation": segmentations.rows,
    "training": training.rows,
    "acting": acting.rows,
    "steps": steps,
}


@dataclass(frozen=True)
class BenchOptions:
    """What to measure, and how thoroughly."""

    only: list[str] = field(default_factory=lambda: list(BENCHMARKS))
    """Benchmarks to run, out of round, accuracy, dpboost, segmentation, training, acting and steps."""
    matrices: list[str] = field(default_factory=lambda: list(matrices.KINDS))
    """Data to boost on, out of pixels, rectangles and random."""
    peers: list[str] = field(default_factory=lambda: list(rounds.PEERS))
    """Libraries whose rounds are timed beside ours."""
    learners: list[str] = field(default_factory=lambda: list(stumps.OPTIONS))
    """Ours to measure; the exact search is always in the first benchmark."""
    repeats: int = 5
    """Runs that a median is over; boosting rounds are six times as many."""
    threads: int = 2
    """Threads of every measurement, ours and the peers'."""
    quick: bool = False
    """Small data; shows that everything runs, not what it takes."""
    dataset: Path = Path("datasets/two_flags_random")
    """Recorded demonstrations."""
    output: Path = Path("outputs/bench.json")
    """Where the rows go, after each one."""

    def __post_init__(self) -> None:
        known = {
            "only": BENCHMARKS,
            "matrices": matrices.KINDS,
            "peers": rounds.PEERS,
            "learners": stumps.OPTIONS,
        }
        for name, choices in known.items():
            for value in getattr(self, name):
                if value not in choices:
                    raise ValueError(f"{name} has {value!r}: choose from {', '.join(choices)}")
        for name in ("repeats", "threads"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} is {getattr(self, name)}: give 1 or more")


def main(options: BenchOptions) -> None:
    """Measure, writing every row as it comes; print the table, also of an interrupted run."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    print("\n".join(header(shlex.join(["python", *sys.orig_argv[1:]]))), flush=True)
    rows: list[Row] = []
    with tempfile.TemporaryDirectory(prefix="dpmacro-bench-") as scratch:
        plan = Plan(
            options.repeats,
            options.threads,
            options.quick,
            options.dataset,
            tuple(options.matrices),
            tuple(options.peers),
            tuple(options.learners),
            Path(scratch),
        )
        try:
            for name in options.only:
                for row in BENCHMARKS[name](plan):
                    rows.append(row)
                    write(rows, options.output)
                    print("  ".join(row.cells()), file=sys.stderr)
        finally:
            print("\n".join([*table(rows), NOTES, *dict.fromkeys(plan.remarks)]))
    if plan.failures:
        raise ValueError(f"{plan.failures} measurements failed: the lines above say why")


if __name__ == "__main__":
    cli.run(main, BenchOptions)
