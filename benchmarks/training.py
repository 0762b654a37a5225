"""Peak memory of a whole training of the baseline on pixels, against the goal."""

import resource
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from measure import KIB_PER_GIB
from plan import Plan
from report import Row

__all__ = ["rows", "train"]

ROOT = Path(__file__).parents[1]
GOAL = 2.5  # GiB
ROUNDS = 20
FRAMES, QUICK_FRAMES = 17_000, 1_000


def rows(plan: Plan) -> Iterator[Row]:
    """train.py from the dataset to the saved policy."""
    frames = QUICK_FRAMES if plan.quick else FRAMES
    found = plan.attempt("training.train", dataset=str(plan.dataset), frames=frames)
    if found is not None:
        case = f"train.py, baseline, pixels, {found['frames']:,} frames"
        yield Row("memory", case, found["gib"], "goal", GOAL, "GiB")


def train(dataset: str, frames: int) -> dict[str, Any]:
    """Train on the first trajectories that hold `frames` frames; on all where they hold fewer."""
    from dpmacro.data.lerobot.reader import StoredDataset

    store = StoredDataset.open(Path(dataset))
    episodes, total = [], 0
    for row in store.choose(None):
        if total < frames:
            episodes.append(row.index)
            total += row.length or 0
    with tempfile.TemporaryDirectory() as folder:
        command = [
            *(sys.executable, "train.py", f"--dataset.root={Path(dataset).resolve()}"),
            *(f"--dataset.episodes={episodes}", f"--output_dir={folder}/run"),
            *("--planner.type=baseline", "--planner.features=pixels", f"--planner.rounds={ROUNDS}"),
        ]
        subprocess.run(command, cwd=ROOT, stdout=subprocess.DEVNULL, check=True)
    gib = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / KIB_PER_GIB
    return {"gib": gib, "frames": total}
