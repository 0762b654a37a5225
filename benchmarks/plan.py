"""What a run measures, and with what: the benchmarks' common ground."""

import sys
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median
from typing import Any

from measure import FailedError, MissingError, measure
from report import Row

__all__ = ["Plan", "settled"]


@dataclass
class Plan:
    """Options of the run, its scratch folder, and measurements that say why where they cannot be had."""

    repeats: int
    threads: int
    quick: bool
    dataset: Path
    matrices: tuple[str, ...]
    peers: tuple[str, ...]
    learners: tuple[str, ...]
    scratch: Path
    built: dict[str, tuple[str, str]] = field(default_factory=dict)
    remarks: list[str] = field(default_factory=list)  # on what could not be had
    failures: int = 0

    @property
    def rounds(self) -> int:
        """Boosting rounds where rounds are timed one by one, the first of them a warm-up."""
        return 6 * self.repeats

    def attempt(self, function: str, **arguments: Any) -> dict[str, Any] | None:
        """The measurement, or None and a line on stderr where it cannot be had."""
        try:
            return measure(function, arguments, self.threads)
        except MissingError as missing:
            remark = f"skipped {function}: no module {missing}; pip install -e '.[bench]' brings every peer"
        except FailedError as failure:
            remark = f"failed {failure}"
            self.failures += 1
        self.remarks.append(remark)
        print(remark, file=sys.stderr)
        return None

    def matrix(self, kind: str) -> tuple[str, str] | None:
        """The folder of that matrix and its name in the table; None where it cannot be had.

        It is built when first asked for.
        """
        if kind not in self.built:
            folder = str(self.scratch / kind)
            arguments = {"folder": folder, "dataset": str(self.dataset), "quick": self.quick}
            built = self.attempt("building.build", kind=kind, **arguments)
            if built is None:
                return None
            frames, columns = built["shape"]
            self.built[kind] = folder, f"{kind} {frames:,} x {columns:,}"
        return self.built[kind]

    def memory(self, case: str, ours: dict[str, Any], name: str, peer: dict[str, Any]) -> Row:
        """Peak memory of two measurements."""
        return Row("memory", case, ours["gib"], name, peer["gib"], "GiB")


def settled(seconds: Iterable[float]) -> float:
    """The median without the first, which warms up; the first where there is no other."""
    values = list(seconds)
    return median(values[1:] or values)
