"""Record the successful runs of a world's teacher as a LeRobot dataset.

    python datasets/record.py --root=datasets/two_flags --episodes=20
    python datasets/record.py --root=datasets/assembly --world.id=Meta-World/assembly-v3 --noise=0.1
    python datasets/record.py --root=datasets/put_next --world.id=BabyAI-PutNextS5N2-v0 --episodes=100

Every frame tells its true macro-action, for scores only: the phase of the task, the stage that Meta-World's
expert was in, or the subgoal of BabyAI's bot. BabyAI has two such columns. `subgoal` is the class of the
bot's subgoal: to go next to something, or the single action there, so that the action alone tells it.
`purpose` is what a walk is for: to pick up, to drop, to open, to explore. Scripts that compare with the truth
take the former, or the latter by --dataset.truth=purpose.

Every run is kept on disk at once. Where a recording was stopped, the same command goes on with the other
runs, and the dataset is the one that it would have been. It has its name once it is complete.

Noise is added to the moves that are made and not to those that are recorded, so that the demonstrations show
the way back, too.
"""

if __name__ in ("__main__", "__mp_main__"):
    import dpmacro.utils.starting  # noqa: F401  Ctrl-C during the imports below is one line

import math
import sys
import time
from collections.abc import Generator
from contextlib import closing
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path
from typing import Any

from tqdm import tqdm

from dpmacro.evaluation.kept_recording import KeptRuns, keeping_runs
from dpmacro.evaluation.recording import Run, check_expert, expert_runs
from dpmacro.evaluation.run_writer import writing_runs
from dpmacro.utils import cli
from dpmacro.utils.claims import claimed
from dpmacro.utils.files import telling_what_is_safe
from dpmacro.worlds import DEFAULT
from dpmacro.worlds.base import Recording
from dpmacro.worlds.making import WorldOptions, complete

TRIES = 10  # runs per wanted episode before giving up: the teacher succeeds in most


@dataclass
class RecordConfig:
    """What to record and where to."""

    root: Path
    """Folder of the new dataset."""
    world: WorldOptions = field(default_factory=WorldOptions)
    """The world to record in."""
    episodes: int = 20
    """Successful runs of two or more frames to keep."""
    noise: float = 0.0
    """Standard deviation of the noise added to every move that is made; only worlds of vectors take any."""
    seed: int = 0
    """Seed of the first run; every further run takes the next."""
    view: bool = False
    """Whether to store a view for people as video, too."""
    workers: int = 2
    """Processes that run the teacher; the dataset does not depend on how many."""

    def __post_init__(self) -> None:
        for name, least in (("episodes", 1), ("seed", 0), ("workers", 1), ("noise", 0)):
            value = getattr(self, name)
            if not (value >= least and math.isfinite(value)):
                raise ValueError(f"{name} is {value}: give {least} or more")


def main(cfg: RecordConfig) -> None:
    """Record the dataset and say in one line what came of it."""
    world = complete(cfg.world.over({"id": DEFAULT}))
    told = check_expert(world, cfg.noise)
    about = {"world": world, "noise": cfg.noise, "view": cfg.view, "seed": cfg.seed, "episodes": cfg.episodes}
    with claimed(cfg.root, "--root", beside=True), keeping_runs(cfg.root, about) as kept:
        if kept.episodes:
            print(f"goes on: {kept_so_far(kept, cfg.episodes)}")
        try:
            record(cfg, world, told, kept)
        except (ValueError, OSError, KeyboardInterrupt):
            if kept.episodes:
                done = kept_so_far(kept, cfg.episodes)
                print(f"{done}: the same command goes on with them", file=sys.stderr)
            raise


def kept_so_far(kept: KeptRuns, episodes: int) -> str:
    """How much of a recording is safe, in words."""
    if not kept.episodes:
        return "nothing of it is kept"
    return f"{kept.episodes} of {episodes} episodes are kept in {kept.folder}"


def record(cfg: RecordConfig, world: dict[str, Any], told: Recording, kept: KeptRuns) -> None:
    """Write the runs that are kept and those that follow into the dataset."""
    start = time.perf_counter()
    episodes = failed = tried = 0
    with (
        telling_what_is_safe(cfg.root, lambda: kept_so_far(kept, cfg.episodes)),
        writing_runs(cfg.root, world, told, cfg.noise, kept.building) as writer,
        closing(new_runs(cfg, world, kept)) as new,
        tqdm(total=cfg.episodes, unit="episode") as bar,
    ):
        for run in chain(kept.runs(), new):
            tried += 1
            if run is None:
                failed += 1
            elif len(run.actions) > 1:
                writer.add(run)
                episodes += 1
                bar.set_postfix(frames=writer.frames, tried=tried)
                bar.update()
            if episodes == cfg.episodes:
                break
            if tried == TRIES * cfg.episodes:
                kept.remove()
                remedy = f"give less noise than {cfg.noise:g}" if cfg.noise else "allow longer ones"
                raise ValueError(
                    f"only {episodes} of {tried} runs succeeded, {cfg.episodes} are wanted; {remedy} or "
                    "other options of the world, like --world.max_steps"
                )
    seconds = time.perf_counter() - start
    print(
        f"kept {episodes} of {tried} runs, {failed} failed, {writer.frames} frames, {seconds:.0f} s: "
        f"{cfg.root}"
    )


def new_runs(cfg: RecordConfig, world: dict[str, Any], kept: KeptRuns) -> Generator[Run | None]:
    """The runs of the seeds after those that are kept, each kept before it is handed on."""
    seed = cfg.seed + kept.tried
    with closing(expert_runs(world, seed, cfg.workers, cfg.noise, cfg.view)) as runs:
        for run in runs:
            kept.add(run)
            yield run


if __name__ == "__main__":
    cli.run(main, RecordConfig)
