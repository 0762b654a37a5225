"""Why planners fail: causes with their shares, and pictures of one failed run of each.

    python benchmarks/failures.py --runs='outputs/table1/eval/random_0_dpboost-2_20 outputs/...' \
        --teacher=outputs/table1/eval/random_teacher --stills=docs/failures.png --report=docs/results.md

Counts what eval.py found. For the pictures the runs are run again, on the CPU and with the same policy; they
must end as they did.
"""

import os
import shlex
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Any

from failure_runs import Run, by_cause, example, read_runs, stills
from matplotlib.figure import Figure
from report import inserted
from tqdm import tqdm

from dpmacro import figures
from dpmacro.metrics.success import wilson_interval
from dpmacro.utils import cli
from dpmacro.utils.files import replacing
from dpmacro.worlds.two_flags.scene import FLAGS

MARKS = ("<!-- failures -->", "<!-- /failures -->")
ROWS = 5  # causes in pictures, the most frequent ones
MEANINGS = {
    "changed_early": "A flag (of two, blue) was not reached, yet a macro-action from after it was running.",
    "change_missed": "A flag (of two, blue) was reached, yet a macro-action from before it was running.",
    "red_in_the_way": "Red was touched on the way to blue, though no macro-action came too early.",
    **{
        f"{flag}_in_the_way": f"{flag} was touched before its turn, though no macro-action came too early."
        for flag in FLAGS[2:]
    },
    "pressed": "At the end the avatar walked against a wall or flag and hardly moved.",
    "spins": "At the end the avatar turned on the spot, a whole turn: no flag was recognised.",
    "dithers": "At the end the avatar turned on the spot, left and right in turn.",
    "out_of_time": "None of the others: it walked and turned, and left its circles, until its steps ran out.",
}
EXPLAINED = f"""\
A row is one failed run of a cause, the {ROWS} most frequent at most, where possible in a world in which the
teacher succeeds. A picture's frame has the colour of the macro-action that was running; the phase is 1 once
blue was touched."""


@dataclass(frozen=True)
class FailureOptions:
    """Which runs, and where results go."""

    runs: str
    """Folders separated by blanks; each holds eval_info.json, or has subfolders that do."""
    teacher: str | None = None
    """Folders of the teacher's runs in the same worlds, to tell where it fails, too."""
    stills: Path | None = None
    """PNG to draw one failed run of each of the five most frequent causes into."""
    report: Path | None = None
    """Markdown file to put the results into, between its two failure marks."""

    def __post_init__(self) -> None:
        if self.stills is not None and self.stills.suffix != ".png":
            raise ValueError(f"--stills={self.stills}: give a file that ends in .png")


def main(options: FailureOptions) -> None:
    runs = read_runs(options.runs)
    lost = None if options.teacher is None else lost_worlds(read_runs(options.teacher), runs)
    lines = text(runs, lost)
    print("\n".join(lines))
    picture = options.stills if any(run.cause for run in runs) else None
    report = None if options.report is None else with_results(options.report, lines, picture)
    if picture is not None:
        figures.save(picture_of(runs, lost or []), picture)
        print(f"stills   {picture}")
    if options.report is not None and report is not None:
        with replacing(options.report) as path:
            path.write_text(report)
        print(f"report   {options.report}")


def lost_worlds(teacher: Sequence[Run], runs: Sequence[Run]) -> list[tuple[Any, ...]]:
    """The worlds of `runs` that the teacher fails in; raises ValueError where it lacks one of them."""
    for run in teacher:
        if run.source.path is not None:
            raise ValueError(f"{run.info} has runs of {run.source.path}: --teacher needs the teacher's")
    failed = {run.where: bool(run.cause) for run in teacher}
    for run in runs:
        if run.where not in failed:
            raise ValueError(
                f"the teacher has no run with seed {run.seed} in the world of {run.info}: run eval.py "
                "--policy.type=teacher with the same seeds and world"
            )
    return sorted({run.where for run in runs if failed[run.where]}, key=str)


def text(runs: Sequence[Run], lost: Sequence[tuple[Any, ...]] | None = None) -> list[str]:
    """How many runs fail, and a markdown table of the causes.

    Args:
        runs: all, successes included.
        lost: worlds that the teacher fails in; None leaves its column out.
    """
    groups = by_cause(runs)
    failures = [run for group in groups.values() for run in group]
    seeds = [run.seed for run in runs]
    flags = " and ".join(sorted({str(run.world.get("flags")) for run in runs}))
    first = f"{len(failures)} of {len(runs)} runs fail ({flags} flags, seeds {min(seeds)} to {max(seeds)})"
    if lost is not None:
        both = sum(run.where in lost for run in failures)
        worlds = len({run.where for run in runs})
        first += f", {both} of them where the teacher fails, too; it does in {len(lost)} of {worlds} worlds"
    if not failures:
        return [first + "."]
    headings = ["cause", "runs", "of the failures", "95% Wilson interval"]
    headings += ["teacher fails, too"] * (lost is not None) + ["median steps", "what it means"]
    lines = [first + ".", "", _line(headings), _line(["---"] * len(headings))]
    for cause, group in groups.items():
        low, high = wilson_interval(len(group), len(failures))
        cells = [cause.replace("_", " "), str(len(group))]
        cells += [f"{len(group) / len(failures):.0%}", f"{low:.0%} to {high:.0%}"]
        cells += [str(sum(run.where in lost for run in group))] if lost is not None else []
        lines.append(_line([*cells, f"{median(run.steps for run in group):.0f}", MEANINGS[cause]]))
    return lines


def picture_of(runs: Sequence[Run], lost: Sequence[tuple[Any, ...]]) -> Figure:
    """A row of stills for each of the most frequent causes, with a progress bar over the steps to run."""
    groups = by_cause(runs)
    failures = sum(map(len, groups.values()))
    chosen = {cause: example(group, lost) for cause, group in list(groups.items())[:ROWS]}
    strips = []
    with tqdm(desc="Running again", total=sum(run.steps for run in chosen.values()), unit="step") as bar:
        for cause, run in chosen.items():
            note = f"{len(groups[cause])} of {failures} failures\nseed {run.seed}"
            note += f"\nafter {run.steps} steps:\n{run.outcome.replace('_', ' ')}"
            strips.append(figures.Strip(cause.replace("_", " "), note, stills(run, bar)))
    return figures.film_strips(strips)


def with_results(report: Path, lines: Sequence[str], picture: Path | None) -> str:
    """What the report is to hold: as it was, but for what is between the marks."""
    shown = []
    if picture is not None:
        link = Path(os.path.relpath(picture, report.parent)).as_posix()
        shown = ["", f"![A failed run of each cause]({link})", "", EXPLAINED]
    command = f"    {shlex.join(['python', *sys.orig_argv[1:]])}"
    before = report.read_text() if report.exists() else ""
    return inserted(before, "\n".join([*lines, *shown, "", command]), MARKS)


def _line(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cells) + " |"


if __name__ == "__main__":
    cli.run(main, FailureOptions)
