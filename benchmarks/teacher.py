"""How often the teacher succeeds among flags, how long it takes, and how its failures split.

python benchmarks/teacher.py --flags=random --episodes=500 --seed=0 --workers=2
python benchmarks/teacher.py --id=FourFlags-v0 --ways=any --teacher=searching --episodes=100 --seed=5000
"""

from collections import Counter
from contextlib import closing
from dataclasses import dataclass
from typing import Any

import numpy as np
from tqdm import tqdm

from dpmacro.evaluation.rollouts import PlannerSource, iter_episodes
from dpmacro.metrics.success import wilson_interval
from dpmacro.utils import cli
from dpmacro.worlds import diagnosis_of
from dpmacro.worlds.base import SUCCESS
from dpmacro.worlds.making import complete
from dpmacro.worlds.two_flags.env import PIXELS

WORLDS = ("TwoFlags-v0", "FourFlags-v0", "SixFlags-v0")


@dataclass
class TeacherConfig:
    """Which runs to make."""

    id: str = "TwoFlags-v0"
    """The world, one of TwoFlags-v0, FourFlags-v0 and SixFlags-v0."""
    teacher: str = "paper"
    """The world's teacher, "paper" or "searching"."""
    ways: str | None = None
    """Whether flags may stand in the way of one another, "any" or "clear"; by default as the world has it."""
    flags: str = "random"
    """Flags placed anew each episode ("random"), or one layout for all ("fixed")."""
    layout_seed: int = 0
    """Seed of the layout that "fixed" keeps."""
    episodes: int = 500
    """Runs to make."""
    seed: int = 0
    """Seed of the first run; every further run takes the next."""
    workers: int = 2
    """Processes; the result does not depend on how many."""

    def __post_init__(self) -> None:
        if self.id not in WORLDS:
            raise ValueError(f"id is {self.id!r}: choose among {', '.join(WORLDS)}")
        complete(self.world)
        for name, least in (("episodes", 1), ("seed", 0), ("workers", 1)):
            if getattr(self, name) < least:
                raise ValueError(f"{name} is {getattr(self, name)}: give {least} or more")

    @property
    def world(self) -> dict[str, Any]:
        """The world to run in."""
        return {
            "id": self.id,
            "teacher": self.teacher,
            **({} if self.ways is None else {"ways": self.ways}),
            "flags": self.flags,
            "layout_seed": self.layout_seed,
            # The teacher looks at no pixel, so the smallest picture gives the same runs sooner.
            "render_size": PIXELS,
        }


def main(cfg: TeacherConfig) -> None:
    """Run the teacher and print one line of figures and one of outcomes."""
    seeds = range(cfg.seed, cfg.seed + cfg.episodes)
    with closing(iter_episodes(PlannerSource("teacher"), cfg.world, seeds, cfg.workers)) as episodes:
        done = list(tqdm(episodes, total=cfg.episodes, unit="episode"))
    outcomes = Counter(episode.outcome for episode in done)
    steps = [episode.steps for episode in done if episode.success] or [0]
    low, high = wilson_interval(outcomes[SUCCESS], cfg.episodes)
    print(
        f"{cfg.teacher} teacher, {cfg.id}, {cfg.flags} flags: {outcomes[SUCCESS]} of {cfg.episodes} succeed, "
        f"{outcomes[SUCCESS] / cfg.episodes:.1%} (95% Wilson {low:.1%} to {high:.1%}), "
        f"mean {np.mean(steps):.0f}, median {np.median(steps):.0f} and at most {max(steps)} steps"
    )
    print(", ".join(f"{outcome} {outcomes[outcome]}" for outcome in diagnosis_of(cfg.id).outcomes))


if __name__ == "__main__":
    cli.run(main, TeacherConfig)
