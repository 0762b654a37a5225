"""LeRobot's ACT, trained on the demonstrations that dpmacro learns from, then run in the same worlds.

python benchmarks/act_peer.py --dataset=datasets/two_flags_random --minutes=15 --workers=2 \
    --policy=outputs/demo/train/dpboost/checkpoints/last/pretrained_model
python benchmarks/act_peer.py --act=outputs/act/pretrained_model

Training ends when its minutes are over, reading included. How many of the predicted actions are taken before
ACT looks again, all of them or one, is chosen by successes in validation worlds afterwards; all of them where
both do equally well. `act_training.py` says what is not LeRobot's default.

Prints a line for every planner, and writes all of it to --output as JSON. Milliseconds per action are
measured three times: with one thread and with all while nothing else runs, on what a turn on the spot shows,
and during the runs, on one thread in each of --workers processes. The time of ACT's looks stands beside.
"""

import json
import shlex
import sys
import time
from collections import Counter
from contextlib import closing
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import torch
from act_runs import WARM_UP, Run, Source, observations, runs, summary, timed
from act_training import ActOptions, facts_of, train
from report import header
from safetensors.torch import load_file
from tqdm import tqdm

from dpmacro.data.demonstrations import Demonstrations
from dpmacro.metrics.success import wilson_interval
from dpmacro.policy.policy import MacroPolicy
from dpmacro.utils import cli
from dpmacro.utils.files import replacing
from dpmacro.worlds.base import SUCCESS
from dpmacro.worlds.two_flags.diagnosis import OUTCOMES

VALIDATION_SEED = 5000


@dataclass(frozen=True)
class PeerOptions:
    """What to train, and what to run."""

    dataset: Path = Path("datasets/two_flags_random")
    """The demonstrations, a LeRobot dataset."""
    demonstrations: list[int] | None = None
    """Episodes of the dataset to learn from, like '[0,1,2]'; by default all."""
    minutes: float = 15.0
    """Wall-clock time of the training."""
    steps: int | None = None
    """End the training after so many steps, if they come first."""
    train: ActOptions = field(default_factory=ActOptions)
    act: Path | None = None
    """Run this trained ACT instead of training one."""
    action_steps: int | None = None
    """Actions to take before looking again; by default what validation worlds prefer, all of them or one."""
    validation: int = 6
    """Validation worlds, from seed 5000 on."""
    policy: Path | None = None
    """A pretrained_model of train.py, to put beside ACT in the same worlds."""
    episodes: int = 100
    """Runs of each planner."""
    seed: int = 10000
    """Seed of the first run; the others follow it."""
    workers: int = 2
    """Processes that share the runs, one thread each."""
    timed: int = 200
    """Actions to time while nothing else runs."""
    output_dir: Path = Path("outputs/act")
    """Folder for the trained ACT, pretrained_model in it."""
    output: Path = Path("outputs/act.json")
    """Where the results go."""

    def __post_init__(self) -> None:
        for name in ("steps", "action_steps", "validation", "episodes", "seed", "workers", "timed"):
            value, least = getattr(self, name), int(name != "seed")
            if value is not None and value < least:
                raise ValueError(f"{name} is {value}: give {least} or more")
        if not 0 < self.minutes < float("inf"):
            raise ValueError(f"minutes is {self.minutes}: give more than 0")
        if self.act is None and (self.output_dir / "pretrained_model").exists():
            raise ValueError(
                f"{self.output_dir} already holds a pretrained_model: give another --output_dir, "
                f"or --act={self.output_dir / 'pretrained_model'} to run it"
            )
        if self.act is None and self.action_steps is not None and self.action_steps > self.train.chunk_size:
            raise ValueError(
                f"action_steps is {self.action_steps}: ACT predicts train.chunk_size={self.train.chunk_size}"
            )


def main(options: PeerOptions) -> None:
    if options.policy is not None:
        MacroPolicy.load(options.policy)  # a mistake shows before the training
    folder = trained(options) if options.act is None else options.act
    facts = facts_of(folder)
    world = facts["world"]
    steps, validation = choose(folder, facts, options)
    images = observations(world, VALIDATION_SEED, WARM_UP + options.timed)
    act = section(f"ACT, {steps} actions a look", Source(folder, steps), world, images, options)
    act["milliseconds"]["look, 1 thread"] = timed(Source(folder, 1), images, 1)
    sections = [act | {"action_steps": steps}]
    if options.policy is not None:
        sections.append(section("dpmacro", Source(options.policy), world, images, options))
    lines = header(shlex.join(["python", *sys.argv]))
    found = {
        "header": lines,
        "lerobot": version("lerobot"),
        "training": facts,
        "validation": validation,
        "seeds": [options.seed, options.seed + options.episodes - 1],
        "planners": sections,
    }
    with replacing(options.output) as temporary:
        temporary.write_text(json.dumps(found, indent=2) + "\n")
    print("\n".join([*lines, *training_lines(facts, validation), "", *table(sections)]))


def trained(options: PeerOptions) -> Path:
    """Train, save, and return the folder."""
    started = time.perf_counter()
    demonstrations = Demonstrations.load(options.dataset, options.demonstrations)
    if not demonstrations.world:
        raise ValueError(f"dataset {options.dataset} names no world to run in: use one that record.py wrote")
    folder = options.output_dir / "pretrained_model"
    train(demonstrations, options.train, started, 60 * options.minutes, options.steps).save(folder)
    return folder


def choose(folder: Path, facts: dict[str, Any], options: PeerOptions) -> tuple[int, dict[str, Any]]:
    """How many actions to take at a look, and the successes in validation worlds that say so."""
    chunk = facts["chunk_size"]
    if options.action_steps is not None:
        if options.action_steps > chunk:
            raise ValueError(f"action_steps is {options.action_steps}: {folder} predicts {chunk}, give fewer")
        return options.action_steps, {}
    seeds = range(VALIDATION_SEED, VALIDATION_SEED + options.validation)
    started = time.perf_counter()
    successes = {}
    for steps in sorted({chunk, 1}, reverse=True):
        name = f"validation, {steps} actions a look"
        done = run_all(name, Source(folder, steps), facts["world"], seeds, options.workers)
        successes[steps] = sum(run.outcome == SUCCESS for run in done)
    seconds = time.perf_counter() - started
    # The first of equals is LeRobot's own default, and the faster one.
    best = max(successes, key=lambda steps: successes[steps])
    return best, {"seeds": [seeds[0], seeds[-1]], "successes": successes, "seconds": seconds}


def section(
    name: str, source: Source, world: dict[str, Any], images: np.ndarray, options: PeerOptions
) -> dict[str, Any]:
    """Successes and their interval, how runs ended, milliseconds per action, numbers stored."""
    milliseconds = {
        f"{count} thread{'s' * (count > 1)}": timed(source, images, count)
        for count in sorted({1, torch.get_num_threads()})
    }
    started = time.perf_counter()
    seeds = range(options.seed, options.seed + options.episodes)
    done = run_all(name, source, world, seeds, options.workers)
    seconds = time.perf_counter() - started
    milliseconds["runs"] = summary(np.concatenate([run.milliseconds for run in done]))
    outcomes = Counter(run.outcome for run in done)
    weights = load_file(source.folder / "model.safetensors")
    return {
        "planner": name,
        "folder": str(source.folder),
        "successes": outcomes[SUCCESS],
        "n": len(done),
        "interval": wilson_interval(outcomes[SUCCESS], len(done)),
        "outcomes": {outcome: outcomes[outcome] for outcome in OUTCOMES},
        "runs": [run.outcome for run in done],
        "seconds": seconds,
        "workers": options.workers,
        "stored_numbers": sum(tensor.numel() for tensor in weights.values()),
        "milliseconds": milliseconds,
    }


def run_all(name: str, source: Source, world: dict[str, Any], seeds: range, workers: int) -> list[Run]:
    """All runs, under a bar."""
    with closing(runs(source, world, seeds, min(workers, len(seeds)))) as some:
        return list(tqdm(some, total=len(seeds), desc=name, unit="run"))


def training_lines(facts: dict[str, Any], validation: dict[str, Any]) -> list[str]:
    """How ACT was trained and how its actions a look were chosen."""
    frames = f"{facts['demonstrations']} demonstrations, {facts['frames']:,} frames"
    took = f"{facts['seconds']:.0f} s on {facts['threads']} threads, {facts['cpu_seconds']:.0f} s of CPU"
    lines = [
        f"training {frames} of {facts['dataset']}",
        f"         {took}: {facts['steps']} steps of {facts['batch_size']} frames",
        f"         chunks of {facts['chunk_size']} actions, {facts['parameters']:,} parameters",
        f"         mean error {facts['errors'][0]:.3f} at first, {facts['errors'][-1]:.3f} at last; the "
        f"first action is the teacher's on {facts['agreement']:.1%} of training frames",
    ]
    if validation:
        found = ", ".join(f"{count} with {steps} a look" for steps, count in validation["successes"].items())
        first, last = validation["seeds"]
        lines.append(f"         successes in worlds {first}..{last}: {found}; {validation['seconds']:.0f} s")
    return lines


def table(sections: list[dict[str, Any]]) -> list[str]:
    """A line for every planner, and one for each of its times."""
    lines = []
    for found in sections:
        low, high = found["interval"]
        split = ", ".join(
            f"{count} {outcome.replace('_', ' ')}"
            for outcome, count in found["outcomes"].items()
            if count and outcome != SUCCESS
        )
        lines.append(
            f"{found['planner']}: {found['successes']} of {found['n']} succeed, "
            f"{found['successes'] / found['n']:.0%} (95% {low:.0%} to {high:.0%}); {split}"
        )
        lines += [
            f"    {case:<15} {took['mean']:7.2f} ms an action, 95% within {took['p95']:.2f}"
            for case, took in found["milliseconds"].items()
        ]
    return lines


if __name__ == "__main__":
    cli.run(main, PeerOptions)
