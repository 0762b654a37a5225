"""Runs of planners in a world, every action timed, and an action's time while nothing else runs."""

import multiprocessing
import signal
import time
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache, partial
from multiprocessing.synchronize import Event
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from jaxtyping import Float64, UInt8

from dpmacro.policy import MacroPolicy
from dpmacro.rollouts import SUCCESS, Planner
from dpmacro.worlds.two_flags import TURN_LEFT

__all__ = ["WARM_UP", "Run", "Source", "runs", "sights", "summary", "timed"]

WARM_UP = 20


@dataclass(frozen=True)
class Source:
    """Where a planner comes from, small enough to send to another process.

    Attributes:
        folder: of a saved ACT or `MacroPolicy`.
        action_steps: actions that ACT takes at a sight; None for a `MacroPolicy`.
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
    """How the run of a seed ended, one of `dpmacro.rollouts.OUTCOMES`, and what each of its actions took."""

    seed: int
    outcome: str
    milliseconds: Float64[np.ndarray, " steps"]


def runs(
    source: Source, world: Mapping[str, Any], seeds: Sequence[int], workers: int
) -> Generator[Run, None, None]:
    """One run for every seed, in the order of `seeds`, on one thread in each of `workers` processes.

    `world` is {"id": of a registered environment, **its options}.
    """
    if workers == 1:
        stage = _Stage(source, world)
        for seed in seeds:
            with threads(1):
                run = stage.run(seed)
            yield run
        return
    context = multiprocessing.get_context("spawn")
    stop = context.Event()
    executor = ProcessPoolExecutor(workers, context, _start_worker, (source, dict(world), stop))
    try:
        yield from executor.map(_run_in_worker, seeds)
    finally:
        stop.set()
        executor.shutdown(cancel_futures=True)


def sights(world: Mapping[str, Any], seed: int, count: int) -> UInt8[np.ndarray, "frames height width 3"]:
    """What the avatar sees while it turns left."""
    env = _environment({**world, "max_steps": count + 1})
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


class _Stage:
    """A world and a planner in it."""

    def __init__(self, source: Source, world: Mapping[str, Any]):
        self.planner = source.planner()
        self.env = _environment(world)

    def run(self, seed: int, stop: Event | None = None) -> Run:
        observation, info = self.env.reset(seed=seed)
        self.planner.reset(self.env)
        took, ended = [], False
        while not ended:
            action, milliseconds = _timed_action(self.planner, observation, info)
            took.append(milliseconds)
            observation, _, terminated, truncated, info = self.env.step(action)
            ended = bool(terminated or truncated)
            if stop is not None and stop.is_set():
                raise InterruptedError(f"run of seed {seed} stopped after {len(took)} steps")
        return Run(seed, _outcome(info), np.array(took))


def _environment(world: Mapping[str, Any]) -> gym.Env:
    # A JSON file gives lists for tuples.
    options = {name: tuple(value) if isinstance(value, list) else value for name, value in world.items()}
    return gym.make(options.pop("id"), **options)


def _timed_action(planner: Planner, observation: dict[str, Any], info: dict[str, Any]) -> tuple[int, float]:
    start = time.perf_counter()
    action = planner.act(observation, info)
    return action, 1e3 * (time.perf_counter() - start)


def _outcome(info: Mapping[str, Any]) -> str:
    if info["is_success"]:
        return SUCCESS
    return info["failure"] or ("red_never_reached" if info["phase"] else "blue_never_reached")


# A worker process's world and planner, made with its first run, and the parent's word to stop.
_stage: Callable[[], _Stage]
_stop: Event


def _start_worker(source: Source, world: dict[str, Any], stop: Event) -> None:
    global _stage, _stop
    _stage, _stop = cache(partial(_Stage, source, world)), stop
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent is interrupted too, and says when to stop
    torch.set_num_threads(1)


def _run_in_worker(seed: int) -> Run:
    return _stage().run(seed, _stop)
