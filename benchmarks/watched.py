"""A script run from beginning to end: its time, the stages that its progress bars tell of, its memory."""

import os
import re
import subprocess
import sys
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO

__all__ = ["STAGES", "Run", "Stopwatch", "watched"]

STAGES = {  # the first words of a progress bar: what is done meanwhile
    "Features": "features",
    "Segmenting": "search",
    "Scoring segmentations": "search",
    "Recognising changes": "search",
    "Boosting": "final fit",
    "Switch functions": "final fit",
    "Pictures": "writing",
}
FIRST, LAST = "reading", "writing"  # before the first bar, imports included, and after the last
BAR = re.compile(r"^(?P<name>[A-Z][^:|]*?)( Q\d+ S\d+)?: +(?P<share>\d+)%")
PAUSE = 0.1  # seconds between two looks at the memory
KIB_PER_GIB = 2**20


@dataclass(frozen=True)
class Run:
    """What a script took.

    Attributes:
        status: its exit status.
        seconds: from its start to its end.
        cpu: seconds of all cores, its children's included.
        gib: the most resident memory that it and its children held together.
        stages: seconds of every stage.
        output: what it printed.
        errors: what it printed to stderr, without progress bars.
    """

    status: int
    seconds: float
    cpu: float
    gib: float
    stages: dict[str, float]
    output: str
    errors: str


@dataclass
class Stopwatch:
    """Seconds of every stage, by the progress bars as they come.

    Time goes to the stage of the bar that is drawn next, as what has no bar prepares for what has one.
    """

    before: float
    seconds: dict[str, float] = field(default_factory=lambda: {FIRST: 0.0})
    stage: str = FIRST

    def line(self, text: str, now: float) -> bool:
        """Take note of a line at the time `now`; whether it is a progress bar."""
        found = BAR.match(text)
        if found is None:
            return False
        known = [stage for words, stage in STAGES.items() if found["name"].startswith(words)]
        if known:
            running = FIRST if self.stage == FIRST else known[0]
            self._spend(running, now)
            self.stage = known[0]
        return True

    def stop(self, now: float) -> None:
        """The script ended."""
        self._spend(LAST if self.stage != FIRST else FIRST, now)

    def _spend(self, stage: str, now: float) -> None:
        self.seconds[stage] = self.seconds.get(stage, 0.0) + now - self.before
        self.before = now


def watched(command: Sequence[str], folder: Path) -> Run:
    """Run a command in a folder, on its own, to its end."""
    started = time.perf_counter()
    process = subprocess.Popen(command, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    stopwatch, peak = Stopwatch(started), [0.0]
    output: list[bytes] = []
    others: list[str] = []
    assert process.stdout is not None and process.stderr is not None, "they are pipes"
    threads = [
        threading.Thread(target=_read, args=(process.stderr, stopwatch, others)),
        threading.Thread(target=lambda pipe: output.append(pipe.read()), args=(process.stdout,)),
        threading.Thread(target=_watch_memory, args=(process, peak), daemon=True),
    ]
    try:
        for thread in threads:
            thread.start()
        _, status, used = os.wait4(process.pid, 0)
    except BaseException:
        process.kill()
        process.wait()
        raise
    ended = time.perf_counter()
    process.returncode = os.waitstatus_to_exitcode(status)
    for thread in threads:
        thread.join()
    stopwatch.stop(ended)
    # Of the largest process alone, counted from what this one held: where nothing else tells it.
    unit = KIB_PER_GIB * (1024 if sys.platform == "darwin" else 1)
    return Run(
        process.returncode,
        ended - started,
        used.ru_utime + used.ru_stime,
        peak[0] or used.ru_maxrss / unit,
        stopwatch.seconds,
        b"".join(output).decode(errors="replace"),
        "\n".join(others),
    )


def _read(pipe: IO[bytes], stopwatch: Stopwatch, others: list[str]) -> None:
    """Lines of stderr as they come; bars are drawn over one another, with no end of a line."""
    text = ""
    while chunk := os.read(pipe.fileno(), 2**16):
        now = time.perf_counter()
        *lines, text = re.split(r"[\r\n]", text + chunk.decode(errors="replace"))
        others += [line for line in lines if not stopwatch.line(line, now) and line.strip()]
        stopwatch.line(text, now)
    others += [] if BAR.match(text) or not text.strip() else [text]


def _watch_memory(process: subprocess.Popen, peak: list[float]) -> None:
    """Keep the most memory that a process held, and with all its children, where Linux tells it."""
    while process.returncode is None and Path(f"/proc/{process.pid}/status").exists():
        together = sum(_gib(pid, "VmRSS") for pid in _tree(process.pid))
        peak[0] = max(peak[0], together, _gib(process.pid, "VmHWM"))
        time.sleep(PAUSE)


def _tree(pid: int) -> list[int]:
    """A process and all below it."""
    children: list[int] = []
    try:
        for task in Path(f"/proc/{pid}/task").iterdir():
            children += map(int, (task / "children").read_text().split())
    except OSError:  # it has ended meanwhile
        return []
    return [pid, *(below for child in children for below in _tree(child))]


def _gib(pid: int, what: str) -> float:
    try:
        found = re.search(rf"{what}:\s*(\d+) kB", Path(f"/proc/{pid}/status").read_text())
    except OSError:  # likewise
        return 0.0
    return int(found[1]) / KIB_PER_GIB if found else 0.0
