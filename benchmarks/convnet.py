"""Convnets beside stumps as weak learners, boosted for the same time: accuracy on left-out trajectories.

    python benchmarks/convnet.py --dataset=datasets/two_flags_random

Classifiers are fitted with the true phase as macro-labels, which the dataset must hold, so that the learners
are compared and not the segmentations they lead to. The last quarter of the trajectories is left out. Switch
functions have rounds in place of seconds, cues, and no mirror images; the share of changes that they detect
is cross-validated over all trajectories.
"""

import itertools
import time
from dataclasses import dataclass, field
from pathlib import Path

import torch

from dpmacro.boosting.learners.base import WeakLearner
from dpmacro.boosting.learners.convnet import ConvNetLearner
from dpmacro.boosting.learners.stumps import StumpLearner
from dpmacro.boosting.loop import Boosting
from dpmacro.boosting.losses.classes import class_targets
from dpmacro.data.demonstrations import Demonstrations
from dpmacro.features.base import frames_before
from dpmacro.features.columns import prepare
from dpmacro.features.kinds import make_features
from dpmacro.features.memory import Plan
from dpmacro.switching.settings import SwitchSettings
from dpmacro.switching.training import fit_switches
from dpmacro.utils import cli

LEFT_OUT = 4  # one of so many trajectories
REUSE = 5  # rounds that a search for stumps serves


@dataclass(frozen=True)
class ConvNetOptions:
    """Which data, and how long to boost."""

    dataset: Path
    """Folder of a LeRobot dataset with true phases."""
    demonstrations: list[int] | None = None
    """Episodes of the dataset to learn from, like '[0,1,2]'; by default all."""
    seconds: list[float] = field(default_factory=lambda: [15.0, 60.0])
    """How long each learner boosts; every one begins anew."""
    switch_stumps: int = 400
    """Rounds of stumps of a switch function, at shrinkage 0.2."""
    switch_convnets: int = 6
    """Rounds of convnets of a switch function, at shrinkage 0.5."""
    seed: int = 0
    """Seed of every draw."""

    def __post_init__(self) -> None:
        if not self.seconds or not all(0 < value < float("inf") for value in self.seconds):
            raise ValueError(f"seconds is {self.seconds}: give one or more numbers above 0")
        for name in ("switch_stumps", "switch_convnets"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} is {getattr(self, name)}: give 1 or more")


def main(options: ConvNetOptions) -> None:
    demonstrations = Demonstrations.load(options.dataset, options.demonstrations)
    if demonstrations.truth is None:
        raise ValueError(f"dataset {options.dataset} holds no truth: record one with datasets/record.py")
    if len(demonstrations.lengths) < LEFT_OUT:
        raise ValueError(
            f"dataset {options.dataset} gives {len(demonstrations.lengths)} demonstrations: "
            f"give {LEFT_OUT} or more, one in {LEFT_OUT} is left out"
        )
    images, lengths = torch.from_numpy(demonstrations.images), torch.from_numpy(demonstrations.lengths)
    generator = torch.Generator().manual_seed(options.seed)
    height, width = images.shape[1:3]
    features = make_features("rectangles", height, width, 4096, generator)
    plan = Plan(features.count, features.count, 0, 0.0)
    _, _, data = prepare({"observation.image": images}, lengths, features, plan, generator)
    stumps, convnets = StumpLearner(data, reuse=REUSE), ConvNetLearner(images, frames_before(lengths))
    print(f"{torch.get_num_threads()} threads, {len(images)} frames")
    print(
        f"{'classifiers':<14} {'seconds':>7} {'rounds':>6} {'trained':>8} {'left out':>8}   recall, left out"
    )
    learners: dict[str, tuple[WeakLearner, float]] = {
        "stumps": (stumps, 0.1),
        "convnets": (convnets, 0.5),
    }
    for seconds, (name, (learner, shrinkage)) in itertools.product(options.seconds, learners.items()):
        row = actions_row(learner, demonstrations, seconds, shrinkage, options.seed)
        print(f"{name:<14} {row}", flush=True)
    print(f"{'switch functions':<22} {'seconds':>7}   share of changes detected")
    quick = StumpLearner(data, drawn=32)
    for name, learner, rounds, shrinkage in (
        (f"{options.switch_stumps} stumps", quick, options.switch_stumps, 0.2),
        (f"{options.switch_convnets} convnets", convnets, options.switch_convnets, 0.5),
    ):
        row = switches_row(learner, demonstrations, rounds, shrinkage, options.seed)
        print(f"{name:<22} {row}", flush=True)


def actions_row(
    learner: WeakLearner, demonstrations: Demonstrations, seconds: float, shrinkage: float, seed: int
) -> str:
    """Seconds, rounds, accuracies and recalls of a classifier per phase; the last round is finished."""
    lengths = torch.from_numpy(demonstrations.lengths)
    actions, phase = torch.from_numpy(demonstrations.actions), torch.from_numpy(demonstrations.truth)
    trained = (torch.arange(len(lengths)) < len(lengths) - len(lengths) // LEFT_OUT).repeat_interleave(
        lengths
    )
    base = torch.nn.functional.one_hot(phase).float() * trained[:, None]
    targets = class_targets(actions, len(demonstrations.action_names))
    start, rounds = time.perf_counter(), 0
    boosting = Boosting(learner, targets, base.shape[1], shrinkage, torch.Generator().manual_seed(seed))
    while (taken := time.perf_counter() - start) < seconds and not bool(boosting.ended.all()):
        boosting.round(base)
        rounds += 1
    right = boosting.scores[torch.arange(len(phase)), phase].argmax(1) == actions
    recalls = "  ".join(
        f"{name} {float(right[~trained & (actions == number)].float().mean()):.3f}"
        for number, name in enumerate(demonstrations.action_names)
    )
    accuracies = [float(right[part].float().mean()) for part in (trained, ~trained)]
    return f"{taken:>7.1f} {rounds:>6} {accuracies[0]:>8.4f} {accuracies[1]:>8.4f}   {recalls}"


def switches_row(
    learner: WeakLearner, demonstrations: Demonstrations, rounds: int, shrinkage: float, seed: int
) -> str:
    """Seconds, and the detected share of every pair of phases."""
    lengths, phase = torch.from_numpy(demonstrations.lengths), torch.from_numpy(demonstrations.truth)
    start = time.perf_counter()
    generator = torch.Generator().manual_seed(seed)
    settings = SwitchSettings(rounds=rounds, shrinkage=shrinkage)
    actions = torch.from_numpy(demonstrations.actions)
    [switches] = fit_switches(learner, phase[None], lengths, generator, settings, actions=actions)
    shares = "  ".join(
        f"{source} to {target}: {share:.2f}"
        for (source, target), share in zip(switches.pairs, switches.recognised.tolist(), strict=True)
    )
    return f"{time.perf_counter() - start:>7.1f}   {shares}"


if __name__ == "__main__":
    cli.run(main, ConvNetOptions)
