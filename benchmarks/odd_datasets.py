"""A table of odd datasets: what dpmacro makes of each, and what LeRobot makes of the same files.

python benchmarks/odd_datasets.py --report=docs/odd_datasets.md

The datasets are those of the tests, made by `odd_cases` and `odd_refused`. A dataset that LeRobot reads
whole has to be read here as well, with the same images. Rows are kept in a file by LeRobot's version, so that
the report shows all versions that the command ran with.
"""

import json
import os
import shlex
import sys
import tempfile
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import torch
from lerobot_files import CAMERA, levels
from odd_cases import FILMS, TABLES
from odd_changes import Odd
from odd_refused import FILMS_REFUSED, TABLES_REFUSED

from dpmacro.data.demonstrations import DatasetError, Demonstrations
from dpmacro.utils import cli
from dpmacro.utils.files import replacing

CASES: dict[str, dict[str, Odd]] = {
    "Images": TABLES | TABLES_REFUSED,
    "Video": FILMS | FILMS_REFUSED,
}
RIGHT = "the right frames"
WRONG = "wrong frames"
LONGEST = 150  # letters of an error in the table


@dataclass(frozen=True)
class OddOptions:
    """What to run, and where the table goes."""

    report: Path | None = None
    """Markdown file that the table is written to; by default it is printed."""
    rows: Path = Path("outputs/odd_datasets.json")
    """JSON file of the rows of every version of LeRobot that the table was made with."""
    only: str = ""
    """Words that the names of the cases contain; by default all cases."""


@dataclass(frozen=True)
class Outcome:
    """What dpmacro and LeRobot make of a dataset, in words."""

    group: str
    name: str
    ours: str
    theirs: str
    excuse: str = ""

    @property
    def wrong(self) -> bool:
        """Whether dpmacro reads wrong frames, or refuses what LeRobot reads, without an excuse."""
        return self.ours == WRONG or (self.theirs == RIGHT and self.ours != RIGHT and not self.excuse)


def main(options: OddOptions) -> None:
    """Print or write the table; ValueError where a dataset that LeRobot reads is not read here."""
    outcomes = [
        outcome(group, name, odd)
        for group, cases in CASES.items()
        for name, odd in cases.items()
        if options.only in name
    ]
    if not outcomes:
        raise ValueError(f"only is {options.only!r}: no case has these words in its name")
    known = json.loads(options.rows.read_text()) if options.rows.is_file() else {}
    known[version("lerobot")] = [vars(one) for one in outcomes]
    with replacing(options.rows) as temporary:
        temporary.write_text(json.dumps(known, indent=1) + "\n")
    text = report(known, shlex.join(["python", *sys.orig_argv[1:]]))
    if options.report is None:
        print(text)
    else:
        with replacing(options.report) as temporary:
            temporary.write_text(text)
    wrong = [f"{one.group}, {one.name}" for one in outcomes if one.wrong]
    if wrong:
        raise ValueError(f"LeRobot reads what dpmacro does not: {'; '.join(wrong)}")


def outcome(group: str, name: str, odd: Odd) -> Outcome:
    """What is made of a case, in a folder that is gone afterwards."""
    with tempfile.TemporaryDirectory(prefix="dpmacro-odd-") as folder:
        root = Path(folder) / "d"
        odd.build(root)
        ours, images = _ours(root)
        if images is not None:
            ours = RIGHT if images == list(odd.shown) else WRONG
        theirs, images = _theirs(root, Path(folder))
        if images is not None:
            right = images == list(odd.shown) or not odd.shown
            theirs = RIGHT if right else f"frames {', '.join(map(str, images))}"
    return Outcome(group, name, ours, theirs, odd.excuse)


def report(known: dict[str, list[dict[str, Any]]], command: str) -> str:
    """The table in Markdown, a column for every version of LeRobot."""
    versions = sorted(known)
    lines = [
        "# Odd datasets",
        "",
        "Datasets as users have them, each with one oddity, made by `benchmarks/odd_cases.py` and",
        "`benchmarks/odd_refused.py`; the tests read the same ones. A dataset has two episodes, of 5 and 6",
        "frames, a camera, a state and vectors as actions. What cannot be read is refused in one line. Where",
        "LeRobot reads all frames of a dataset, so does dpmacro, or the table says why not.",
        "",
        f"Written by `{command}`, dpmacro {version('dpmacro')}, LeRobot {' and '.join(versions)}.",
    ]
    for group in CASES:
        heads = ["what is odd", "dpmacro", *(f"LeRobot {one}" for one in versions)]
        lines += ["", f"## {group}", "", _line(heads), _line(["---"] * len(heads))]
        names = dict.fromkeys(row["name"] for rows in known.values() for row in rows if row["group"] == group)
        for name in names:
            of = {
                key: next((row for row in rows if (row["group"], row["name"]) == (group, name)), None)
                for key, rows in known.items()
            }
            ours = dict.fromkeys(_with_excuse(row) for row in of.values() if row)
            lines.append(
                _line(
                    [name, "; or ".join(ours), *((of[one] or {"theirs": "-"})["theirs"] for one in versions)]
                )
            )
    return "\n".join(lines) + "\n"


def _with_excuse(row: dict[str, Any]) -> str:
    excuse = row.get("excuse")
    return f"{row['ours']} (refused, as {excuse})" if excuse else row["ours"]


def _ours(root: Path) -> tuple[str, list[int] | None]:
    """The line that refuses the dataset, and none of it; or the numbers of the frames shown."""
    try:
        loaded = Demonstrations.load(root)
    except DatasetError as error:
        return _short(str(error), root), None
    return "", levels(loaded.images).tolist()


def _theirs(root: Path, folder: Path) -> tuple[str, list[int] | None]:
    """Likewise by LeRobot, which keeps a copy of the data in `folder`."""
    from datasets import config, disable_progress_bars
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    disable_progress_bars()
    config.HF_DATASETS_CACHE = folder / "cache"
    try:
        dataset = LeRobotDataset("local/d", root=root, video_backend="pyav")
    except Exception as error:  # whatever LeRobot raises is what the table tells
        return f"does not open: {_short(_named(error), root)}", None
    try:
        frames = [dataset[k] for k in range(len(dataset))]
        lacking = _lacking(frames)
        if lacking:
            return f"opens; {lacking}", None
        images = [frame[CAMERA].numpy() for frame in frames]
    except Exception as error:  # likewise
        return f"opens; a frame raises {_short(_named(error), root)}", None
    return "", [int(levels(np.rint(255 * image)[None])[0]) for image in images]


def _lacking(frames: list[dict[str, Any]]) -> str:
    """What a policy that is trained on LeRobot's frames would miss; "" for nothing."""
    for name in (CAMERA, "action", "observation.state"):
        found = [frame.get(name) for frame in frames]
        for k, value in enumerate(found):
            if not isinstance(value, torch.Tensor):
                return f"frame {k} has no {name}"
            if not torch.isfinite(value.float()).all():
                return f"{name} is {value.float().flatten().tolist()} at frame {k}"
        shapes = {tuple(value.shape) for value in found if value is not None}
        if len(shapes) > 1:
            return f"frames of {name} have shapes {' and '.join(map(str, sorted(shapes)))}"
    return ""


def _named(error: Exception) -> str:
    return f"{type(error).__name__}: {error}"


def _short(text: str, root: Path) -> str:
    """One line, without the folder, that a cell of a table can hold."""
    line = " ".join(text.replace(f"{root}/", "").replace(str(root), "d").split())
    return line if len(line) <= LONGEST else f"{line[: LONGEST - 4]} ..."


def _line(cells: list[str]) -> str:
    return f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in cells)} |"


if __name__ == "__main__":
    os.environ["HF_HUB_OFFLINE"] = "1"  # LeRobot looks for missing files on the network
    cli.run(main, OddOptions)
