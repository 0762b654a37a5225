"""Scripts of the project as processes that fill a folder, a stamp beside it once it is complete.

<folder>        what the script writes
<folder>.log    what it printed
<folder>.json   the stamp, there when the script has succeeded: its command, commit, date and seconds
"""

import json
import os
import re
import resource
import shlex
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

from dpmacro.utils.files import replacing

__all__ = ["Job", "forget", "progress", "read_stamp", "run"]

ROOT = Path(__file__).parents[1]
POLL = 0.5  # seconds between looks at a script's bar
PATIENCE = 10  # seconds that an interrupted script has to clean up
TAIL = 4096  # bytes of a log that show its bar


@dataclass(frozen=True)
class Job:
    """A script and the folder it fills.

    Attributes:
        doing: in a word, for the bar and for errors, such as "training random_0_baseline_20".
        script: relative to the project.
        folder: what it writes; an earlier one is removed.
        options: that decide what it writes.
        others: options that do not, as folders and workers.
        episodes: total of the script's own bar, if that counts episodes.
    """

    doing: str
    script: str
    folder: Path
    options: tuple[str, ...]
    others: tuple[str, ...] = ()
    episodes: int | None = None


def run(job: Job, commit: str, threads: int, moved: Callable[[int], None]) -> dict[str, Any]:
    """Run it from start to end, with so many threads; returns the stamp.

    `moved` is told how many episodes are done.

    Raises ChildProcessError with one line where it fails. An interrupt ends the script, too, without a stamp.
    """
    forget(job.folder)
    log = _beside(job.folder, ".log")
    log.parent.mkdir(parents=True, exist_ok=True)
    command = [job.script, *job.options, *job.others]
    started, worked = time.perf_counter(), _worked()
    with log.open("wb") as output:
        child = subprocess.Popen(
            [sys.executable, str(ROOT / job.script), *command[1:]],
            stdout=output,
            stderr=subprocess.STDOUT,
            env={**os.environ, "OMP_NUM_THREADS": str(threads)},
            start_new_session=True,  # so that `_end` alone interrupts it, once
        )
        try:
            while _running(child):
                if job.episodes is not None:
                    moved(progress(_tail(log), job.episodes))
        finally:
            _end(child)
    if child.returncode:
        last = _tail(log).split("\n")[-1] or "it printed nothing"
        raise ChildProcessError(
            f"{job.doing} failed with exit status {child.returncode}: {last} (all of it in {log})"
        )
    stamp = {
        "options": list(job.options),
        "command": shlex.join(["python", *command]),
        "commit": commit,
        "date": datetime.now().isoformat(timespec="seconds"),
        "seconds": round(time.perf_counter() - started, 1),
        "cpu_seconds": round(_worked() - worked, 1),
    }
    with replacing(_beside(job.folder, ".json")) as path:
        path.write_text(json.dumps(stamp, indent=2) + "\n")
    return stamp


def read_stamp(folder: Path) -> dict[str, Any] | None:
    """What is known of the run that filled the folder; None where none did to the end."""
    path = _beside(folder, ".json")
    if not (path.exists() and folder.exists()):
        return None
    try:
        stamp = json.loads(path.read_text())
        return stamp if {"options", "command", "commit", "seconds"} <= stamp.keys() else None
    except (ValueError, AttributeError):
        return None


def forget(folder: Path) -> None:
    """Remove a folder and its stamp, if there; the stamp first, so that half a folder has none."""
    _beside(folder, ".json").unlink(missing_ok=True)
    if folder.exists():
        shutil.rmtree(folder)


def progress(printed: str, total: int) -> int:
    """How far the last bar of `total` in what a script printed is; 0 where there is none."""
    found = re.findall(rf"\b(\d+)/{total} \[", printed)
    return int(found[-1]) if found else 0


def _beside(folder: Path, suffix: str) -> Path:
    return folder.with_name(folder.name + suffix)


def _worked() -> float:
    """CPU seconds of all scripts that have ended, and of their processes."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def _running(child: subprocess.Popen) -> bool:
    try:
        child.wait(POLL)
    except subprocess.TimeoutExpired:
        return True
    return False


def _end(child: subprocess.Popen) -> None:
    """Interrupt a script that still runs, and its processes; kill them if they do not clean up in time."""
    for number in (signal.SIGINT, signal.SIGKILL):
        if child.poll() is None:
            os.killpg(child.pid, number)
        try:
            child.wait(PATIENCE)
            return
        except subprocess.TimeoutExpired:
            continue


def _tail(log: Path) -> str:
    """The end of a log, a line for every state of a bar."""
    with log.open("rb") as file:
        file.seek(max(0, log.stat().st_size - TAIL))
        return file.read().decode(errors="replace").replace("\r", "\n").rstrip()
