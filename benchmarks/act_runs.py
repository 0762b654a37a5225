"""Runs of planners in a world, every action timed, and an action's time while nothing else runs."""

import json
import time
from collections.abc import Generator, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from jaxtyping import Float64, UInt8

from dpmacro.policy.policy import MacroPolicy
from dpmacro.utils.processes import spread, stopped
from dpmacro.worlds.base import Planner
from dpmacro.worlds.two_flags.diagnosis import outcome_of
from dpmacro.worlds.two_flags.env import TURN_LEFT

__all__ = ["WARM_UP", "Run", "Source", "observations", "runs", "summary", "timed"]

WARM_UP = 20


@dataclass(frozen=True)
class Source:
    """Where a planner comes from, small enough to send to another process.

    Attributes:
        folder: of a saved ACT or `MacroPolicy`.
        action_steps: actions that ACT takes at a look; None for a `MacroPolicy`.
    """

    folder: Path
    action_steps: int | None = None

    def planner(self) -> Planner:
        """A new planner."""
        if self.action_steps is None:
            return MacroPolicy.load(self.folder).planner()
        from act_training import ActPlanner

        return ActPlanner(self.folder, self.action_steps)


@dataclass(frozen=True)
class Run:
    """How the run of a seed ended, one of the world's `OUTCOMES`, and what each of its actions took."""

    seed: int
    outcome: str
    milliseconds: Float64[np.ndarray, " steps"]


def runs(
    source: Source, world: Mapping[str, Any], seeds: Sequence[int], workers: int
) -> Generator[Run, None, None]:
    """One run for every seed, in the order of `seeds`, on one thread in each of `workers` processes.

    `world` is {"id": of a registered environment, **its options}.
    """
    task = partial(_run, source, json.dumps(world))
    yield from map(task, seeds) if workers == 1 else spread(task, seeds, workers)


def observations(
    world: Mapping[str, Any], seed: int, count: int
) -> UInt8[np.ndarray, "frames height width 3"]:
    """What the avatar sees while it turns left."""
    options = {**world, "max_steps": count + 1}
    env = gym.make(options.pop("id"), **options)
    seen = [env.reset(seed=seed)[0]["pixels"]]
    while len(seen) < count:
        seen.append(env.step(TURN_LEFT)[0]["pixels"])
    env.close()
    return np.stack(seen)


def timed(source: Source, images: UInt8[np.ndarray, "frames height width 3"], count: int) -> dict[str, float]:
    """`summary` of what the planner takes for each image after the first `WARM_UP`, on `count` threads."""
    planner = source.planner()
    planner.reset(gym.Env())  # neither kind of planner looks at it
    with threads(count):
        took = [_timed_action(planner, {"pixels": image}, {})[1] for image in images]
    return summary(np.array(took[WARM_UP:]))


def summary(milliseconds: Float64[np.ndarray, " actions"]) -> dict[str, float]:
    """Mean and 95th percentile."""
    return {"mean": float(milliseconds.mean()), "p95": float(np.percentile(milliseconds, 95))}


@contextmanager
def threads(count: int) -> Iterator[None]:
    """Let torch use so many threads."""
    before = torch.get_num_threads()
    torch.set_num_threads(count)
    try:
        yield
    finally:
        torch.set_num_threads(before)


@cache
def _stage(source: Source, world: str) -> tuple[Planner, gym.Env]:
    """One planner and world, given as JSON, a process, for one run after another."""
    options = json.loads(world)
    return source.planner(), gym.make(options.pop("id"), **options)


def _run(source: Source, world: str, seed: int) -> Run:
    planner, env = _stage(source, world)
    observation, info = env.reset(seed=seed)
    planner.reset(env)
    took, ended = [], False
    with threads(1):
        while not ended and not stopped():
            action, milliseconds = _timed_action(planner, observation, info)
            took.append(milliseconds)
            observation, _, terminated, truncated, info = env.step(action)
            ended = bool(terminated or truncated)
    return Run(seed, outcome_of(info), np.array(took))


def _timed_action(planner: Planner, observation: dict[str, Any], info: dict[str, Any]) -> tuple[int, float]:
    start = time.perf_counter()
    action = planner.act(observation, info)
    return action, 1e3 * (time.perf_counter() - start)
