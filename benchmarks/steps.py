"""Environment steps per second, evaluating and recording, against PyBullet's bare `getCameraImage` loop.

python benchmarks/steps.py --repeats=5

Two processes start at a barrier, worlds built and modules imported, and keep both cores busy throughout. The
bare loop draws the very pictures of the runs it is compared with, and does nothing else.
"""

import multiprocessing
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from multiprocessing.connection import Connection
from multiprocessing.synchronize import Barrier
from pathlib import Path
from statistics import median
from typing import Any
from unittest.mock import patch

from dpmacro.evaluation.recording import expert_runs
from dpmacro.evaluation.rollouts import PlannerSource, iter_episodes
from dpmacro.evaluation.run_writer import writing_runs
from dpmacro.utils import cli
from dpmacro.worlds import recording_of
from dpmacro.worlds.two_flags.bullet import pybullet

PROCESSES = 2
WORLD = "TwoFlags-v0"

Call = tuple[tuple[Any, ...], dict[str, Any]]


@dataclass
class StepsOptions:
    """How thoroughly to measure."""

    repeats: int = 5
    """Measurements that a median is over."""
    quick: bool = False
    """Short runs; shows that everything works, not how fast it is."""

    def __post_init__(self) -> None:
        if self.repeats < 1:
            raise ValueError(f"repeats is {self.repeats}: give 1 or more")


@dataclass(frozen=True)
class Speeds:
    """Steps per second of all processes together, a number for every repeat."""

    runs: list[float]
    bare: list[float]
    steps: dict[int, int]  # of every seed's run


def main(options: StepsOptions) -> None:
    """Print a line for evaluation and one for recording."""
    for row in rows(options.repeats, options.quick):
        print(
            f"{row['case']}: {row['ours']:.1f} {row['unit']}, bare {row['peer_name']} {row['peer']:.1f}, "
            f"ratio {row['ratio']:.2f}"
        )


def rows(repeats: int, quick: bool) -> list[dict[str, Any]]:
    """A row for evaluation and one for recording, medians of `repeats`."""
    n_runs, max_steps, seeds = (1, 30, range(1000, 1002)) if quick else (8, 600, range(1000, 1004))
    world = {"id": WORLD}
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder)
        recordings = [_record(world, root / f"{k}", n_runs) for k in range(repeats)]
        first, last, _ = recordings[0]
        teacher = speeds(PlannerSource("teacher"), world, _dealt(range(first, last)), 1)
        steps = sum(teacher.steps.values())
        recorded = [steps / seconds for _, _, seconds in recordings]
        source = PlannerSource("policy", _train(root / "0", root / "run", quick))
        evaluated = speeds(source, {**world, "max_steps": max_steps}, _dealt(seeds), repeats)
    return [
        _row(f"evaluation, {PROCESSES} workers", evaluated.runs, evaluated.bare),
        _row(f"recording, {PROCESSES} workers", recorded, teacher.bare),
    ]


def speeds(
    source: PlannerSource, world: dict[str, Any], seeds: Sequence[Sequence[int]], repeats: int
) -> Speeds:
    """How fast runs are, and the bare loop over their pictures, turn and turn about.

    Args:
        source: the planner that acts.
        world: {"id": of the world, **its options}.
        seeds: of the runs, for every process its own.
        repeats: how often each is measured.
    """
    context = multiprocessing.get_context("spawn")
    barrier = context.Barrier(len(seeds))
    connections, processes = [], []
    try:
        for own in seeds:
            here, there = context.Pipe()
            arguments = (there, barrier, source, world, own, repeats)
            process = context.Process(target=_measure, args=arguments)
            process.start()
            there.close()
            connections.append(here)
            processes.append(process)
        results: list[Speeds] = [connection.recv() for connection in connections]
    finally:
        for process in processes:
            process.kill()
            process.join()
    return Speeds(
        [sum(parts) for parts in zip(*(result.runs for result in results), strict=True)],
        [sum(parts) for parts in zip(*(result.bare for result in results), strict=True)],
        {seed: steps for result in results for seed, steps in result.steps.items()},
    )


def _measure(
    results: Connection,
    barrier: Barrier,
    source: PlannerSource,
    world: dict[str, Any],
    seeds: Sequence[int],
    repeats: int,
) -> None:
    """In a process of its own: send its speeds."""
    run_seconds, bare_seconds = [0.0] * repeats, [0.0] * repeats
    n_pictures, steps = 0, {}
    order = [seed for seed in seeds for _ in range(repeats + 1)]
    with closing(iter_episodes(source, world, order)) as episodes:
        for seed in seeds:
            with _camera_calls() as calls:
                steps[seed] = next(episodes).steps
            n_pictures += len(calls)
            if seed == seeds[0]:  # its run made the world
                barrier.wait()
            for k in range(repeats):
                started = time.perf_counter()
                next(episodes)
                middle = time.perf_counter()
                for positional, named in calls:
                    pybullet.getCameraImage(*positional, **named)
                bare_seconds[k] += time.perf_counter() - middle
                run_seconds[k] += middle - started
    n_steps = sum(steps.values())
    results.send(
        Speeds(
            [n_steps / seconds for seconds in run_seconds],
            [n_pictures / seconds for seconds in bare_seconds],
            steps,
        )
    )


@contextmanager
def _camera_calls() -> Iterator[list[Call]]:
    """The arguments of every picture drawn meanwhile."""
    calls: list[Call] = []
    draw = pybullet.getCameraImage

    def noted(*positional: Any, **named: Any) -> Any:
        calls.append((positional, named))
        return draw(*positional, **named)

    with patch.object(pybullet, "getCameraImage", noted):
        yield calls


def _record(world: dict[str, Any], root: Path, n_runs: int) -> tuple[int, int, float]:
    """The seconds from the first kept run on until `n_runs` more are kept, and the seeds tried meanwhile.

    By then worlds are built and LeRobot is imported. As many runs wait at the start as at the end.
    """
    kept, first, started = 0, 0, 0.0
    with (
        writing_runs(root, world, recording_of(world["id"])) as writer,
        closing(expert_runs(world, 0, PROCESSES)) as runs,
    ):
        for seed, run in enumerate(runs):
            if run is not None:
                writer.add(run)
                kept += 1
                if kept == 1:
                    first, started = seed + 1, time.perf_counter()
            if kept > n_runs:
                break
        seconds = time.perf_counter() - started
    return first, seed + 1, seconds


def _train(dataset: Path, folder: Path, quick: bool) -> Path:
    """A policy of the usual size from a few demonstrations."""
    from dpmacro.data.demonstrations import Demonstrations
    from dpmacro.training.options import DatasetOptions, PlannerOptions, TrainOptions
    from dpmacro.training.run_folder import RunFolder
    from dpmacro.training.trainer import Trainer

    rounds, switch_rounds = (5, 5) if quick else (300, 60)
    planner = PlannerOptions(restarts=1, rounds=rounds, switch_rounds=switch_rounds)
    options = TrainOptions(DatasetOptions(dataset), planner)
    return Trainer(Demonstrations.load(dataset), options, RunFolder(folder)).train().pretrained


def _dealt(seeds: Sequence[int]) -> list[list[int]]:
    """The seeds of every process; none is without."""
    return [list(seeds[k::PROCESSES]) for k in range(min(PROCESSES, len(seeds)))]


def _row(case: str, ours: Sequence[float], peer: Sequence[float]) -> dict[str, Any]:
    return {
        "benchmark": "environment steps",
        "case": case,
        "ours": median(ours),
        "peer_name": "getCameraImage",
        "peer": median(peer),
        "ratio": median(ours) / median(peer),
        "unit": "steps/s",
    }


if __name__ == "__main__":
    cli.run(main, StepsOptions)
