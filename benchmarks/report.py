"""Rows of the benchmark table, the header above them, the JSON file, and texts with results between marks."""

import importlib.metadata
import json
import os
import platform
import re
import subprocess
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from dpmacro.utils.files import replacing

__all__ = ["Row", "header", "inserted", "markdown", "table", "write"]

PACKAGES = (
    "torch",
    "numpy",
    "lightgbm",
    "xgboost",
    "catboost",
    "scikit-learn",
    "numba",
    "hmmlearn",
    "pybullet",
)
ROOT = Path(__file__).parents[1]


@dataclass(frozen=True)
class Row:
    """Ours beside a peer's, measured on the same data with the same threads."""

    benchmark: str
    case: str
    ours: float | None  # None where it was not reached
    peer_name: str
    peer: float | None
    unit: str = "s"
    accuracy: float | None = None  # share of held-out frames whose class is right
    peer_accuracy: float | None = None
    training_accuracy: float | None = None  # likewise, of training frames
    peer_training_accuracy: float | None = None

    @property
    def ratio(self) -> float | None:
        """Ours divided by the peer's."""
        return self.ours / self.peer if self.ours is not None and self.peer else None

    def as_json(self) -> dict[str, str | float | None]:
        """The fields and the ratio."""
        return asdict(self) | {"ratio": self.ratio}

    def cells(self) -> list[str]:
        """The row as text."""
        return [
            self.benchmark,
            self.case,
            _number(self.ours),
            self.peer_name,
            _number(self.peer),
            _number(self.ratio),
            self.unit,
            _accuracy(self.training_accuracy, self.accuracy),
            _accuracy(self.peer_training_accuracy, self.peer_accuracy),
        ]


HEADINGS = ["benchmark", "case", "ours", "peer", "peer's", "ratio", "unit", "accuracy", "peer's accuracy"]
NUMERIC = {2, 4, 5}


def table(rows: list[Row]) -> list[str]:
    """A line of headings and a line for every row."""
    lines = [HEADINGS, *(row.cells() for row in rows)]
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    aligned = [
        [f"{cell:>{width}}" if k in NUMERIC else f"{cell:<{width}}" for k, (cell, width) in enumerate(cells)]
        for cells in (list(zip(line, widths, strict=True)) for line in lines)
    ]
    return ["  ".join(cells).rstrip() for cells in aligned]


def write(rows: list[Row], path: Path) -> None:
    """The rows as a JSON list."""
    with replacing(path) as temporary:
        temporary.write_text(json.dumps([row.as_json() for row in rows], indent=2) + "\n")


def header(command: str) -> list[str]:
    """Commit, machine and versions, and the command."""
    return [
        f"commit   {_commit()}",
        f"machine  {_machine()}",
        f"versions {_versions()}",
        f"command  {command}",
    ]


def inserted(text: str, found: str, marks: tuple[str, str]) -> str:
    """The text with what is between its marks replaced; with marks and results at its end where it has none.

    Raises ValueError where it has one mark without the other, or in the wrong order.
    """
    before, start, rest = text.partition(marks[0])
    _, end, after = rest.partition(marks[1])
    if bool(start) != (marks[1] in text) or bool(start) != bool(end):
        raise ValueError(f"the report needs {' and later '.join(marks)}, or neither: correct the marks")
    if not start:
        before, after = text and text.rstrip("\n") + "\n\n", "\n"
    return f"{before}{marks[0]}\n{found}\n{marks[1]}{after}"


def markdown(headings: Sequence[str], lines: Sequence[Sequence[str]]) -> list[str]:
    """A markdown table whose columns align; nothing where there is no line."""
    if not lines:
        return []
    cells = [list(headings), *map(list, lines)]
    widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
    rule = ["-" * width for width in widths]
    return [
        "| " + " | ".join(f"{cell:<{width}}" for cell, width in zip(line, widths, strict=True)) + " |"
        for line in [cells[0], rule, *cells[1:]]
    ]


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.3g}" if value < 1000 else f"{value:.0f}"


def _accuracy(training: float | None, held_out: float | None) -> str:
    parts = ["-" if share is None else f"{share:.3f}" for share in (training, held_out)]
    return "" if parts == ["-", "-"] else " / ".join(parts)


def _commit() -> str:
    try:
        commit = _git("rev-parse", "--short", "HEAD")
        return commit + (" dirty" if _git("status", "--porcelain") else "")
    except (OSError, subprocess.CalledProcessError):
        return "unknown"


def _git(*arguments: str) -> str:
    return subprocess.run(
        ["git", *arguments], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout.strip()


def _machine() -> str:
    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30
    model = platform.processor() or platform.machine()
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.exists() and (found := re.search(r"model name\s*: (.*)", cpuinfo.read_text())):
        model = found[1]
    return f"{model}, {os.cpu_count()} cores, {memory:.0f} GiB, {platform.platform(terse=True)}"


def _versions() -> str:
    versions = [f"Python {platform.python_version()}"]
    for package in PACKAGES:
        try:
            versions.append(f"{package} {importlib.metadata.version(package)}")
        except importlib.metadata.PackageNotFoundError:
            versions.append(f"{package} not installed")
    return ", ".join(versions)
