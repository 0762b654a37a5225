"""DAgger: demonstrations aggregated from the states that the planner itself visits (Ross et al. 2011).

The paper's conclusion promises it. Every iteration runs the planner in new worlds while the teacher says what
it would do there (`collection.py`), appends those runs to a LeRobot dataset and trains on all there is.
Their macro-labels come from the segmentation under the planner's own classifiers and switch functions, as
those of any new demonstration do; the search for macro-actions is not repeated. Success in validation worlds
says which iteration to keep.
"""

from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch.utils.tensorboard import SummaryWriter
from tqdm import tqdm

from dpmacro.annotation.annotate import annotate
from dpmacro.data.demonstrations import Demonstrations
from dpmacro.data.images import ImageTransform
from dpmacro.data.lerobot.writer import DemonstrationWriter
from dpmacro.evaluation.rollouts import PlannerSource, iter_episodes
from dpmacro.training.collection import Visit, gather
from dpmacro.training.options import DaggerOptions, TrainOptions
from dpmacro.training.run_folder import RunFolder
from dpmacro.training.trainer import Trainer, TrainingResult, plain_options
from dpmacro.worlds import EXPERTS, entry_of, recording_of
from dpmacro.worlds.making import import_package

__all__ = ["DRIVERS", "Iteration", "aggregate"]

DRIVERS = {"driver": ("planner", "teacher")}  # a column of the gathered dataset
PATIENCE = 2  # iterations in a row without a new best


@dataclass(frozen=True)
class Iteration:
    """The planner of one iteration; 0 is the one trained on the demonstrations alone."""

    number: int
    trajectories: int  # that it was trained on
    agreement: float  # share of its own frames on which the planner before it acted as the teacher would
    successes: int  # in validation worlds
    runs: int
    result: TrainingResult


def aggregate(
    demonstrations: Demonstrations,
    options: TrainOptions,
    folder: RunFolder,
    on_iteration: Callable[[Iteration], None] = lambda _: None,
) -> Iteration:
    """Train, gather and train again, `options.dagger.iterations` times at most; the best of all planners.

    Ends early after `PATIENCE` iterations without a new best; of equals the earlier is kept. Every iteration
    is a run of its own in `<folder>/iterations/<number>`, the gathered demonstrations are the LeRobot dataset
    `<folder>/gathered`, and the best planner is the run's checkpoint.

    Raises ValueError where the demonstrations name no world that has a teacher, see anything but one camera,
    or have vectors as actions.
    """
    dagger = options.dagger
    import_package(demonstrations.world)
    if entry_of(EXPERTS, str(demonstrations.world.get("id"))) is None:
        raise ValueError(
            f"{demonstrations.root} was recorded in the world {demonstrations.world.get('id')!r}: "
            f"--dagger.iterations needs one whose teacher can be asked, {' or '.join(EXPERTS)}"
        )
    if demonstrations.vector or list(demonstrations.observations) != list(demonstrations.cameras[:1]):
        raise ValueError(
            f"{demonstrations.root} has {', '.join(demonstrations.observations)} and actions of "
            f"{'vectors' if demonstrations.vector else 'classes'}: --dagger.iterations needs one camera, "
            "chosen by --dataset.inputs, and classes"
        )
    runs = folder.path / "iterations"
    result = Trainer(demonstrations, options, RunFolder(runs / "0")).train()
    with SummaryWriter(str(folder.tensorboard)) as writer:
        best = latest = _validated(0, result, len(demonstrations.lengths), float("nan"), dagger)
        known = demonstrations
        _tell(latest, writer, on_iteration)
        for number in range(1, dagger.iterations + 1):
            new, agreement = _gathered(latest, demonstrations, dagger, folder.path / "gathered")
            labels = torch.cat([latest.result.found.labels, annotate(latest.result.policy, new).labels])
            known = known.joined(new)
            trainer = Trainer(known, _settled(options, latest.result), RunFolder(runs / str(number)))
            latest = _validated(number, trainer.train(labels), len(known.lengths), agreement, dagger)
            _tell(latest, writer, on_iteration)
            if latest.successes > best.successes:
                best = latest
            if number - best.number == PATIENCE:
                break
    found = best.result.found
    lengths = torch.from_numpy(known.lengths)[: best.trajectories]
    rounds = len(found.loss)
    pretrained = folder.checkpoint(rounds, best.result.policy, plain_options(options), found.labels, lengths)
    return replace(best, result=replace(best.result, pretrained=pretrained))


def _validated(
    number: int, result: TrainingResult, trajectories: int, agreement: float, dagger: DaggerOptions
) -> Iteration:
    """The planner with its successes in validation worlds."""
    source, n_runs = PlannerSource("policy", result.pretrained), dagger.validation_episodes
    seeds = range(dagger.validation_seed, dagger.validation_seed + n_runs)
    with closing(iter_episodes(source, result.policy.config.world, seeds, dagger.workers)) as episodes:
        bar = tqdm(episodes, f"Validating {number}", n_runs, unit="run")
        successes = sum(episode.success for episode in bar)
    return Iteration(number, trajectories, agreement, successes, n_runs, result)


def _gathered(
    latest: Iteration, demonstrations: Demonstrations, dagger: DaggerOptions, root: Path
) -> tuple[Demonstrations, float]:
    """New runs of the latest planner, appended to the dataset at `root`, and how often it agreed there."""
    source, world = PlannerSource("policy", latest.result.pretrained), demonstrations.world
    first = dagger.seed + latest.number * dagger.episodes
    agreed: list[np.ndarray] = []
    with (
        _writer(root, demonstrations) as writer,
        closing(gather(source, world, range(first, first + dagger.episodes), dagger.workers)) as visits,
        tqdm(visits, f"Gathering {latest.number + 1}", dagger.episodes, unit="run") as bar,
    ):
        for visit in bar:
            _add(writer, visit, recording_of(world["id"]).task)
            agreed.append(visit.agreed[~visit.taught])
    height, width = demonstrations.images.shape[1:3]
    transform = ImageTransform((width, height))
    stored = Demonstrations.load(root, inputs=demonstrations.cameras, transform=transform)
    new = range(len(stored.lengths) - dagger.episodes, len(stored.lengths))
    return stored.select(new), float(np.concatenate(agreed).mean())


def _writer(root: Path, demonstrations: Demonstrations) -> DemonstrationWriter:
    if root.exists():
        return DemonstrationWriter.extend(root)
    names = demonstrations.action_names
    classes = {**recording_of(demonstrations.world["id"]).truth, **DRIVERS}
    return DemonstrationWriter.create(
        root,
        names,
        round(demonstrations.fps),
        demonstrations.world,
        False,
        classes,
        symmetric=demonstrations.symmetric,
    )


def _add(writer: DemonstrationWriter, visit: Visit, task: str) -> None:
    truth = {**visit.truth, "driver": visit.taught.astype(np.int64)}
    writer.add_episode(visit.images, visit.actions, truth, visit.rewards, visit.success, task)


def _settled(options: TrainOptions, result: TrainingResult) -> TrainOptions:
    """Options with the number of macro-actions that the first training settled on."""
    if options.planner.type == "baseline":
        return options
    config = result.policy.config
    planner = replace(options.planner, macros=config.macros, max_transitions=config.max_transitions)
    return replace(options, planner=planner)


def _tell(iteration: Iteration, writer: SummaryWriter, on_iteration: Callable[[Iteration], None]) -> None:
    scalars: dict[str, Any] = {
        "pc_success": 100 * iteration.successes / iteration.runs,
        "agreement": iteration.agreement,
        "trajectories": iteration.trajectories,
    }
    for name, value in scalars.items():
        writer.add_scalar(f"dagger/{name}", value, iteration.number)
    on_iteration(iteration)
