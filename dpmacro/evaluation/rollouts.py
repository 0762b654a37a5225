"""Runs of a planner in a world, one seed an episode, in parallel processes.

A run that repeats itself for ever ends at once (dpmacro/evaluation/loops.py). It gets the outcome that it
would have had at the world's last step.
"""

import json
import sys
from collections.abc import Generator, Iterable, Iterator, Mapping, Sequence
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing, contextmanager
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from dpmacro.evaluation.stage import Stage
from dpmacro.utils.checks import as_count, as_kind, as_text
from dpmacro.utils.processes import spread, stopped
from dpmacro.worlds import expert_of
from dpmacro.worlds.base import Episode, Moment, Planner, WorldError
from dpmacro.worlds.making import import_package

__all__ = [
    "PlannerSource",
    "RepeatError",
    "as_before",
    "iter_episodes",
    "one_thread",
    "replay",
    "run_episodes",
    "run_on",
]


class RepeatError(ValueError):
    """A run that was another one when it was repeated; one line."""


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
        world: {"id": of a registered environment, **its options}, as `dpmacro.worlds.making` reads it; built
            once per worker.
        seeds: one per episode.
        workers: processes; 1 runs in this one. Closing the iterator, or an interrupt, ends them.

    Raises:
        ValueError: workers < 1, the planner cannot be read, there is no such world, or the two do not fit. A
            WorldError where the world itself raises, or shows what it should not; episodes before it have
            been given out.
    """
    as_count("workers", workers)
    as_kind("world", world, Mapping, 'its id and options, like {"id": "CartPole-v1"}')
    as_text("world['id']", world.get("id"))
    for seed in as_kind("seeds", seeds, Sequence, "a list of whole numbers"):
        as_count("seeds", seed, 0)
    if workers == 1:
        return _run_here(source, world, seeds)
    return _run_in_processes(source, world, seeds, workers)


def replay(
    source: PlannerSource, world: Mapping[str, Any], seed: int, every: int = 1
) -> Generator[Moment, None, None]:
    """Run `seed` once more, with pictures, and yield its steps.

    Rendering is slow, so `iter_episodes` does without. Every `every`-th moment is rendered, from the first
    on; the others have no view.
    """
    planner = source.planner(world["id"])
    with one_thread(), closing(Stage(planner, world, render_mode="rgb_array")) as stage:
        yield from stage.moments(seed, every)


def as_before(moments: Iterable[Moment], episode: Episode) -> Iterator[Moment]:
    """The moments of a run that is repeated, as they come.

    Raises RepeatError at the first that is not as it was in `episode`: it has another macro-action
    or action, or the run ends otherwise.
    """
    for step, moment in enumerate(moments):
        was = None if step >= episode.steps else (episode.actions[step], int(episode.macros[step]))
        ends = episode.outcome if step == episode.steps - 1 else ""
        if was is None or moment.outcome != ends or moment.macro != was[1] or np.any(moment.action != was[0]):
            raise RepeatError(
                f"the run of seed {episode.seed} cannot be repeated: step {step} was another one before; a "
                "world and a policy give the same run by the same seed where they draw by it alone"
            )
        yield moment


def run_on(stage: Stage, seed: int) -> Episode:
    """One run, in this process."""
    moments = []
    with one_thread():
        for moment in stage.moments(seed):
            moments.append(moment)
            if stopped():
                raise InterruptedError(f"run of seed {seed} stopped after {len(moments)} steps")
    positions = None
    if moments[0].position is not None:
        positions = np.array([moment.position for moment in moments], np.float32)
    successes = (step for step, moment in enumerate(moments) if moment.success)
    return Episode(
        seed=seed,
        outcome=moments[-1].outcome,
        actions=np.array([moment.action for moment in moments], stage.does.recorded_type),
        phases=np.array([moment.phase for moment in moments], np.int8),
        macros=np.array([moment.macro for moment in moments], np.int8),
        rewards=np.array([moment.reward for moment in moments], np.float32),
        loop=moments[-1].loop,
        positions=positions,
        period=stage.period,
        clipped=sum(moment.clipped for moment in moments),
        first_success=next(successes, None),
        success_by=stage.success_by,
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
    with closing(Stage(source.planner(world["id"]), world)) as stage:
        for seed in seeds:
            yield run_on(stage, seed)


def _run_in_processes(
    source: PlannerSource, world: Mapping[str, Any], seeds: Sequence[int], workers: int
) -> Generator[Episode, None, None]:
    task = partial(_run_in_worker, source, json.dumps(dict(world)))
    try:
        yield from spread(task, seeds, min(workers, max(len(seeds), 1)))
    except BrokenProcessPool as error:
        raise WorldError(
            f"a process that ran the world {world['id']} ended in mid-run: run it with --workers=1 to see why"
        ) from error


@cache
def _stage(source: PlannerSource, world: str) -> Stage:
    """One world, given as JSON, and planner a process, for one run after another."""
    made = json.loads(world)
    import_package(made)
    return Stage(source.planner(made["id"]), made)


def _run_in_worker(source: PlannerSource, world: str, seed: int) -> Episode:
    return run_on(_stage(source, world), seed)
