"""Boosting on several ranks: seconds, bytes and memory of each, whether they agree, and a model of the cost.

    python benchmarks/ranks.py --frames=100000 --columns=2000
    python benchmarks/ranks.py --frames=1000000 --columns=2000 --outputs=7 --layouts='["1x2"]'

Every layout, `ranks x threads of each`, is started by torchrun on levels drawn at random. The model takes a
round of one rank apart: the search, which ranks divide, and what all do alike.
"""

import hashlib
import json
import os
import resource
import shlex
import subprocess
import sys
import time
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import torch
from report import header, markdown

from dpmacro.boosting.learners.stumps import StumpLearner
from dpmacro.boosting.loop import Boosting
from dpmacro.boosting.losses.vectors import HuberLoss
from dpmacro.features.levels import SortedLevels
from dpmacro.parallel import Ranks, Shares, joined
from dpmacro.utils import cli

GIB, KIB = 2**30, 2**10
NETWORK = 125e6  # bytes a second, of the machines that the model speaks of: a gigabit a second
FAR = (10_000_000, 8)  # frames and machines that it is asked about
WORKER = "DPMACRO_RANKS_WORKER"
HEADINGS = ("ranks x threads", "s a round", "search", "rest", "model", "kB a round", "GiB a rank", "policy")


@dataclass(frozen=True)
class RanksOptions:
    """The data, and who boosts it."""

    frames: int = 100_000
    """Frames, whose levels and vectors are drawn at random."""
    columns: int = 2_000
    """Feature columns."""
    outputs: int = 7
    """Dimensions of the vectors."""
    problems: int = 3
    """Macro-actions."""
    rounds: int = 5
    """Boosting rounds that are timed, after a first one."""
    layouts: list[str] = field(default_factory=lambda: ["1x2", "1x1", "2x1", "4x1"])
    """Ranks x threads of each."""

    def __post_init__(self) -> None:
        for name in ("frames", "columns", "outputs", "problems", "rounds"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} is {getattr(self, name)}: give 1 or more")
        for layout in self.layouts:
            if not all(part.isdigit() and int(part) for part in layout.split("x")) or layout.count("x") != 1:
                raise ValueError(f"layouts has {layout!r}: write ranks x threads, like 2x1")


class CountingRanks(Ranks):
    """Ranks that count the bytes which this one sends, as in a ring."""

    sent = 0

    def gathered(self, own: torch.Tensor) -> torch.Tensor:
        """As of all ranks."""
        CountingRanks.sent += (self.size - 1) * own.nbytes
        return super().gathered(own)

    def summed(self, own: torch.Tensor) -> torch.Tensor:
        """As of all ranks."""
        CountingRanks.sent += 2 * (self.size - 1) * own.nbytes // self.size
        return super().summed(own)


class TimedLearner(StumpLearner):
    """Stumps whose search is timed."""

    searched = 0.0

    def fit(self, *given: Any, **options: Any) -> Any:
        """As of stumps."""
        started = time.perf_counter()
        found = super().fit(*given, **options)
        TimedLearner.searched += time.perf_counter() - started
        return found


def work(options: RanksOptions) -> None:
    """What a rank does; the leading one prints a line of JSON."""
    with joined() as own:
        ranks = CountingRanks(own.rank, own.size)
        shares = Shares(options.columns, ranks)
        levels = torch.empty(len(shares.own), options.frames, dtype=torch.uint8)
        for place, column in enumerate(shares.own.tolist()):
            generator = torch.Generator().manual_seed(column)
            torch.randint(
                0, 256, (options.frames,), dtype=torch.uint8, generator=generator, out=levels[place]
            )
        data = SortedLevels.build(levels, shares=shares)
        generator = torch.Generator().manual_seed(options.columns)
        targets = torch.randn(options.frames, 1, options.outputs, generator=generator)
        macro = torch.randint(0, options.problems, (options.frames,), generator=generator)
        held = torch.nn.functional.one_hot(macro, options.problems).float()
        loss = HuberLoss(options.outputs)
        boosting = Boosting(TimedLearner(data), targets, options.problems, 0.3, generator, loss=loss)
        boosting.round(held)
        CountingRanks.sent, TimedLearner.searched = 0, 0.0
        started = time.perf_counter()
        for _ in range(options.rounds):
            boosting.round(held)
        seconds, sent = time.perf_counter() - started, CountingRanks.sent
        digest = hashlib.sha256()
        for tensor in boosting.strong().tensors().values():
            digest.update(tensor.numpy().tobytes())
        peak = torch.tensor([resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * KIB / GIB])
        peaks = ranks.gathered(peak).flatten().tolist()
        if ranks.leads:
            found = {
                "seconds": seconds / options.rounds,
                "search": TimedLearner.searched / options.rounds,
                "bytes": sent / options.rounds,
                "gib": max(peaks),
                "policy": digest.hexdigest()[:12],
            }
            print(json.dumps(found), flush=True)


def measured(options: RanksOptions, layout: str) -> dict[str, Any]:
    """What the leading rank of a layout has printed. Raises ValueError where it ends in an error."""
    ranks, threads = layout.split("x")
    command = [sys.executable, "-m", "torch.distributed.run", "--standalone", f"--nproc_per_node={ranks}"]
    environment = os.environ | {"OMP_NUM_THREADS": threads, WORKER: json.dumps(asdict(options))}
    done = subprocess.run(
        [*command, __file__], capture_output=True, text=True, env=environment, cwd=Path(__file__).parents[1]
    )
    lines = [line for line in done.stdout.splitlines() if line.startswith("{")]
    if done.returncode or not lines:
        said = done.stderr.strip().splitlines()
        raise ValueError(f"{layout} ended with {done.returncode}: {said[-1] if said else 'nothing said'}")
    return dict(json.loads(lines[-1]))


def modelled(one: dict[str, Any], ranks: int, threads: int, cores: int) -> float:
    """Seconds of a round by the cost of one rank with one thread.

    Ranks divide the search; the rest all do alike. On fewer cores than processes they take turns.
    """
    turns = max(ranks * threads / cores, 1.0)
    search, rest = one["search"], one["seconds"] - one["search"]
    return (search / (ranks * threads) + rest / threads) * turns


def main(options: RanksOptions) -> None:
    """Measure every layout, and say what the model makes of them and of many frames on many machines."""
    print("\n".join(header(shlex.join(["python", *sys.orig_argv[1:]]))), flush=True)
    found = {}
    for layout in options.layouts:
        found[layout] = measured(options, layout)
        print(f"{layout}: {json.dumps(found[layout])}", file=sys.stderr, flush=True)
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    one, lines = found.get("1x1"), []
    for layout, own in found.items():
        ranks, threads = (int(part) for part in layout.split("x"))
        model = "" if one is None else f"{modelled(one, ranks, threads, cores):.3f}"
        rest = own["seconds"] - own["search"]
        times = [f"{own[name]:.3f}" for name in ("seconds", "search")]
        tail = [f"{own['bytes'] / 1000:.0f}", f"{own['gib']:.2f}", own["policy"]]
        lines.append([layout, *times, f"{rest:.3f}", model, *tail])
    print("\n".join(markdown(HEADINGS, lines)))
    if one is not None:
        frames, machines = FAR
        scale = frames / options.frames
        told = scale * max(own["bytes"] for own in found.values())
        work_ = modelled(one, machines, 1, machines) * scale
        held = scale * options.columns * options.frames * 5 / machines / GIB
        print(
            f"model: {frames:,} frames x {options.columns:,} columns on {machines} machines, a thread each: "
            f"{work_:.1f} s of work and {told / NETWORK:.2f} s to tell {told / 1e6:.1f} MB by a gigabit a "
            f"second, a round; {held:.1f} GiB of columns each"
        )


if __name__ == "__main__":
    if WORKER in os.environ:
        cli.run(lambda _: work(RanksOptions(**json.loads(os.environ[WORKER]))), RanksOptions)
    else:
        cli.run(main, RanksOptions)
