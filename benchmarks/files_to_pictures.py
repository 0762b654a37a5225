"""How long it takes from a dataset's files to labels and pictures, and how much memory.

    python benchmarks/files_to_pictures.py --dataset.root=<LeRobot dataset> --seconds=180 --gib=4
    python benchmarks/files_to_pictures.py --frames=30000 --cameras=2 --seconds=360

Runs train.py and datasets/annotate.py as a user does, each in a process of its own, one after another, and
says how their time splits: reading, features, search, final fit and writing, by their progress bars. Without
a dataset one is generated, once, in the folder `generated`.
"""

import json
import shlex
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from generated import Contents, generate
from report import header
from watched import STAGES, Run, watched

from dpmacro.utils import cli
from dpmacro.utils.files import replacing

ROOT = Path(__file__).resolve().parents[1]
SCRIPTS = {"train": "train.py", "annotate": "datasets/annotate.py"}
COLUMNS = tuple(dict.fromkeys(["reading", *STAGES.values()]))


@dataclass(frozen=True)
class FilesOptions:
    """The dataset that is read."""

    root: Path | None = None
    """Folder of a LeRobot dataset; by default one is generated."""


@dataclass(frozen=True)
class FilesToPicturesOptions:
    """What to run, and on what."""

    dataset: FilesOptions = field(default_factory=FilesOptions)
    generated: Path | None = None
    """Folder of the generated dataset; by default one in outputs, named by what it holds."""
    frames: int = 30_000
    """Frames of the generated dataset."""
    cameras: int = 2
    """Cameras of the generated dataset."""
    size: tuple[int, int] = (640, 480)
    """Width and height of its pictures."""
    codec: str = "libsvtav1"
    """Its encoder, libsvtav1 or h264."""
    length: int = 300
    """Frames of its episodes."""
    scripts: list[str] = field(default_factory=lambda: list(SCRIPTS))
    """Scripts to run, out of train and annotate."""
    options: str = ""
    """Options that both scripts get besides the dataset, in one text, like '--planner.macros=3'."""
    seconds: float | None = None
    """Most seconds that a script may take; by default any number."""
    gib: float | None = None
    """Most GiB of memory that a script may take; by default any number."""
    output: Path = Path("outputs/files_to_pictures.json")
    """Where the rows go."""

    def __post_init__(self) -> None:
        for script in self.scripts:
            if script not in SCRIPTS:
                raise ValueError(f"scripts has {script!r}: choose from {', '.join(SCRIPTS)}")
        for name in ("seconds", "gib"):
            if (most := getattr(self, name)) is not None and not most > 0:
                raise ValueError(f"{name} is {most}: give a number above 0")


def main(options: FilesToPicturesOptions) -> None:
    """Run the scripts and print a table; ValueError where one fails or takes more than it may."""
    root = options.dataset.root or generated_dataset(options)
    print("\n".join(header(shlex.join(["python", *sys.orig_argv[1:]]))), flush=True)
    rows: list[dict[str, Any]] = []
    beyond: list[str] = []
    try:
        for script in options.scripts:
            run = run_script(script, root, shlex.split(options.options))
            if run.status:
                raise ValueError(f"{SCRIPTS[script]} ended with status {run.status}: {_last_line(run)}")
            rows.append(
                {"script": script, "seconds": run.seconds, "cpu": run.cpu, "gib": run.gib, **run.stages}
            )
            with replacing(options.output) as temporary:
                temporary.write_text(json.dumps(rows, indent=1) + "\n")
            for name in ("seconds", "gib"):
                most = getattr(options, name)
                if most is not None and rows[-1][name] > most:
                    beyond.append(
                        f"{SCRIPTS[script]} took {rows[-1][name]:.1f} {name}, {most:g} are the goal"
                    )
    finally:
        print("\n".join(table(rows)))
    if beyond:
        raise ValueError("; ".join(beyond))


def generated_dataset(options: FilesToPicturesOptions) -> Path:
    """The generated dataset, made where it is not there yet."""
    width, height = options.size
    contents = Contents(options.frames, options.cameras, width, height, options.codec, options.length)
    return generate(options.generated or contents.folder, contents)


def run_script(script: str, root: Path, more: Sequence[str]) -> Run:
    """One script on a dataset, into a folder that is gone afterwards."""
    with tempfile.TemporaryDirectory(prefix="dpmacro-files-") as name:
        folder = Path(name)
        written = [f"--output_dir={folder / 'run'}"]
        if script == "annotate":
            written.append(f"--output={folder / 'dataset'}")
        command = [sys.executable, str(ROOT / SCRIPTS[script]), f"--dataset.root={root.resolve()}"]
        return watched([*command, *written, *more], folder)


def table(rows: Sequence[dict[str, Any]]) -> list[str]:
    """A line for every script: seconds, CPU seconds, GiB, and the seconds of every stage."""
    heads = ("seconds", "cpu", "gib", *COLUMNS)
    lines = [f"{'script':<10}" + "".join(f"{head:>11}" for head in heads)]
    lines += [
        f"{row['script']:<10}"
        + "".join(f"{row.get(head, 0.0):>11.{2 if head == 'gib' else 1}f}" for head in heads)
        for row in rows
    ]
    return lines


def _last_line(run: Run) -> str:
    lines = run.errors.strip().splitlines() or ["it says nothing"]
    return lines[-1]


if __name__ == "__main__":
    cli.run(main, FilesToPicturesOptions)
