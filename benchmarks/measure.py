"""One measurement in a process of its own, so that none leaves memory, threads or warm caches to the next.

python benchmarks/measure.py peers.xgboost '{"matrix": "outputs/pixels", "rounds": 20, "threads": 2}'
"""

import importlib
import json
import os
import re
import resource
import subprocess
import sys
from pathlib import Path
from typing import Any

__all__ = ["FailedError", "MissingError", "measure", "peak_gib"]

THREADS = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS")
KIB_PER_GIB = 2**20


class MissingError(Exception):
    """A module that a measurement imports is not installed; the message is its name."""


class FailedError(Exception):
    """A measurement ended in an error; the message is the last line it wrote."""


def measure(function: str, arguments: dict[str, Any], threads: int) -> dict[str, Any]:
    """What `module.function(**arguments)` returns in a fresh process on `threads` threads; a list as `rows`.

    `gib` of the result is the peak of the process' resident memory: at its end, unless the function says
    itself. Raises MissingError where it imports what is not installed, FailedError where it ends in an error.
    """
    done = subprocess.run(
        [sys.executable, __file__, function, json.dumps(arguments)],
        env=os.environ | dict.fromkeys(THREADS, str(threads)),
        capture_output=True,
        text=True,
    )
    if done.returncode:
        lines = done.stderr.strip().splitlines() or [f"exit status {done.returncode}"]
        raise FailedError(f"{function}: {lines[-1]}")
    answer = json.loads(done.stdout.splitlines()[-1])
    if "missing" in answer:
        raise MissingError(answer["missing"])
    return answer


def peak_gib() -> float:
    """The most resident memory that this process has held so far, in GiB, mapped files included.

    Where Linux tells it, of this program alone: ru_maxrss starts from what its parent held.
    """
    status = Path("/proc/self/status")
    found = re.search(r"VmHWM:\s*(\d+) kB", status.read_text()) if status.exists() else None
    return int(found[1] if found else resource.getrusage(resource.RUSAGE_SELF).ru_maxrss) / KIB_PER_GIB


def main(name: str, arguments: str) -> None:
    """Call the function and print its result as the last line."""
    module, function = name.rsplit(".", 1)
    try:
        answer = getattr(importlib.import_module(module), function)(**json.loads(arguments))
        answer = answer if isinstance(answer, dict) else {"rows": answer}
        answer.setdefault("gib", peak_gib())
    except ModuleNotFoundError as error:
        answer = {"missing": error.name}
    print(json.dumps(answer))


if __name__ == "__main__":
    sys.path.append(str(Path(__file__).parent))
    main(*sys.argv[1:])
