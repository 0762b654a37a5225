"""A run that succeeds and one that fails, of every task of `table_metaworld.py`, as pictures in a row.

    python benchmarks/metaworld_stills.py --table=outputs/table_metaworld --output=docs/metaworld.png

The runs are those of dpmacro's first training seed, run again with pictures: they must end as they did. A
picture's frame has the colour of the macro-action that was running.
"""

import json
from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from metaworld_run import RESULT, world_of
from PIL import Image
from tqdm import tqdm

from dpmacro import figures
from dpmacro.evaluation.rollouts import PlannerSource, replay
from dpmacro.utils import cli
from dpmacro.utils.files import replacing
from dpmacro.worlds.base import SUCCESS

COLUMNS = 8
WIDTH, COLOURS = 1200, 64  # of the picture, which would be large otherwise


@dataclass(frozen=True)
class StillsOptions:
    """Which table, and where the picture goes."""

    table: Path = Path("outputs/table_metaworld")
    """Folder that table_metaworld.py filled."""
    tasks: list[str] = field(default_factory=list)
    """Tasks to draw; by default all that the table has."""
    worlds: str = "test"
    """Runs in test or in validation worlds."""
    seed: int = 0
    """Training seed."""
    output: Path = Path("docs/metaworld.png")
    """The picture, a PNG."""

    def __post_init__(self) -> None:
        if self.output.suffix != ".png":
            raise ValueError(f"output is {self.output}: give a name that ends in .png")


def main(options: StillsOptions) -> None:
    """Draw the picture."""
    tasks = options.tasks or sorted(
        folder.name.removesuffix(f"_dpmacro_{options.seed}")
        for folder in (options.table / f"runs_{options.worlds}").glob(f"*_dpmacro_{options.seed}")
        if folder.is_dir()
    )
    if not tasks:
        raise ValueError(f"{options.table} has no runs of dpmacro: fill it by benchmarks/table_metaworld.py")
    strips = [strip for task in tqdm(tasks, unit="task") for strip in strips_of(task, options)]
    drawn = Image.fromarray(figures.to_image(figures.film_strips(strips)))
    drawn.thumbnail((WIDTH, drawn.height))
    with replacing(options.output) as path:
        drawn.quantize(COLOURS).save(path, optimize=True)
    print(f"picture  {options.output}")


def strips_of(task: str, options: StillsOptions) -> Iterator[figures.Strip]:
    """A row of the first run that succeeds, and one of the first that does not."""
    name = f"{task}_dpmacro_{options.seed}"
    result = json.loads((options.table / f"runs_{options.worlds}" / name / RESULT).read_text())
    policy = options.table / "train" / name / "checkpoints/last/pretrained_model"
    runs = list(zip(result["seeds"], result["outcomes"], result["macros"], strict=True))
    for succeeds in (True, False):
        own = [run for run in runs if (run[1] == SUCCESS) == succeeds]
        if own:
            yield strip(task, policy, *own[0])


def strip(task: str, policy: Path, seed: int, outcome: str, macros: Sequence[int]) -> figures.Strip:
    """A run from its first to its last step, `COLUMNS` pictures of it. Raises ValueError for another end."""
    every = max((len(macros) - 1) // (COLUMNS - 1), 1)
    stills: list[Any] = []
    with closing(replay(PlannerSource("policy", policy), {"id": world_of(task)}, seed, every)) as moments:
        for step, moment in enumerate(moments):
            if moment.view is not None and len(stills) < COLUMNS:
                what = f"macro-action {moment.macro}"
                stills.append(figures.Still(moment.view, what, f"step {step}", "", moment.macro))
            ended = moment.outcome
    if ended != outcome:
        raise ValueError(f"the run of seed {seed} in {task} ended with {ended}, and had with {outcome}")
    note = f"{outcome.replace('_', ' ')}\nseed {seed}, {len(macros)} steps"
    return figures.Strip(task.removesuffix("-v3").removesuffix("-v0"), note, stills)


if __name__ == "__main__":
    cli.run(main, StillsOptions)
