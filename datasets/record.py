"""Record a teacher's successful runs as a LeRobot dataset.

python datasets/record.py --root=datasets/two_flags --episodes=20 --seed=0
"""

import functools
import itertools
import time
from collections.abc import Generator
from contextlib import closing
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from jaxtyping import Float32, Int64, UInt8
from tqdm import tqdm

from dpmacro.data.lerobot.writer import DemonstrationWriter
from dpmacro.utils import cli
from dpmacro.utils.processes import spread, stopped
from dpmacro.worlds import expert_of, recording_of
from dpmacro.worlds.base import Expert
from dpmacro.worlds.two_flags.env import ACTIONS, TwoFlagsConfig, TwoFlagsEnv

WORLD = "TwoFlags-v0"
FPS: int = TwoFlagsEnv.metadata["render_fps"]  # type: ignore[assignment]
TRIES = 10  # runs per wanted episode before giving up: the teacher succeeds in most


@dataclass
class RecordConfig:
    """What to record and where to."""

    root: Path
    """Folder of the new dataset."""
    episodes: int = 20
    """Successful runs to keep."""
    seed: int = 0
    """Seed of the first run; every further run takes the next."""
    view: bool = False
    """Whether to store the avatar's 320x240 view for people as video, too."""
    workers: int = 2
    """Processes that run the teacher; the dataset does not depend on how many."""
    world: TwoFlagsConfig = field(default_factory=TwoFlagsConfig)
    """Options of the world."""

    def __post_init__(self) -> None:
        for name, least in (("episodes", 1), ("seed", 0), ("workers", 1)):
            if getattr(self, name) < least:
                raise ValueError(f"{name} is {getattr(self, name)}: give {least} or more")


@dataclass(frozen=True)
class Run:
    """A successful run; frame t holds the observation before action t."""

    images: UInt8[np.ndarray, "frames height width 3"]
    actions: Int64[np.ndarray, " frames"]
    truth: dict[str, Int64[np.ndarray, " frames"]]
    rewards: Float32[np.ndarray, " frames"]
    views: UInt8[np.ndarray, "frames view_height view_width 3"] | None


def main(cfg: RecordConfig) -> None:
    """Record the dataset and say in one line what came of it."""
    start = time.perf_counter()
    world = {"id": WORLD, **asdict(cfg.world)}
    told = recording_of(WORLD)
    kept = frames = tried = 0
    with (
        DemonstrationWriter.create(
            cfg.root, ACTIONS, FPS, world, cfg.view, told.truth, symmetric=told.symmetric
        ) as writer,
        closing(teacher_runs(world, cfg.view, cfg.seed, cfg.workers)) as runs,
        tqdm(total=cfg.episodes, unit="episode") as bar,
    ):
        for run in runs:
            tried += 1
            if run is not None:
                writer.add_episode(
                    run.images, run.actions, run.truth, run.rewards, True, told.task, run.views
                )
                kept += 1
                frames += len(run.actions)
                bar.set_postfix(frames=frames, tried=tried)
                bar.update()
            if kept == cfg.episodes:
                break
            if tried == TRIES * cfg.episodes:
                raise ValueError(
                    f"only {kept} of {tried} runs succeeded, {cfg.episodes} are wanted; "
                    "allow longer ones by --world.max_steps"
                )
    seconds = time.perf_counter() - start
    print(f"kept {kept} of {tried} runs, {frames} frames, {seconds:.0f} s: {cfg.root}")


def teacher_runs(world: dict[str, Any], view: bool, seed: int, workers: int) -> Generator[Run | None]:
    """The teacher's runs with seed, seed + 1, ... without end; None for each that failed."""
    return spread(functools.partial(run_teacher, tuple(world.items()), view), itertools.count(seed), workers)


def run_teacher(world: tuple[tuple[str, Any], ...], view: bool, seed: int) -> Run | None:
    """One run of the teacher; None where it fails."""
    env, teacher = _stage(world, view)
    observation, info = env.reset(seed=seed)
    teacher.reset(env)
    images, actions, phases, rewards, views = [], [], [], [], []
    ended = False
    while not ended:
        if stopped():
            return None
        images.append(observation["pixels"])
        phases.append(info["phase"])
        if view:
            views.append(env.render())
        actions.append(teacher.act(observation, info))
        observation, reward, terminated, truncated, info = env.step(actions[-1])
        rewards.append(reward)
        ended = terminated or truncated
    if not info["is_success"]:
        return None
    return Run(
        images=np.stack(images),
        actions=np.array(actions, np.int64),
        truth={"phase": np.array(phases, np.int64)},
        rewards=np.array(rewards, np.float32),
        views=np.stack(views) if view else None,
    )


@functools.cache
def _stage(world: tuple[tuple[str, Any], ...], view: bool) -> tuple[gym.Env, Expert]:
    """One world and teacher a process, for one run after another."""
    options = dict(world)
    env = gym.make(options.pop("id"), render_mode="rgb_array" if view else None, **options)
    return env, expert_of(WORLD)


if __name__ == "__main__":
    cli.run(main, RecordConfig)
