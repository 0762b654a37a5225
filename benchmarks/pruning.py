"""What pruning with a guarantee would save, and what dropping light frames would.

    python benchmarks/pruning.py --dataset=datasets/two_flags_random

Appel et al. (Quickly Boosting Decision Trees, ICML 2013) look at the heaviest frames first: Z of a part of
the frames is a lower bound of Z of all (sqrt(ab) + sqrt(cd) <= sqrt((a + c)(b + d))), so a column whose Z on
the heavy frames exceeds the best Z of another column cannot win. At several rounds of a baseline this prints
how many frames hold a share of the weight, and how many columns they would prune if the best one were known
from the start, which is the most that pruning can do.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor

from dpmacro.boosting.learners.stumps import StumpLearner
from dpmacro.boosting.learners.sweep import sweep
from dpmacro.boosting.loop import Boosting
from dpmacro.boosting.losses.classes import class_targets, exponentials_of
from dpmacro.data.demonstrations import Demonstrations
from dpmacro.features.columns import prepare
from dpmacro.features.kinds import make_features
from dpmacro.features.levels import SortedLevels
from dpmacro.features.memory import Plan
from dpmacro.utils import cli

SHARES = (0.5, 0.9, 0.95, 0.99)
ROUNDS = (0, 10, 50, 150, 300)


@dataclass(frozen=True)
class PruningOptions:
    """Which data."""

    dataset: Path
    """Folder of a LeRobot dataset."""
    columns: int = 2048
    """Random columns to look at."""
    shrinkage: float = 0.1
    """Factor on every weak hypothesis."""


def main(options: PruningOptions) -> None:
    demonstrations = Demonstrations.load(options.dataset)
    images, lengths = torch.from_numpy(demonstrations.images), torch.from_numpy(demonstrations.lengths)
    actions = torch.from_numpy(demonstrations.actions).long()
    print(
        f"{'features':<11} {'round':>5} {'best Z':>7}   share of weight: frames that hold it, columns pruned"
    )
    for kind in ("pixels", "rectangles"):
        generator = torch.Generator().manual_seed(0)
        height, width = images.shape[1:3]
        features = make_features(kind, height, width, options.columns, generator)
        columns = min(options.columns, features.count)
        _, _, data = prepare(
            {"observation.image": images}, lengths, features, Plan(columns, features.count, 0, 0.0), generator
        )
        for number, line in rows(data, actions, options.shrinkage, generator):
            print(f"{kind:<11} {number:>5} {line}", flush=True)


def column_losses(data: SortedLevels, weights: Tensor, targets: Tensor) -> Tensor:
    """Z / 2 of the best stump in every column, [columns, problems]."""
    return torch.cat([loss.amin(1) for _, _, loss in sweep(data, weights, targets)])


def rows(
    data: SortedLevels, actions: Tensor, shrinkage: float, generator: torch.Generator
) -> Iterator[tuple[int, str]]:
    """A line of the table for each of `ROUNDS`."""
    targets = class_targets(actions, int(actions.max()) + 1)
    boosting = Boosting(StumpLearner(data, drawn=256), targets, 1, shrinkage, generator)
    for number in range(max(ROUNDS) + 1):
        if number in ROUNDS:
            weights = exponentials_of(boosting.scores, targets)
            losses = column_losses(data, weights, targets)
            order = weights.sum((1, 2)).argsort(descending=True)
            held = weights.sum((1, 2))[order].cumsum(0) / weights.sum()
            parts = []
            for share in SHARES:
                heavy = order[: int((held < share).sum()) + 1]
                part = torch.zeros_like(weights)
                part[heavy] = weights[heavy]
                pruned = (column_losses(data, part, targets) >= losses.min()).float().mean()
                parts.append(f"{share:.0%}: {len(heavy) / len(order):.0%}, {float(pruned):.0%}")
            yield number, f"{float(losses.min() / weights.sum() * 2):>7.4f}   " + "   ".join(parts)
        boosting.round(torch.ones(data.n_frames, 1))


if __name__ == "__main__":
    cli.run(main, PruningOptions)
