"""Train a planner from demonstrations.

    python train.py --dataset.root=datasets/two_flags --planner.type=dpboost --planner.macros=2
    python train.py --dataset.root=datasets/two_flags --planner.type=baseline
    python train.py --dataset.root=datasets/two_flags --dataset.labels=corrections.json
    python train.py --dataset.root=datasets/two_flags --dagger.iterations=5
    python train.py --config_path=<run>/checkpoints/last/pretrained_model/train_config.json --resume=true
    torchrun --nproc_per_node=4 train.py --dataset.root=datasets/two_flags

Finds macro-actions, fits a strong classifier to each and switch functions between them, and saves a policy
for eval.py in `<output_dir>/checkpoints/last/pretrained_model`, pictures and TensorBoard events beside it.
With `--dataset.labels`, a file of corrections, the demonstrations in it keep their labels and the others are
cut anew.
With `--dagger.iterations` the planner then runs in its world, the world's teacher labels those runs with
actions, and training repeats with them; the planner that succeeds most in validation worlds is kept.
A run that was stopped goes on with `--resume=true`, and ends as if nothing had stopped it.
Processes that torchrun starts, on one machine or more, divide the feature columns and train the same policy.
"""

if __name__ in ("__main__", "__mp_main__"):
    import dpmacro.utils.starting  # noqa: F401  Ctrl-C during the imports below is one line

import math
import os
import sys
import time
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import torch
from tqdm import tqdm

from dpmacro.data.demonstrations import Demonstrations
from dpmacro.discovery.model_order import Choice
from dpmacro.metrics import boundary_counts, frame_accuracy
from dpmacro.metrics.success import wilson_interval
from dpmacro.parallel import Ranks, joined
from dpmacro.segmentation.segments import transition_counts
from dpmacro.training.data import read_demonstrations
from dpmacro.training.labels import labelled
from dpmacro.training.learners import check_divisible
from dpmacro.training.options import TrainOptions
from dpmacro.training.resuming import check_unchanged, kept_stages, path_of
from dpmacro.training.run_folder import RunFolder, plain_options
from dpmacro.training.trainer import Trainer, TrainingResult
from dpmacro.utils import cli, temporary
from dpmacro.utils.events import doing_without
from dpmacro.utils.files import telling_what_is_safe
from dpmacro.utils.hparams import write_row, write_scores

if TYPE_CHECKING:
    from dpmacro.training.dagger import Iteration

TOLERANCE = 10  # frames by which a found change point may miss a true one


def main(options: TrainOptions) -> None:
    with joined(options.device, temporary.remove_all) as ranks:
        if ranks.size > 1:
            check_divisible(options)
        if ranks.leads:
            lead(options, ranks)
        else:
            help_(options, ranks)


def lead(options: TrainOptions, ranks: Ranks) -> None:
    """The work of the rank that writes and prints, or of the only one."""
    path = path_of(options)
    with RunFolder.claimed(path, options.resume) as folder, telling_what_is_safe(folder.path, folder.saved):
        if options.resume and folder.over:
            print(f"{folder.path} is over: its policy is in {folder.last}")
            return
        if options.resume:
            check_unchanged(options, folder)
        train(options, folder, ranks)


def help_(options: TrainOptions, ranks: Ranks) -> None:
    """The work of another rank, which prints nothing: what it has to say is said by the one that leads."""
    with Path(os.devnull).open("w") as nowhere, redirect_stdout(nowhere), redirect_stderr(nowhere):
        folder, asked = RunFolder(path_of(options), resume=True), options
        demonstrations = read_demonstrations(options.dataset, options.planner.memory_limit, ranks)
        options, given = labelled(options, demonstrations)
        with kept_stages(folder, asked, demonstrations, given, ranks):
            Trainer(demonstrations, options, folder, given, ranks).help()


def train(options: TrainOptions, folder: RunFolder, ranks: Ranks) -> None:
    """Train, print what was found, and write it down."""
    asked = options
    demonstrations = read_demonstrations(options.dataset, options.planner.memory_limit, ranks)
    options, given = labelled(options, demonstrations)
    started = time.perf_counter()
    try:
        with kept_stages(folder, asked, demonstrations, given, ranks):
            result = trained(demonstrations, options, folder, given, ranks)
    except KeyboardInterrupt:
        print(folder.saved(), file=sys.stderr)
        raise
    seconds = time.perf_counter() - started
    print(report(result, folder, seconds))
    if demonstrations.truth is not None:
        print(truth_report(own_labels(result, demonstrations), demonstrations))
    found = scores(result, demonstrations) | {"seconds": seconds}
    write_scores(result.pretrained.parent, found)
    with doing_without(folder.tensorboard):
        write_row(folder.tensorboard, plain_options(options) | {"world": demonstrations.world}, found)
    folder.end()


def trained(
    demonstrations: Demonstrations,
    options: TrainOptions,
    folder: RunFolder,
    given: torch.Tensor | None,
    ranks: Ranks,
) -> TrainingResult:
    """What the training ends with."""
    if not options.dagger.iterations:
        return Trainer(demonstrations, options, folder, given, ranks).train()
    from dpmacro.training.dagger import aggregate  # worlds and their teachers: a second of imports

    return aggregate(demonstrations, options, folder, lambda done: tqdm.write(dagger_report(done))).result


def own_labels(result: TrainingResult, demonstrations: Demonstrations) -> np.ndarray:
    """The found labels [frames] of the demonstrations that were given: DAgger appends others."""
    return result.found.labels.numpy()[: int(demonstrations.lengths.sum())]


def changes(labels: np.ndarray, lengths: np.ndarray) -> float:
    """Changes of macro-action in a demonstration, on average."""
    return float(transition_counts(torch.from_numpy(labels), torch.from_numpy(lengths)).float().mean())


def scores(result: TrainingResult, demonstrations: Demonstrations) -> dict[str, float]:
    """What TensorBoard compares trainings by; scores against the truth where the dataset records one."""
    found = result.found
    labels = own_labels(result, demonstrations)
    known = {
        "objective": float(found.loss[-1]),
        "macro_actions": float(result.policy.config.macros),
        "transitions": changes(labels, demonstrations.lengths),
    }
    if len(found.switches.recognised):
        known["recognised"] = float(found.switches.recognised.mean())
    if result.choice is not None and result.choice.place is not None:
        known["left_out_gain"] = result.choice.points[result.choice.place].gain
    if demonstrations.truth is not None:
        hits, made, true = boundary_counts(labels, demonstrations.truth, demonstrations.lengths, TOLERANCE)
        known["frame_accuracy"] = frame_accuracy(labels, demonstrations.truth)
        known["boundary_f1"] = 2 * hits / max(made + true, 1)
    return known


def report(result: TrainingResult, folder: RunFolder, seconds: float) -> str:
    """What was found, for people."""
    found = result.found
    occupancy = found.labels.bincount(minlength=result.policy.config.macros).tolist()
    lines = [f"{'data' if place == 0 else '':<12} {note}" for place, note in enumerate(result.notes)]
    lines += [] if result.choice is None else choice_report(result.choice)
    lines.append(f"objective    {float(found.loss[-1]):.4f} a frame, {len(found.loss)} rounds")
    lines += [f"macro {macro}      {frames} frames" for macro, frames in enumerate(occupancy)]
    lines += switch_report(result)
    plan = result.plan
    searched = f"{plan.drawn} drawn at a time" if plan.drawn else "all sorted"
    lines += [
        f"columns      {plan.columns} of {plan.of}, {searched}, about {plan.gibibytes:.1f} GiB at most",
        *ranks_report(result),
        f"time         {seconds:.1f} s",
        f"policy       {result.pretrained}",
        f"pictures     {folder.figures}",
    ]
    lines += [f"TensorBoard  tensorboard --logdir={folder.tensorboard}"]
    return "\n".join(lines)


def ranks_report(result: TrainingResult) -> list[str]:
    """How the columns were divided, if they were."""
    ranks, plan = result.ranks.size, result.plan
    if ranks == 1:
        return []
    held = -(-plan.columns // ranks)
    return [f"ranks        {ranks} ranks, {held} columns and about {plan.gibibytes:.1f} GiB at most each"]


def switch_report(result: TrainingResult) -> list[str]:
    """How well the changes are recognised, and what else there is to know of them."""
    found, lines = result.found, []
    switches, discovery = found.switches, found.discovery
    judges = "left-out demonstrations" if switches.left_out else "the demonstration it learned from"
    told = zip(switches.pairs, switches.recognised.tolist(), switches.thresholds.tolist(), strict=True)
    for (source, target), share, threshold in told:
        never = ": too few, the policy never makes it" if threshold == math.inf else ""
        lines.append(f"switch {source}->{target}  recognises {share:.0%} of the changes in {judges}{never}")
    if switches.pairs and switches.left_out:
        lines.append(
            "             (threshold and cues by other demonstrations, changes as the search had cut them)"
        )
    if discovery is not None and not discovery.kept.scores.runnable:
        lines.append(
            "warning      no segmentation was found whose changes can be recognised as they come. The labels "
            "were chosen in hindsight (with recipe=paper, by the training loss), and switch functions had no "
            "say in where changes lie (switch_weight is 0). The policy will change its macro-action at wrong "
            "times; the labels may still be good"
        )
    if found.unsettled:
        lines.append(
            f"unsettled    switch functions were fitted to other labels on {found.unsettled} of "
            f"{len(found.labels)} frames"
        )
    return lines


def dagger_report(iteration: "Iteration") -> str:
    """How the planner of one DAgger iteration did in validation worlds."""
    low, high = wilson_interval(iteration.successes, iteration.runs)
    line = (
        f"dagger {iteration.number}     {iteration.successes} of {iteration.runs} validation runs, "
        f"{low:.0%} to {high:.0%}, from {iteration.trajectories} trajectories"
    )
    if iteration.number:
        line += f"; the planner before agreed with the teacher on {iteration.agreement:.1%} of its own frames"
    return line


def choice_report(choice: Choice) -> list[str]:
    """How the number of macro-actions was chosen."""
    lines = ["             gain over one macro-action on left-out data, nats a frame (standard error)"]
    for place, point in enumerate(choice.points):
        ending = ", cannot be run: changes are not recognised" * (not point.runnable) + " <-" * (
            place == choice.place
        )
        lines.append(
            f"Q={point.macros} S={point.max_transitions}      {point.gain:+.4f} ({point.error:.4f}), "
            f"{point.changes:.1f} transitions a demonstration{ending}"
        )
    if choice.place is None:
        lines.append("chosen       one macro-action: no other gains anything")
    return lines


def truth_report(labels: np.ndarray, demonstrations: Demonstrations) -> str:
    """The segmentation against the truth that the dataset records, which training never sees."""
    truth = demonstrations.truth
    assert truth is not None, "the caller checked it"
    hits, found, true = boundary_counts(labels, truth, demonstrations.lengths, TOLERANCE)
    name = f"true {demonstrations.truth_name}"
    return (
        f"{name:<12} {frame_accuracy(labels, truth):.1%} of frames agree; {hits} of {true} change points "
        f"found within {TOLERANCE} frames, {found} made"
    )


if __name__ == "__main__":
    cli.run(main, TrainOptions)
