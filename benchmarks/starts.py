"""How often do starts of vectors lead to the best known loss? Every kind of them, and the whole search.

python benchmarks/starts.py --sources='[tabletop, cr5]' --seeds='[0, 1]'
"""

import json
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pandas as pd
import torch
from tabletop import tabletop
from torch import Tensor

from dpmacro.boosting.losses.vectors import HuberLoss
from dpmacro.discovery.race import boosted_in_turn, raced
from dpmacro.discovery.search import VECTOR_SHRINKAGE, discover
from dpmacro.discovery.settings import SearchSettings
from dpmacro.discovery.starts import (
    KINDS,
    Moments,
    evidence_of,
    linear_alternation,
    vector_starts,
)
from dpmacro.discovery.task import Task
from dpmacro.estimator.arguments import Standardiser
from dpmacro.features.levels import SortedLevels
from dpmacro.features.quantising import Quantiser
from dpmacro.metrics import segmentation_scores
from dpmacro.segmentation.segments import transition_counts
from dpmacro.utils import cli

NOTES = """\
Loss: of the alternation's last round, from the same columns for every start of a seed. Reached: share of the
starts that end within 1% of the least loss of the seed. Accuracy, boundary F1: of the start that ends lowest.
linear: the starts after the linear alternation. search: what the whole search found, its survivors alone."""
CLOSE = 1.01
CASES = {  # macro-actions, transitions, tolerance in frames
    "tabletop": [(4, 3, 10)],
    "tabletop_phases": [(8, 7, 10)],
    "cr5": [(3, 2, 5)],
    "mocap6": [(8, 6, 10), (12, 7, 10)],
}


@dataclass(frozen=True)
class StartOptions:
    """What to measure."""

    sources: list[str] = field(default_factory=lambda: list(CASES))
    """Data to cut, out of tabletop, tabletop_phases, cr5 and mocap6; or folders of Meta-World's."""
    seeds: list[int] = field(default_factory=lambda: [0, 1, 2, 3, 4])
    """Seeds of all draws, and of the made scene."""
    starts: int = 6
    """Starts of every kind."""
    restarts: int = 32
    """Restarts of the whole search."""
    kinds: bool = True
    """Whether every kind of start is measured, or the search alone."""
    choose: bool = False
    """Whether left-out data chooses, too; takes minutes."""
    data: Path = Path("../shared/data")
    """Folder of cr5_banana and mocap6."""

    def __post_init__(self) -> None:
        for value in self.sources:
            if value not in CASES and not Path(value).exists():
                raise ValueError(f"sources has {value!r}: choose from {', '.join(CASES)}, or give a folder")
        if self.starts < 1:
            raise ValueError(f"starts is {self.starts}: give 1 or more")


@dataclass(frozen=True)
class Case:
    """Data with its truth, and what to find in it."""

    name: str
    data: SortedLevels
    task: Task
    truth: np.ndarray
    tolerance: int

    def scores(self, labels: Tensor) -> str:
        found = segmentation_scores(labels.numpy(), self.truth, self.task.lengths.numpy(), self.tolerance)
        return f"{found.accuracy:8.3f} {found.boundary_f1:8.3f}"


def main(options: StartOptions) -> None:
    """Print a row for every source, seed and kind of starts."""
    print(
        f"{'source':24s} {'seed':>4s} {'starts':16s} {'n':>3s} {'least':>8s} {'reached':>8s} "
        f"{'accuracy':>8s} {'F1':>8s} {'seconds':>8s}"
    )
    for source in options.sources:
        for seed in options.seeds:
            for case in cases(source, seed, options.data):
                for row in rows(case, options):
                    print(row, flush=True)
    print(NOTES)


def rows(case: Case, options: StartOptions) -> Iterator[str]:
    """Every kind of starts, what the linear alternation makes of each, the truth, the search."""
    task, settings = case.task, SearchSettings()
    groups: dict[str, Tensor] = {}
    if options.kinds:
        generator = torch.Generator().manual_seed(task.seed)
        evidence = evidence_of(case.data, task, generator)
        moments = Moments(evidence)
        count = options.starts * len(KINDS)
        groups = vector_starts(case.data, evidence, moments, count, generator, dict.fromkeys(KINDS, 1))
        groups |= {
            f"linear {name}": linear_alternation(evidence, own, moments).labels
            for name, own in groups.items()
        }
    if int(case.truth.max()) < task.macros:
        groups["truth"] = torch.from_numpy(case.truth)[None]
    ended, seconds = {}, {}
    for name, own in groups.items():
        clock = time.process_time()
        ended[name] = boosted_in_turn(case.data, task, own, settings, VECTOR_SHRINKAGE)
        seconds[name] = time.process_time() - clock
    clock = time.process_time()
    survivors = raced(case.data, task, options.restarts)
    ended["search"] = boosted_in_turn(case.data, task, survivors, settings, VECTOR_SHRINKAGE)
    seconds["search"] = time.process_time() - clock
    best = min(float(one.loss[-1].min()) for one in ended.values())
    for name, one in ended.items():
        loss = one.loss[-1]
        reached = float((loss <= CLOSE * best).float().mean())
        scores = case.scores(one.labels[loss.argmin()])
        yield (
            f"{case.name:24s} {task.seed:4d} {name:16s} {len(loss):3d} {float(loss.min()):8.4f} "
            f"{reached:8.2f} {scores} {seconds[name]:8.1f}"
        )
    if options.choose:
        clock = time.process_time()
        found = discover(case.data, task, settings, options.restarts, VECTOR_SHRINKAGE)
        yield (
            f"{case.name:24s} {task.seed:4d} {'chosen':16s} {len(found.candidates):3d} {'':8s} {'':8s} "
            f"{case.scores(found.kept.labels)} {time.process_time() - clock:8.1f}"
        )


def cases(source: str, seed: int, folder: Path) -> Iterator[Case]:
    """A source with every Q and S that it is cut into."""
    if source.startswith("tabletop"):
        made = tabletop(seed=seed)
        truth = made.truth if source == "tabletop" else 2 * made.truth + made.phase
        found = made.features, made.actions, made.lengths, truth
    elif source == "cr5":
        found = _cr5(folder / "cr5_banana")
    elif source == "mocap6":
        found = _mocap(folder / "mocap6")
    else:
        state, action, sizes, table = _table(Path(source))
        stage = np.unique(table["stage"].to_numpy(), return_inverse=True)[1]
        found = _with_moves(state, sizes), action, sizes, stage
    features, actions, lengths, truth = found
    values = torch.from_numpy(np.ascontiguousarray(features.T, np.float32))
    data = SortedLevels.build(Quantiser.fit(values).levels(values))
    vectors = torch.from_numpy(actions)
    vectors = Standardiser.fit(vectors).apply(vectors)
    loss = HuberLoss(vectors.shape[1])
    changes = int(transition_counts(torch.from_numpy(truth), torch.from_numpy(lengths)).max())
    for macros, bound, tolerance in CASES.get(source, [(int(truth.max()) + 1, changes, 5)]):
        task = Task(vectors, torch.from_numpy(lengths), torch.arange(len(lengths)), loss, macros, bound, seed)
        name = f"{Path(source).stem} Q={macros} S={bound}"
        yield Case(name, data, task, truth, tolerance)


def _cr5(folder: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """State and moves; the velocities; open and closed as truth, the gripper's command being hidden."""
    state, action, lengths, _ = _table(folder)
    low, high = np.quantile(action[:, 6], (0.05, 0.95))
    closed = (action[:, 6] > (low + high) / 2).astype(np.int64)
    ends = np.cumsum(lengths)
    turned = np.diff(closed, prepend=closed[:1]) != 0
    turned[ends - lengths] = False
    before = np.cumsum(turned)
    truth = (before - np.repeat(before[ends - lengths], lengths)).clip(max=2)
    return _with_moves(state, lengths), action[:, :6].copy(), lengths, truth


def _mocap(folder: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    state, action, lengths, table = _table(folder)
    truth = np.unique(table["exercise"].to_numpy(), return_inverse=True)[1]
    return _with_moves(state, lengths), action, lengths, truth


def _table(folder: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray, pd.DataFrame]:
    """State, action, lengths and all columns of a LeRobot dataset's data files."""
    files = sorted(folder.glob("data/*/*.parquet"))
    if not files:
        raise ValueError(f"{folder} holds no data/*/*.parquet: give the folder of the datasets as --data")
    keys = json.loads((folder / "meta/info.json").read_text())["features"]
    table = pd.concat([pd.read_parquet(file) for file in files])
    state = "observation.state" if "observation.state" in keys else "state"
    vectors = (np.stack(table[key].to_numpy()).astype(np.float32) for key in (state, "action"))
    episodes = table["episode_index"].to_numpy().ravel()
    lengths = np.unique(episodes, return_counts=True)[1].astype(np.int64)
    return *vectors, lengths, table


def _with_moves(state: np.ndarray, lengths: np.ndarray) -> np.ndarray:
    """State and its change over the last frame, 0 at a trajectory's first."""
    moves = np.diff(state, axis=0, prepend=state[:1])
    moves[np.cumsum(lengths) - lengths] = 0
    return np.concatenate([state, moves], 1)


if __name__ == "__main__":
    cli.run(main, StartOptions)
