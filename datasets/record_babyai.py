"""Record the bot's successful runs in a BabyAI level as a LeRobot dataset.

python datasets/record_babyai.py --root=datasets/unlock_pickup --level=BabyAI-UnlockPickup-v0 --episodes=100

Every frame tells its true macro-action in two columns. `subgoal` is the class of the bot's current subgoal:
to go next to something, or the single action there, so that the action alone tells it. `purpose` is what a
walk is for: to pick up, to drop, to open, to explore. Scripts that compare with the truth take the former, or
the latter by --dataset.truth=purpose.
"""

import itertools
import time
from dataclasses import dataclass
from pathlib import Path

from tqdm import tqdm

from dpmacro.data.lerobot.writer import DemonstrationWriter
from dpmacro.utils import cli
from dpmacro.worlds.babyai import ACTIONS, LEVELS, SUBGOALS, check_level, run_bot

FPS = 10
TRIES = 10  # runs per wanted episode before giving up


@dataclass
class RecordConfig:
    """What to record and where to."""

    root: Path
    """Folder of the new dataset."""
    level: str = LEVELS[0]
    """Gymnasium id of the level."""
    episodes: int = 100
    """Successful runs of two or more frames to keep."""
    seed: int = 0
    """Seed of the first run; every further run takes the next."""

    def __post_init__(self) -> None:
        for name, least in (("episodes", 1), ("seed", 0)):
            if getattr(self, name) < least:
                raise ValueError(f"{name} is {getattr(self, name)}: give {least} or more")


def main(cfg: RecordConfig) -> None:
    """Record the dataset and say in one line what came of it."""
    check_level(cfg.level)
    start = time.perf_counter()
    kept = frames = failed = 0
    classes = {"subgoal": SUBGOALS, "purpose": SUBGOALS}
    world = {"id": cfg.level}
    with (
        DemonstrationWriter.create(cfg.root, ACTIONS, FPS, world, view=False, classes=classes) as writer,
        tqdm(total=cfg.episodes, unit="episode") as bar,
    ):
        for tried in itertools.count(1):
            run = run_bot(cfg.level, cfg.seed + tried - 1)
            if run is None:
                failed += 1
            elif len(run.actions) > 1:
                truth = {"subgoal": run.subgoals, "purpose": run.purposes}
                writer.add_episode(run.images, run.actions, truth, run.rewards, True, task=run.mission)
                kept += 1
                frames += len(run.actions)
                bar.set_postfix(frames=frames, tried=tried)
                bar.update()
            if kept == cfg.episodes:
                break
            if tried == TRIES * cfg.episodes:
                raise ValueError(
                    f"only {kept} of {tried} runs succeeded, {cfg.episodes} are wanted; "
                    f"the bot does better in {', '.join(LEVELS)}"
                )
    seconds = time.perf_counter() - start
    print(f"kept {kept} of {tried} runs, {failed} failed, {frames} frames, {seconds:.0f} s: {cfg.root}")


if __name__ == "__main__":
    cli.run(main, RecordConfig)
