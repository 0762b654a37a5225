"""Record the scripted expert's successful runs in a task of Meta-World as a LeRobot dataset.

python datasets/record_metaworld.py --root=datasets/pick_place --task=pick-place-v3 --episodes=50

A frame holds the state, the action that the expert chose, and its true macro-action in the column `stage`:
the case in which the expert was, like to approach, to descend, to grasp or to carry. Noise is added to the
moves that are made and not to those that are recorded, so that the demonstrations show the way back, too.
"""

import itertools
import json
import math
import shutil
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from dpmacro.data.images import DatasetError
from dpmacro.data.lerobot.compat import create_dataset, quiet
from dpmacro.data.lerobot.reader import WORLD_FILE
from dpmacro.utils import cli, interrupts
from dpmacro.worlds.metaworld import ACTIONS, FPS, STATE, TASKS, Run, check_task, run_expert

TRUTH = "stage"
TRIES = 10  # runs per wanted episode before giving up


@dataclass
class RecordConfig:
    """What to record and where to."""

    root: Path
    """Folder of the new dataset."""
    task: str = next(iter(TASKS))
    """Name of the task in Meta-World."""
    episodes: int = 50
    """Successful runs of two or more frames to keep."""
    noise: float = 0.1
    """Standard deviation of the noise added to every move that is made; moves are within -1..1."""
    seed: int = 0
    """Seed of the first run; every further run takes the next."""

    def __post_init__(self) -> None:
        for name, least in (("episodes", 1), ("seed", 0), ("noise", 0)):
            value = getattr(self, name)
            if not (value >= least and math.isfinite(value)):
                raise ValueError(f"{name} is {value}: give {least} or more")


def main(cfg: RecordConfig) -> None:
    """Record the dataset and say in one line what came of it."""
    check_task(cfg.task)
    start = time.perf_counter()
    kept = frames = failed = 0
    with (
        _new_dataset(cfg.root.absolute(), cfg.task, cfg.noise) as dataset,
        tqdm(total=cfg.episodes, unit="episode") as bar,
    ):
        for tried in itertools.count(1):
            run = run_expert(cfg.task, cfg.seed + tried - 1, cfg.noise)
            if run is None:
                failed += 1
            elif len(run.actions) > 1:
                _add(dataset, run, cfg.task)
                kept += 1
                frames += len(run.actions)
                bar.set_postfix(frames=frames, tried=tried)
                bar.update()
            if kept == cfg.episodes:
                break
            if tried == TRIES * cfg.episodes:
                raise ValueError(
                    f"only {kept} of {tried} runs succeeded, {cfg.episodes} are wanted; the expert does "
                    f"better with less noise than {cfg.noise:g}"
                )
    seconds = time.perf_counter() - start
    print(f"kept {kept} of {tried} runs, {failed} failed, {frames} frames, {seconds:.0f} s: {cfg.root}")


@contextmanager
def _new_dataset(root: Path, task: str, noise: float) -> Iterator[Any]:
    """A LeRobotDataset to add frames to, in `root` once the block has been left, which then is complete.

    An exception leaves nothing behind. Raises DatasetError where `root` exists.
    """
    _refuse_existing(root)
    root.parent.mkdir(parents=True, exist_ok=True)
    folder = Path(tempfile.mkdtemp(prefix=f".{root.name}.", suffix=".partial", dir=root.parent))
    dataset: Any = None
    try:
        with interrupts.held_back():
            dataset = create_dataset(folder / "dataset", FPS, _features())
        recorded = {"world": {"id": f"Meta-World/{task}", "noise": noise}, "truth": {TRUTH: TASKS[task]}}
        (folder / "dataset" / WORLD_FILE).write_text(json.dumps(recorded, indent=2) + "\n")
        yield dataset
        dataset.finalize()
        dataset = None
        shutil.rmtree(folder / "dataset/images", ignore_errors=True)  # LeRobot leaves an empty one behind
        _refuse_existing(root)
        (folder / "dataset").rename(root)
    finally:
        if dataset is not None:
            with suppress(Exception):  # left open, its files abort the interpreter at its end
                dataset.finalize()
        shutil.rmtree(folder, ignore_errors=True)


def _features() -> dict[str, dict[str, Any]]:
    """What every frame has, in LeRobot's terms."""
    number = {"shape": (1,), "names": None}
    return {
        STATE: {"dtype": "float32", "shape": (39,), "names": None},
        "action": {"dtype": "float32", "shape": (len(ACTIONS),), "names": list(ACTIONS)},
        TRUTH: {"dtype": "int64", **number},
        "next.reward": {"dtype": "float32", **number},
        "next.done": {"dtype": "bool", **number},
        "next.success": {"dtype": "bool", **number},
    }


def _add(dataset: Any, run: Run, task: str) -> None:
    last = len(run.actions) - 1
    # Within, Hugging Face's `datasets` would now and then swallow an interrupt.
    with interrupts.held_back(), quiet():
        for t, (state, action) in enumerate(zip(run.states, run.actions, strict=True)):
            dataset.add_frame(
                {
                    STATE: state,
                    "action": action,
                    TRUTH: run.stages[t : t + 1],
                    "next.reward": run.rewards[t : t + 1],
                    "next.done": np.array([t == last]),
                    "next.success": np.array([t == last]),
                    "task": task,
                }
            )
        dataset.save_episode()


def _refuse_existing(root: Path) -> None:
    if root.exists() or root.is_symlink():
        raise DatasetError(f"dataset {root}: exists already; remove it or give another --root")


if __name__ == "__main__":
    cli.run(main, RecordConfig)
