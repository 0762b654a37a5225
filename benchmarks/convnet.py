"""Convnets beside stumps as weak learners: accuracy and recall on left-out trajectories, and seconds.

    python benchmarks/convnet.py --dataset=datasets/two_flags_random

Classifiers are fitted with the true phase as macro-labels, which the dataset must hold, so that the learners
are compared and not the segmentations they lead to. The last quarter of the trajectories is left out. The
share of changes that the switch functions detect is cross-validated over all trajectories.
"""

import time
from dataclasses import dataclass
from pathlib import Path

import torch

from dpmacro import cli
from dpmacro.boosting import Boosting, class_targets
from dpmacro.columns import Plan, prepare
from dpmacro.demonstrations import Demonstrations
from dpmacro.features import frames_before, make_features
from dpmacro.learners import WeakLearner
from dpmacro.learners.convnet import ConvNetLearner
from dpmacro.learners.ensemble import InTurn
from dpmacro.learners.stumps import StumpLearner
from dpmacro.switching import fit_switches

LEFT_OUT = 4  # one of so many trajectories


@dataclass(frozen=True)
class ConvNetOptions:
    """Which data, and how long to boost."""

    dataset: Path
    """Folder of a LeRobot dataset with true phases."""
    stumps: int = 300
    """Rounds of stumps alone, at shrinkage 0.1."""
    convnets: int = 8
    """Rounds of convnets alone, at shrinkage 0.5."""
    first: int = 200
    """Rounds of stumps before the convnets of a mixed ensemble, at shrinkage 0.1."""
    then: int = 10
    """Rounds of convnets in it."""
    switch_stumps: int = 60
    """Rounds of stumps of a switch function, at shrinkage 0.2."""
    switch_convnets: int = 6
    """Rounds of convnets of a switch function, at shrinkage 0.5."""
    seed: int = 0
    """Seed of every draw."""


def main(options: ConvNetOptions) -> None:
    demonstrations = Demonstrations.load(options.dataset)
    if demonstrations.truth is None:
        raise ValueError(f"dataset {options.dataset} holds no truth: record one with datasets/record.py")
    images, lengths = torch.from_numpy(demonstrations.images), torch.from_numpy(demonstrations.lengths)
    generator = torch.Generator().manual_seed(options.seed)
    features = make_features("rectangles", *images.shape[1:3], 4096, generator)
    _, _, data = prepare(images, lengths, features, Plan(4096, 0, 0.0), generator)
    stumps = StumpLearner(data, drawn=512)
    convnets = ConvNetLearner(images, frames_before(lengths))
    print(f"{torch.get_num_threads()} threads, {len(images)} frames")
    print(
        f"{'classifiers':<22} {'seconds':>7} {'trained':>8} {'left out':>8}   recall of each action, left out"
    )
    for name, learner, rounds, shrinkage in (
        (f"{options.stumps} stumps", stumps, options.stumps, 0.1),
        (f"{options.convnets} convnets", convnets, options.convnets, 0.5),
        (
            f"{options.first} stumps, {options.then} convnets",
            InTurn(stumps, options.first, convnets),
            options.first + options.then,
            0.1,
        ),
    ):
        print(
            f"{name:<22} {actions_row(learner, demonstrations, rounds, shrinkage, options.seed)}", flush=True
        )
    print(f"{'switch functions':<22} {'seconds':>7}   share of changes detected")
    for name, learner, rounds, shrinkage in (
        (f"{options.switch_stumps} stumps", stumps, options.switch_stumps, 0.2),
        (f"{options.switch_convnets} convnets", convnets, options.switch_convnets, 0.5),
    ):
        print(
            f"{name:<22} {switches_row(learner, demonstrations, rounds, shrinkage, options.seed)}", flush=True
        )


def actions_row(
    learner: WeakLearner, demonstrations: Demonstrations, rounds: int, shrinkage: float, seed: int
) -> str:
    """Seconds, accuracies and recalls of a classifier per phase."""
    lengths = torch.from_numpy(demonstrations.lengths)
    actions, phase = torch.from_numpy(demonstrations.actions), torch.from_numpy(demonstrations.truth)
    trained = (torch.arange(len(lengths)) < len(lengths) - len(lengths) // LEFT_OUT).repeat_interleave(
        lengths
    )
    base = torch.nn.functional.one_hot(phase).float() * trained[:, None]
    targets = class_targets(actions, len(demonstrations.action_names))
    start = time.perf_counter()
    boosting = Boosting(learner, targets, base.shape[1], shrinkage, torch.Generator().manual_seed(seed))
    for _ in range(rounds):
        boosting.round(base)
    seconds = time.perf_counter() - start
    right = boosting.scores[torch.arange(len(phase)), phase].argmax(1) == actions
    recalls = "  ".join(
        f"{name} {float(right[~trained & (actions == number)].float().mean()):.3f}"
        for number, name in enumerate(demonstrations.action_names)
    )
    accuracies = [float(right[part].float().mean()) for part in (trained, ~trained)]
    return f"{seconds:>7.1f} {accuracies[0]:>8.4f} {accuracies[1]:>8.4f}   {recalls}"


def switches_row(
    learner: WeakLearner, demonstrations: Demonstrations, rounds: int, shrinkage: float, seed: int
) -> str:
    """Seconds, and the detected share of every pair of phases."""
    lengths, phase = torch.from_numpy(demonstrations.lengths), torch.from_numpy(demonstrations.truth)
    start = time.perf_counter()
    generator = torch.Generator().manual_seed(seed)
    switches = fit_switches(learner, phase, lengths, generator, rounds=rounds, shrinkage=shrinkage)
    shares = "  ".join(
        f"{source} to {target}: {share:.2f}"
        for (source, target), share in zip(switches.pairs, switches.detected.tolist(), strict=True)
    )
    return f"{time.perf_counter() - start:>7.1f}   {shares}"


if __name__ == "__main__":
    cli.run(main, ConvNetOptions)
