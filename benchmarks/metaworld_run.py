"""One planner in one task of Meta-World: fitted, if it is a peer, and run; how it fared goes to a file.

    python benchmarks/metaworld_run.py --task=hammer-v3 --planner=trees --dataset=<demonstrations> \
        --output_dir=outputs/trees
    python benchmarks/metaworld_run.py --task=hammer-v3 --planner=policy --policy=<pretrained_model> \
        --output_dir=outputs/policy

`table_metaworld.py` starts it for every cell of its table.
"""

import json
import time
from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass, field
from functools import cache, partial
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from act_chunks import StateChunks
from act_training import ActOptions, StateActPlanner, facts_of, train
from metaworld_peers import PEERS, Peer
from safetensors.torch import load_file
from tqdm import tqdm

from dpmacro.data.demonstrations import Demonstrations
from dpmacro.evaluation.rollouts import one_thread
from dpmacro.evaluation.stage import Stage
from dpmacro.policy.policy import MacroPolicy
from dpmacro.utils import cli
from dpmacro.utils.files import replacing
from dpmacro.utils.processes import spread, stopped
from dpmacro.worlds import expert_of
from dpmacro.worlds.base import SUCCESS, Moment, Planner
from dpmacro.worlds.metaworld import FAMILY, TASKS

__all__ = ["HIDDEN", "RESULT", "VALIDATION_SEED", "main", "world_of"]

RESULT = "result.json"
VALIDATION_SEED = 5000
HIDDEN = ("TwoButtons-v0", "TwoGoals-v0")  # worlds beside Meta-World, whose phase cannot be seen
PLANNERS = ("expert", "policy", "act", *PEERS)


@dataclass(frozen=True)
class RunOptions:
    """What runs, and where."""

    task: str
    """Task of Meta-World, or one of two worlds with a hidden phase, TwoButtons-v0 or TwoGoals-v0."""
    planner: str
    """expert, policy, act, trees, neighbours or network."""
    output_dir: Path
    """Folder for what is fitted and for the result."""
    dataset: Path | None = None
    """Demonstrations that a peer learns from."""
    policy: Path | None = None
    """Folder pretrained_model of a training, for the planner policy."""
    train_seed: int = 0
    """Seed of a peer's training."""
    seconds: float = 60.0
    """CPU seconds of ACT's training."""
    act: ActOptions = field(default_factory=ActOptions)
    """ACT's own options."""
    validation: int = 10
    """Runs, from seed 5000 on, that choose how many actions ACT takes at a look, all or one."""
    seed: int = 40000
    """Seed of the first run; the others follow it."""
    episodes: int = 100
    """Runs."""
    workers: int = 2
    """Processes that share the runs, one thread each."""

    def __post_init__(self) -> None:
        if self.task not in (*TASKS, *HIDDEN):
            raise ValueError(f"task is {self.task!r}: choose from {', '.join((*TASKS, *HIDDEN))}")
        if self.planner not in PLANNERS:
            raise ValueError(f"planner is {self.planner!r}: choose from {', '.join(PLANNERS)}")
        needed = {"policy": "policy", "expert": None}.get(self.planner, "dataset")
        if needed is not None and getattr(self, needed) is None:
            raise ValueError(f"planner={self.planner} needs --{needed}")
        for name in ("validation", "episodes", "workers"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} is {getattr(self, name)}: give 1 or more")
        if not 0 < self.seconds < float("inf"):
            raise ValueError(f"seconds is {self.seconds}: give more than 0")


@dataclass(frozen=True)
class Source:
    """Where a planner comes from, small enough to send to another process.

    Attributes:
        planner: one of `PLANNERS`.
        folder: of what was fitted; None for the expert.
        action_steps: actions that ACT takes at a look.
    """

    planner: str
    folder: Path | None = None
    action_steps: int = 1

    def load(self, world: str) -> Planner:
        """A new planner for the world of this id."""
        if self.folder is None:
            return expert_of(world)
        if self.planner == "policy":
            return MacroPolicy.load(self.folder).planner()
        if self.planner == "act":
            return StateActPlanner(self.folder, self.action_steps)
        return Peer.load(self.folder)


class Timed:
    """A planner whose actions are timed.

    Attributes:
        policy: the planner's, where it is dpmacro's.
        milliseconds: of every action since the last reset.
    """

    def __init__(self, planner: Planner) -> None:
        self._planner, self.milliseconds = planner, list[float]()
        policy = getattr(planner, "policy", None)  # ACT's is another
        self.policy = policy if isinstance(policy, MacroPolicy) else None

    @property
    def macro(self) -> int:
        """The planner's macro-action, -1 where it has none."""
        return int(getattr(self._planner, "macro", -1))

    def reset(self, env: gym.Env) -> None:
        """Begin an episode."""
        self.milliseconds.clear()
        self._planner.reset(env)

    def act(self, observation: dict[str, Any], info: dict[str, Any]) -> Any:
        """The planner's action."""
        start = time.perf_counter()
        action = self._planner.act(observation, info)
        self.milliseconds.append(1e3 * (time.perf_counter() - start))
        return action


def world_of(task: str) -> str:
    """The id of a task's world."""
    return task if task in HIDDEN else FAMILY + task


def main(options: RunOptions) -> None:
    """Fit, run, write the result."""
    source, found = fitted(options)
    name, seeds = f"{options.planner} in {options.task}", range(options.seed, options.seed + options.episodes)
    runs = list(tqdm(run_all(source, options.task, seeds, options.workers), name, len(seeds), unit="run"))
    took = np.concatenate([milliseconds for _, _, milliseconds in runs])
    result = {
        **found,
        "task": options.task,
        "planner": options.planner,
        "seeds": list(seeds),
        "outcomes": [outcome for outcome, _, _ in runs],
        "per_episode": [outcome == SUCCESS for outcome, _, _ in runs],
        "macros": [macros for _, macros, _ in runs],
        "milliseconds": {"mean": float(took.mean()), "p95": float(np.percentile(took, 95))},
    }
    options.output_dir.mkdir(parents=True, exist_ok=True)
    with replacing(options.output_dir / RESULT) as path:
        path.write_text(json.dumps(result) + "\n")
    print(f"{name}: {sum(result['per_episode'])} of {len(seeds)} succeed")


def fitted(options: RunOptions) -> tuple[Source, dict[str, Any]]:
    """The planner, and what is known of its training."""
    if options.planner == "expert":
        return Source("expert"), {}
    if options.planner == "policy":
        assert options.policy is not None, "checked"
        stored = load_file(options.policy / "model.safetensors")
        config = MacroPolicy.load(options.policy).config
        numbers = sum(tensor.numel() for tensor in stored.values())
        return Source("policy", options.policy), {"numbers": numbers, "macro_actions": config.macros}
    assert options.dataset is not None, "checked"
    demonstrations, folder = Demonstrations.load(options.dataset), options.output_dir / "fitted"
    started = time.process_time()
    if options.planner == "act":
        return _act(options, demonstrations, folder, started)
    peer = Peer.fit(options.planner, demonstrations, options.train_seed)
    seconds = time.process_time() - started
    peer.save(folder)
    return Source(options.planner, folder), {"training_seconds": seconds, "numbers": peer.numbers}


def _act(
    options: RunOptions, demonstrations: Demonstrations, folder: Path, started: float
) -> tuple[Source, dict[str, Any]]:
    """Train ACT, and choose by validation runs how many actions it takes at a look."""
    hand = 3 if options.task in HIDDEN else 4  # of the state's numbers: where it is, and how far open
    chunks = StateChunks(demonstrations, options.act.chunk_size, hand)
    budget = started, options.seconds, None, chunks, time.process_time
    train(demonstrations, options.act, *budget).save(folder)
    facts, successes = facts_of(folder), {}
    seeds = range(VALIDATION_SEED, VALIDATION_SEED + options.validation)
    for steps in sorted({options.act.chunk_size, 1}, reverse=True):
        runs = run_all(Source("act", folder, steps), options.task, seeds, options.workers)
        successes[steps] = sum(outcome == SUCCESS for outcome, _, _ in runs)
    best = max(successes, key=lambda steps: successes[steps])  # the first of equals is LeRobot's default
    told = {name: facts[name] for name in ("steps", "agreement")}
    return Source("act", folder, best), {
        "training_seconds": facts["seconds"],
        "numbers": facts["parameters"],
        "act": told | {"action_steps": best, "validation": successes},
    }


Run = tuple[str, list[int], np.ndarray]  # how it ended, macro-actions by step, milliseconds by step


def run_all(source: Source, task: str, seeds: Sequence[int], workers: int) -> list[Run]:
    """A run for every seed."""
    with closing(spread(partial(_run, source, task), seeds, min(workers, len(seeds)))) as runs:
        return list(runs)


@cache
def _stage(source: Source, task: str) -> Stage:
    world = world_of(task)
    return Stage(Timed(source.load(world)), {"id": world})


def _run(source: Source, task: str, seed: int) -> Run:
    stage = _stage(source, task)
    moments: list[Moment] = []
    with one_thread(), torch.inference_mode():
        for moment in stage.moments(seed):
            moments.append(moment)
            if stopped():
                break
    macros = [moment.macro for moment in moments]
    assert isinstance(stage.planner, Timed), "made above"
    return moments[-1].outcome, macros, np.array(stage.planner.milliseconds)


if __name__ == "__main__":
    cli.run(main, RunOptions)
