"""Bounds on what a case may take, and what is remembered of the cases that failed."""

import os
import resource
import signal
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from hypothesis import HealthCheck, Phase, settings

CASES = int(os.environ.get("FUZZ_CASES", "0"))  # of every test; 0 for the few of the suite
MEMORY = 2**30  # bytes that a case may take beyond what the process has
SECONDS = 20
LONGEST = 1000  # characters of a line
PAGE = os.sysconf("SC_PAGE_SIZE")


def cases(few: int) -> Callable[[Any], Any]:
    """The settings of a test: the same `few` cases every time, or CASES random ones; nothing is kept."""
    return settings(
        max_examples=CASES or few,
        derandomize=not CASES,
        database=None,
        deadline=None,
        phases=[Phase.explicit, Phase.generate],
        suppress_health_check=list(HealthCheck),
    )


class TooLong(BaseException):
    """A case that took more than SECONDS."""


@contextmanager
def limited() -> Iterator[None]:
    """Memory and time are bounded within; MemoryError, or what a library makes of it, and TooLong."""

    def stop(number: int, frame: Any) -> None:
        raise TooLong(f"more than {SECONDS} s")

    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    taken = (
        int(Path("/proc/self/statm").read_text().split()[0]) * PAGE
        if Path("/proc/self/statm").exists()
        else 0
    )
    before = signal.signal(signal.SIGALRM, stop)
    if taken:
        resource.setrlimit(resource.RLIMIT_AS, (taken + MEMORY, hard))
    signal.setitimer(signal.ITIMER_REAL, SECONDS)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))


class Findings:
    """What the cases of a test came to: how many were refused, how many were sound, and those that failed."""

    def __init__(self) -> None:
        self.refused = self.sound = 0
        self.failed: dict[str, tuple[int, str]] = {}

    def run(self, what: Any, case: Callable[[], None], named: str) -> None:
        """Run a case within the limits: it passes, or raises ValueError with one line that has `named`."""
        try:
            with limited():
                case()
        except (KeyboardInterrupt, SystemExit):
            raise
        except BaseException as error:
            wrong = self._wrong(error, named)
            if wrong is None:
                self.refused += 1
            else:
                count, example = self.failed.get(wrong, (0, f"{what}: {str(error)[:300]!r}"))
                self.failed[wrong] = count + 1, example
        else:
            self.sound += 1

    def _wrong(self, error: BaseException, named: str) -> str | None:
        line = str(error)
        own = [frame for frame in traceback.extract_tb(error.__traceback__) if "dpmacro/" in frame.filename]
        place = f"{Path(own[-1].filename).name}:{own[-1].lineno}" if own else "outside"
        if not isinstance(error, ValueError) or isinstance(error, UnicodeError):
            return f"{type(error).__name__} at {place}"
        for bad, why in (
            ("\n" in line, "several lines"),
            (len(line) > LONGEST, "a long line"),
            (named not in line, f"{named} is not named"),
            ("alloc" in line or "memory" in line, "memory"),
        ):
            if bad:
                return f"{why} at {place}"
        return None

    def check(self, title: str) -> None:
        """Print the counts; AssertionError with an example of every kind of failure."""
        total = self.refused + self.sound + sum(count for count, _ in self.failed.values())
        print(f"\n{title}: {total} cases, {self.refused} refused, {self.sound} sound")
        told = [f"{count} x {kind}, for instance {example}" for kind, (count, example) in self.failed.items()]
        assert not told, "\n".join([f"{len(told)} kinds of failure in {total} cases:", *told])
