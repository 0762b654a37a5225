"""Runs of a planner in a world, one seed an episode, in parallel processes.

A run that repeats itself for ever ends at once (dpmacro/evaluation/loops.py). It gets the outcome that it
would have had at the world's last step.
"""

import json
import sys
from collections.abc import Generator, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

from dpmacro.evaluation.loops import VisitedStates
from dpmacro.utils.processes import spread, stopped
from dpmacro.worlds import diagnosis_of, expert_of
from dpmacro.worlds.base import NO_MACRO, Episode, Moment, Planner

__all__ = ["PlannerSource", "iter_episodes", "one_thread", "replay", "run_episodes"]


@dataclass(frozen=True)
class PlannerSource:
    """Where a planner comes from, small enough to send to another process.

    Attributes:
        kind: "teacher", or "policy" for a saved `MacroPolicy`.
        path: folder of the saved policy; None for the teacher.
        recovery: whether a policy gets itself out of loops (dpmacro/policy/recovery.py); None for what it was
            saved with.
    """

    kind: str
    path: Path | None = None
    recovery: bool | None = None

    def __post_init__(self) -> None:
        if self.kind not in ("teacher", "policy"):
            raise ValueError(f"planner {self.kind!r} is unknown, there are 'teacher' and 'policy'")
        if (self.kind == "policy") != (self.path is not None):
            raise ValueError(f"a policy needs a path and a teacher has none, got {self.kind} and {self.path}")

    def planner(self, world: str) -> Planner:
        """A new planner for the world of this id.

        Raises ValueError where the policy cannot be read, or the world has no teacher.
        """
        if self.path is None:
            return expert_of(world)
        from dpmacro.policy.policy import MacroPolicy

        return MacroPolicy.load(self.path).planner(self.recovery)


def run_episodes(
    source: PlannerSource, world: Mapping[str, Any], seeds: Sequence[int], workers: int = 1
) -> list[Episode]:
    """All of `iter_episodes`."""
    with closing(iter_episodes(source, world, seeds, workers)) as episodes:
        return list(episodes)


def iter_episodes(
    source: PlannerSource, world: Mapping[str, Any], seeds: Sequence[int], workers: int = 1
) -> Generator[Episode, None, None]:
    """One episode for every seed, in the order of `seeds`, the same for any number of workers.

    Args:
        source: the planner; read once per worker.
        world: {"id": of a registered environment, **its options}; built once per worker.
        seeds: one per episode.
        workers: processes; 1 runs in this one. Closing the iterator, or an interrupt, ends them.

    Raises:
        ValueError: workers < 1, or the planner cannot be read. What a worker raises is raised here.
    """
    if workers < 1:
        raise ValueError(f"workers is {workers}, it must be at least 1")
    if workers == 1:
        return _run_here(source, world, seeds)
    task = partial(_run_in_worker, source, json.dumps(dict(world)))
    return spread(task, seeds, min(workers, max(len(seeds), 1)))


def replay(
    source: PlannerSource, world: Mapping[str, Any], seed: int, every: int = 1
) -> Generator[Moment, None, None]:
    """Run `seed` once more, with pictures, and yield its steps.

    Rendering is slow, so `iter_episodes` does without. Every `every`-th moment is rendered, from the first
    on; the others have no view.
    """
    with one_thread(), closing(_Stage(source, world, render_mode="rgb_array")) as stage:
        yield from stage.moments(seed, every)


class _Stage:
    """A world and a planner in it, for one episode after another."""

    def __init__(self, source: PlannerSource, world: Mapping[str, Any], render_mode: str | None = None):
        options = dict(world)
        world_id = options.pop("id")
        self.planner = source.planner(world_id)
        self.env = gym.make(world_id, render_mode=render_mode, **options)
        self.diagnosis = diagnosis_of(world_id)

    def close(self) -> None:
        self.env.close()

    def moments(self, seed: int, every: int = 1) -> Generator[Moment]:
        observation, info = self.env.reset(seed=seed)
        self.planner.reset(self.env)
        step, ended, visited = 0, False, VisitedStates()
        visited.visit(info, self.planner)
        while not ended:
            rendered = self.env.render_mode is not None and step % every == 0
            view = np.asarray(self.env.render()) if rendered else None
            phase, position = int(info.get("phase", 0)), info.get("position")
            action = int(self.planner.act(observation, info))
            macro = int(getattr(self.planner, "macro", NO_MACRO))
            observation, reward, terminated, truncated, info = self.env.step(action)
            loop = 0 if terminated else visited.visit(info, self.planner)
            ended = bool(terminated or truncated or loop)
            step += 1
            outcome = self.diagnosis.outcome(info) if ended else ""
            yield Moment(phase, action, macro, float(reward), outcome, view, position, loop)

    def episode(self, seed: int) -> Episode:
        moments = []
        with one_thread():
            for moment in self.moments(seed):
                moments.append(moment)
                if stopped():
                    raise InterruptedError(f"run of seed {seed} stopped after {len(moments)} steps")
        return Episode(
            seed=seed,
            outcome=moments[-1].outcome,
            actions=np.array([moment.action for moment in moments], np.uint8),
            phases=np.array([moment.phase for moment in moments], np.int8),
            macros=np.array([moment.macro for moment in moments], np.int8),
            rewards=np.array([moment.reward for moment in moments], np.float32),
            loop=moments[-1].loop,
            positions=None
            if moments[0].position is None
            else np.array([moment.position for moment in moments], np.float32),
        )


@contextmanager
def one_thread() -> Iterator[None]:
    """Within the block torch, where it was imported, uses one thread.

    Single frames gain nothing from threads, and sums must not depend on how many there are.
    """
    # The teacher needs no torch, whose import takes longer than an episode.
    torch = sys.modules.get("torch")
    if torch is None:
        yield
        return
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(threads)


def _run_here(
    source: PlannerSource, world: Mapping[str, Any], seeds: Sequence[int]
) -> Generator[Episode, None, None]:
    with closing(_Stage(source, world)) as stage:
        for seed in seeds:
            yield stage.episode(seed)


@cache
def _stage(source: PlannerSource, world: str) -> _Stage:
    """One world, given as JSON, and planner a process, for one run after another."""
    return _Stage(source, json.loads(world))


def _run_in_worker(source: PlannerSource, world: str, seed: int) -> Episode:
    return _stage(source, world).episode(seed)
