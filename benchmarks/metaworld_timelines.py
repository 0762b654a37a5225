"""What was found in a demonstration of every task of `table_metaworld.py`, beside its expert's own stages.

    python benchmarks/metaworld_timelines.py --table=outputs/table_metaworld

Of every task the first demonstration of a training seed is drawn: the expert's stages in grey, numbered as
they come, and below them the macro-actions by the data. Beside each stands how well all demonstrations agree
(frames, and F1 of segments that overlap by half). The same numbers are printed as a table for Markdown.
"""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from safetensors.numpy import load_file
from seen_timeline import SEGMENTATION
from table_metaworld import TASKS

from dpmacro import figures
from dpmacro.data.demonstrations import Demonstrations
from dpmacro.figures.strips import draw_strip, write_names
from dpmacro.figures.style import GREYS, INK, PALETTE, WIDTH, bare
from dpmacro.metrics.frames import named_after_truth
from dpmacro.metrics.scores import SegmentationScores, segmentation_scores
from dpmacro.utils import cli

ROW = 0.62  # inches
SHORT = 5  # frames that count as the same change, shorter than most stages


@dataclass(frozen=True)
class TimelinesOptions:
    """Which table, and where the picture goes."""

    table: Path = Path("outputs/table_metaworld")
    """Folder that table_metaworld.py filled."""
    tasks: list[str] = field(default_factory=lambda: list(TASKS))
    """Tasks to draw, in this order."""
    seed: int = 0
    """Training seed."""
    output: Path = Path("docs/metaworld_timelines.png")
    """The picture, a PNG."""


@dataclass(frozen=True)
class Found:
    """A task's macro-actions and true stages: of its first demonstration, and how well all agree."""

    task: str
    labels: np.ndarray
    truth: np.ndarray
    macros: int
    stages: int
    scores: SegmentationScores


def main(options: TimelinesOptions) -> None:
    """Draw the picture and print the agreement."""
    found = [found_in(task, options) for task in options.tasks]
    figures.save(drawn(found), options.output)
    print("| task | macro-actions | stages | frames | F1@50 | boundary F1 |\n|---|---|---|---|---|---|")
    for one in found:
        scores = one.scores
        print(
            f"| {short(one.task)} | {one.macros} | {one.stages} | {scores.accuracy:.2f} | "
            f"{scores.f1_50:.2f} | {scores.boundary_f1:.2f} |"
        )
    print(f"\npicture  {options.output}")


def found_in(task: str, options: TimelinesOptions) -> Found:
    """What the training of a task found. Raises ValueError where the table lacks it."""
    training = options.table / "train" / f"{task}_dpmacro_{options.seed}" / SEGMENTATION
    data = options.table / "data" / f"{task}_{options.seed}"
    for needed in (training, data):
        if not needed.exists():
            raise ValueError(f"{needed} is not there: make it by benchmarks/table_metaworld.py")
    demonstrations, tensors = Demonstrations.load(data), load_file(training)
    labels, truth, lengths = tensors["labels"], demonstrations.truth, demonstrations.lengths
    assert truth is not None, "record.py wrote it"
    scores = segmentation_scores(labels, truth, lengths, SHORT)
    first = slice(0, int(lengths[0]))
    used = len(np.unique(labels)), len(np.unique(truth))
    return Found(task, named_after_truth(labels, truth)[0][first], truth[first], *used, scores)


def drawn(found: list[Found]) -> Figure:
    """A row for every task: its stages, what was found, and how well they agree."""
    figure = Figure(figsize=(WIDTH, ROW * len(found) + 0.5), layout="constrained")
    axes = figure.subplots(len(found), 1, squeeze=False)[:, 0]
    for axis, one in zip(axes, found, strict=True):
        bare(axis)
        draw_strip(axis, one.truth, GREYS, 1.1, 0.7)
        draw_strip(axis, one.labels, PALETTE, 0.0, 1.0)
        write_names(axis, one.labels, PALETTE, {})
        axis.set_xlim(0, len(one.truth))
        axis.set_ylim(0, 1.8)
        axis.set_ylabel(short(one.task), rotation=0, ha="right", va="center", color=INK, labelpad=8)
        note = f"{len(one.truth)} frames\n{one.scores.accuracy:.0%} agree\nF1@50 {one.scores.f1_50:.2f}"
        axis.text(
            1.01, 0.5, note, transform=axis.transAxes, va="center", ha="left", fontsize="small", color=INK
        )
    figure.suptitle(
        "A demonstration of every task: the expert's stages, and below them the macro-actions found"
    )
    return figure


def short(task: str) -> str:
    """A task's name without its version."""
    return task.removesuffix("-v3").removesuffix("-v0")


if __name__ == "__main__":
    cli.run(main, TimelinesOptions)
