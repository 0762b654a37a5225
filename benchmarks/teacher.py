"""How often the teacher succeeds in TwoFlags, and how its failures split.

python benchmarks/teacher.py --flags=random --episodes=500 --seed=0 --workers=2
"""

from collections import Counter
from contextlib import closing
from dataclasses import dataclass

import numpy as np
from tqdm import tqdm

from dpmacro.evaluation.rollouts import PlannerSource, iter_episodes
from dpmacro.metrics.success import wilson_interval
from dpmacro.utils import cli
from dpmacro.worlds.base import SUCCESS
from dpmacro.worlds.two_flags.diagnosis import OUTCOMES
from dpmacro.worlds.two_flags.env import PIXELS, TwoFlagsConfig


@dataclass
class TeacherConfig:
    """Which runs to make."""

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
        TwoFlagsConfig(flags=self.flags, layout_seed=self.layout_seed)
        for name, least in (("episodes", 1), ("seed", 0), ("workers", 1)):
            if getattr(self, name) < least:
                raise ValueError(f"{name} is {getattr(self, name)}: give {least} or more")


def main(cfg: TeacherConfig) -> None:
    """Run the teacher and print one line of figures and one of outcomes."""
    # The teacher looks at no pixel, so the smallest picture gives the same runs sooner.
    world = {
        "id": "TwoFlags-v0",
        "flags": cfg.flags,
        "layout_seed": cfg.layout_seed,
        "render_size": PIXELS,
    }
    seeds = range(cfg.seed, cfg.seed + cfg.episodes)
    with closing(iter_episodes(PlannerSource("teacher"), world, seeds, cfg.workers)) as episodes:
        done = list(tqdm(episodes, total=cfg.episodes, unit="episode"))
    outcomes = Counter(episode.outcome for episode in done)
    steps = [episode.steps for episode in done if episode.success] or [0]
    low, high = wilson_interval(outcomes[SUCCESS], cfg.episodes)
    print(
        f"teacher, {cfg.flags} flags: {outcomes[SUCCESS]} of {cfg.episodes} succeed, "
        f"{outcomes[SUCCESS] / cfg.episodes:.1%} (95% Wilson {low:.1%} to {high:.1%}), "
        f"median {np.median(steps):.0f} and at most {max(steps)} steps"
    )
    print(", ".join(f"{outcome} {outcomes[outcome]}" for outcome in OUTCOMES))


if __name__ == "__main__":
    cli.run(main, TeacherConfig)
