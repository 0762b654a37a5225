"""Kill the scripts at random moments, run them again until they are done, and compare with undisturbed runs.

python benchmarks/kills.py --kills=20
python benchmarks/kills.py --kills=20 --only='[train]'

Every script runs once undisturbed. Then the same command runs again and again in another folder, and SIGKILL
ends it and all its workers at a random moment of the time that the undisturbed run took, until so many kills
are done; a folder in which it came to its end is compared, and another one begun. At last it runs to its end.
After every kill two things are looked at: what was complete before is there, and what has the name of
something complete is equal to the undisturbed one. The exit status is 1 where anything was lost, half or
different.
"""

import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

from report import markdown

from dpmacro.utils import cli

REPOSITORY = Path(__file__).resolve().parents[1]
HEAD = ("script", "kills", "calls", "completed", "lost", "half taken for whole", "different at the end")
PATIENCE = 600  # seconds that a run may take
TIMES = ("eval_s", "eval_ep_s")


@dataclass
class KillsOptions:
    """What is killed, and how often."""

    kills: int = 20
    """Kills of each script."""
    only: list[str] = field(default_factory=lambda: ["record", "eval", "annotate"])
    """Scripts, some of record, eval, annotate and train."""
    episodes: int = 40
    """Episodes that are recorded, and runs of an evaluation."""
    seed: int = 0
    """Seed of the moments."""
    folder: Path | None = None
    """Where all is written, and kept; by default a temporary folder that goes."""

    def __post_init__(self) -> None:
        for name in ("kills", "episodes"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} is {getattr(self, name)}: give 1 or more")
        for name in self.only:
            if name not in WORKS:
                raise ValueError(f"only has {name!r}: choose from {', '.join(WORKS)}")


class Running(Protocol):
    """A process and those that it started."""

    pid: int

    def wait(self, timeout: float) -> int | None:
        """The exit status; None where it still runs after so many seconds."""


Start = Callable[[Sequence[str], Path], Running]


@dataclass(frozen=True)
class Work:
    """A script's work in a folder.

    Attributes:
        options: the script and its options; paths are relative to the folder.
        whole: by name what is complete in a folder, as it can be compared.
        kept: how much is kept of what is not complete: it never gets less before the work is done.
        again: the options for going on in this folder; by default the same.
    """

    options: Sequence[str]
    whole: Callable[[Path], Mapping[str, Any]]
    kept: Callable[[Path], int]
    again: Callable[[Path, Sequence[str]], Sequence[str]] = lambda folder, options: options


@dataclass
class Row:
    """What came of the kills of a script; the last three are to be 0."""

    name: str
    kills: int = 0
    calls: int = 0
    completed: int = 0
    lost: int = 0
    half: int = 0
    different: int = 0
    odd: set[str] = field(default_factory=set)  # what was half or different, by name

    @property
    def cells(self) -> tuple[str, ...]:
        """As a row of the table."""
        numbers = self.kills, self.calls, self.completed, self.lost, self.half, self.different
        return self.name, *map(str, numbers)


def main(options: KillsOptions) -> None:
    """Print a table with a row for every script."""
    rows = []
    given = options.folder
    with tempfile.TemporaryDirectory() if given is None else nullcontext(str(given)) as place:
        folder = Path(place).absolute()
        for name in options.only:
            work = WORKS[name](folder, options.episodes)
            rows.append(killed(name, work, folder / name, options.kills, random.Random(options.seed)))
            print(f"{name}: {rows[-1]}", file=sys.stderr)
    print(*markdown(HEAD, [row.cells for row in rows]), sep="\n")
    if any(row.lost or row.half or row.different for row in rows):
        sys.exit(1)


class Command:
    """A script in a process group of its own; its output goes to a file beside the folder it works in."""

    def __init__(self, options: Sequence[str], folder: Path) -> None:
        script, *rest = options
        with folder.with_name(f"{folder.name}.log").open("a") as log:
            self._process = subprocess.Popen(
                [sys.executable, str(REPOSITORY / script), *rest],
                cwd=folder,
                env=os.environ | {"PYTHONPATH": str(REPOSITORY)},
                stdout=log,
                stderr=log,
                start_new_session=True,
            )
        self.pid = self._process.pid

    def wait(self, timeout: float) -> int | None:
        """As `Running` says."""
        try:
            return self._process.wait(timeout)
        except subprocess.TimeoutExpired:
            return None


def killed(
    name: str, work: Work, folder: Path, kills: int, rng: random.Random, start: Start = Command
) -> Row:
    """Do the work undisturbed, then with so many kills, in folders within `folder`, and compare.

    Raises ValueError where the script ends with an error, or does not come to an end.
    """
    alone = folder / "undisturbed"
    alone.mkdir(parents=True)
    began = time.perf_counter()
    _finish(start(work.options, alone), name, alone)
    seconds = time.perf_counter() - began
    wanted, row = work.whole(alone), Row(name)
    while row.kills < kills or row.completed == 0:
        here = folder / str(row.completed)
        here.mkdir()
        kept = 0
        left: Mapping[str, Any] = {}
        status: int | None = None
        while status is None and left.keys() != wanted.keys():
            running = start(work.again(here, work.options), here)
            row.calls += 1
            status = running.wait(rng.uniform(0, seconds) if row.kills < kills else PATIENCE)
            if status is None and row.kills == kills:
                raise ValueError(f"{name} did not come to its end in {PATIENCE} s: see {here}.log")
            if status is None:
                try:
                    os.killpg(running.pid, signal.SIGKILL)
                except ProcessLookupError:  # it has just come to its end by itself
                    status = running.wait(PATIENCE)
                else:
                    running.wait(PATIENCE)
                    row.kills += 1
            left, before = work.whole(here), kept
            if status not in (None, 0) and left.keys() != wanted.keys():
                raise ValueError(f"{name} ended with status {status}: see {here}.log")
            kept = work.kept(here)
            row.lost += kept < before and left.keys() != wanted.keys()
            half = [one for one in left.keys() & wanted if wanted[one] != left[one]] * (status is None)
            row.half += bool(half)
            row.odd.update(half)
        row.completed += 1
        row.different += left != wanted
        row.odd.update(one for one in left.keys() | wanted if left.get(one) != wanted.get(one))
        shutil.rmtree(here)
    return row


def _finish(running: Running, name: str, folder: Path) -> None:
    if running.wait(PATIENCE) != 0:
        raise ValueError(f"{name} did not come to its end in {PATIENCE} s: see {folder}.log")


def files_of(folder: Path) -> dict[str, bytes]:
    """All files below a folder."""
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


def _lines(path: Path) -> int:
    """Whole lines of a file; 0 where there is none."""
    return path.read_bytes().count(b"\n") if path.exists() else 0


def recording(folder: Path, episodes: int) -> Work:
    """A dataset of a teacher's runs."""
    options = ("--root=data", "--world.id=TwoButtons-v0", f"--episodes={episodes}", "--noise=0.3")
    return Work(
        ("datasets/record.py", *options),
        lambda here: {"data": files_of(here / "data")} if (here / "data").exists() else {},
        lambda here: _lines(here / ".data.recording/runs.jsonl"),
    )


def evaluation(folder: Path, episodes: int) -> Work:
    """An evaluation of the teacher by two processes, and two videos."""
    options = ("--policy.type=teacher", "--world.id=TwoButtons-v0", f"--episodes={episodes}")

    def whole(here: Path) -> dict[str, Any]:
        found: dict[str, Any] = {}
        if (here / "out/eval_info.json").exists():
            info = json.loads((here / "out/eval_info.json").read_text())
            info["overall"] |= dict.fromkeys(TIMES)
            found["runs"] = info["dpmacro"]
            if info["overall"]["video_paths"]:  # which come last
                found["all"] = info
        found |= {path.name: path.read_bytes() for path in here.glob("out/videos/*/eval_*.mp4")}
        return found

    return Work(
        ("eval.py", *options, "--output_dir=out", "--workers=2", "--videos=2"),
        whole,
        lambda here: _lines(here / "out/runs.jsonl"),
    )


def _demonstrations(folder: Path, episodes: int) -> Path:
    """A dataset that annotations and trainings begin with."""
    data = folder / "demonstrations"
    if not data.exists():
        folder.mkdir(parents=True, exist_ok=True)
        work = recording(folder, episodes)
        running = Command((*work.options, f"--root={data}"), folder)
        _finish(running, "record", folder)
    return data


SEARCH = ("--planner.macros=2", "--planner.rounds=20", "--planner.restarts=2", "--planner.switch_rounds=10")


def annotation(folder: Path, episodes: int) -> Work:
    """Stages that are searched, a page, and a new dataset with them."""
    data = _demonstrations(folder, min(episodes, 10))
    options = (f"--dataset.root={data}", "--output=stages", "--output_dir=page")

    def whole(here: Path) -> dict[str, Any]:
        found: dict[str, Any] = {}
        if (here / "stages").exists():
            found["stages"] = files_of(here / "stages")
        if (here / "page/segmentation.json").exists() and not (here / "page/.unfinished").exists():
            found["page"] = [(here / f"page/segmentation.{kind}").read_bytes() for kind in ("json", "html")]
            found["figures"] = files_of(here / "page/figures")
        if (here / "page/training/found.safetensors").exists():
            found["search"] = (here / "page/training/found.safetensors").read_bytes()
            found["policy"] = files_of(here / "page/training/checkpoints/last/pretrained_model")
        return found

    return Work(
        ("datasets/annotate.py", *options, *SEARCH),
        whole,
        lambda here: int((here / "page/training/found.safetensors").exists()),
    )


def training(folder: Path, episodes: int) -> Work:
    """A training that is resumed from its newest checkpoint, or begun anew where it has none."""
    data = _demonstrations(folder, min(episodes, 10))
    last = Path("run/checkpoints/last")

    def whole(here: Path) -> dict[str, Any]:
        # Checkpoints on the way have other names than the last, and are not compared.
        if not (here / last / "pretrained_model/model.safetensors").exists():
            return {}
        names = "pretrained_model/model.safetensors", "training_state/segmentation.safetensors"
        return {str((here / last).readlink()): [(here / last / name).read_bytes() for name in names]}

    def again(here: Path, options: Sequence[str]) -> Sequence[str]:
        config = last / "pretrained_model/train_config.json"
        if (here / config).exists():
            return "train.py", f"--config_path={config}", "--resume=true"
        shutil.rmtree(here / "run", ignore_errors=True)
        return options

    return Work(
        ("train.py", f"--dataset.root={data}", "--output_dir=run", *SEARCH),
        whole,
        lambda here: len(list(here.glob("run/checkpoints/[0-9]*"))),
        again,
    )


WORKS: dict[str, Callable[[Path, int], Work]] = {
    "record": recording,
    "eval": evaluation,
    "annotate": annotation,
    "train": training,
}


if __name__ == "__main__":
    cli.run(main, KillsOptions)
