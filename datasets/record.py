"""Record the successful runs of a world's teacher as a LeRobot dataset.

    python datasets/record.py --root=datasets/two_flags --episodes=20
    python datasets/record.py --root=datasets/assembly --world.id=Meta-World/assembly-v3 --noise=0.1
    python datasets/record.py --root=datasets/put_next --world.id=BabyAI-PutNextS5N2-v0 --episodes=100

Every frame tells its true macro-action, for scores only: the phase of the task, the stage that Meta-World's
expert was in, or the subgoal of BabyAI's bot. BabyAI has two such columns. `subgoal` is the class of the
bot's subgoal: to go next to something, or the single action there, so that the action alone tells it.
`purpose` is what a walk is for: to pick up, to drop, to open, to explore. Scripts that compare with the truth
take the former, or the latter by --dataset.truth=purpose.

Noise is added to the moves that are made and not to those that are recorded, so that the demonstrations show
the way back, too.
"""

if __name__ in ("__main__", "__mp_main__"):
    import dpmacro.utils.starting  # noqa: F401  Ctrl-C during the imports below is one line

import math
import time
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path

from tqdm import tqdm

from dpmacro.evaluation.recording import check_expert, expert_runs
from dpmacro.evaluation.run_writer import writing_runs
from dpmacro.utils import cli
from dpmacro.utils.claims import claimed
from dpmacro.utils.files import telling_what_is_safe
from dpmacro.worlds import DEFAULT
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
    start = time.perf_counter()
    world = complete(cfg.world.over({"id": DEFAULT}))
    told = check_expert(world, cfg.noise)
    kept = failed = tried = 0
    with (
        claimed(cfg.root, "--root", beside=True),
        telling_what_is_safe(cfg.root, lambda: "nothing of it is kept"),
        writing_runs(cfg.root, world, told, cfg.noise) as writer,
        closing(expert_runs(world, cfg.seed, cfg.workers, cfg.noise, cfg.view)) as runs,
        tqdm(total=cfg.episodes, unit="episode") as bar,
    ):
        for run in runs:
            tried += 1
            if run is None:
                failed += 1
            elif len(run.actions) > 1:
                writer.add(run)
                kept += 1
                bar.set_postfix(frames=writer.frames, tried=tried)
                bar.update()
            if kept == cfg.episodes:
                break
            if tried == TRIES * cfg.episodes:
                remedy = f"give less noise than {cfg.noise:g}" if cfg.noise else "allow longer ones"
                raise ValueError(
                    f"only {kept} of {tried} runs succeeded, {cfg.episodes} are wanted; {remedy} or other "
                    "options of the world, like --world.max_steps"
                )
    seconds = time.perf_counter() - start
    print(
        f"kept {kept} of {tried} runs, {failed} failed, {writer.frames} frames, {seconds:.0f} s: {cfg.root}"
    )


if __name__ == "__main__":
    cli.run(main, RecordConfig)
