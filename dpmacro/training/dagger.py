"""DAgger: demonstrations aggregated from the states that the planner itself visits (Ross et al. 2011).

The paper's conclusion promises it. Every iteration runs the planner in new worlds while the teacher says what
it would do there (`collection.py`), writes those runs as a LeRobot dataset and trains on all there is.
Their macro-labels come from the segmentation under the planner's own classifiers and switch functions, as
those of any new demonstration do; the search for macro-actions is not repeated. Success in validation worlds
says which iteration to keep.
"""

import shutil
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from tqdm import tqdm

from dpmacro.annotation.annotate import annotate
from dpmacro.data.demonstrations import Demonstrations
from dpmacro.data.images import ImageTransform
from dpmacro.evaluation.rollouts import PlannerSource, iter_episodes
from dpmacro.evaluation.run_writer import writing_runs
from dpmacro.training.collection import gather
from dpmacro.training.dagger_options import DaggerOptions
from dpmacro.training.options import TrainOptions
from dpmacro.training.run_folder import RunFolder, plain_options
from dpmacro.training.trainer import Trainer, TrainingResult
from dpmacro.utils.events import Events
from dpmacro.utils.stages import stage
from dpmacro.worlds import EXPERTS, entry_of, recording_of
from dpmacro.worlds.actions import ActionMap
from dpmacro.worlds.base import Recording
from dpmacro.worlds.making import import_package, make_world
from dpmacro.worlds.observations import ObservationMap

__all__ = ["DRIVERS", "Iteration", "aggregate"]

DRIVERS = {"driver": ("planner", "teacher")}  # a column of the gathered datasets
TASK = "task_index"  # an observation of demonstrations that no world shows
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
    is a run of its own in `<folder>/iterations/<number>`, the runs gathered for it are the LeRobot dataset
    `<folder>/gathered/<number>`, and the best planner is the run's checkpoint.

    Raises ValueError where the demonstrations name no world that has a teacher, the world shows or takes
    other things than they have, or the task of a frame is to be an input, which no world shows; WorldError
    where the world fails in a run.
    """
    dagger = options.dagger
    import_package(demonstrations.world)
    if entry_of(EXPERTS, str(demonstrations.world.get("id"))) is None:
        raise ValueError(
            f"{demonstrations.root} was recorded in the world {demonstrations.world.get('id')!r}: "
            f"--dagger.iterations needs one whose teacher can be asked, {' or '.join(EXPERTS)}"
        )
    told = _told(demonstrations)
    _check_world(demonstrations)
    runs = folder.path / "iterations"
    trainer = Trainer(demonstrations, options, RunFolder.inner(runs / "0"))
    if TASK in trainer.data.encoder.keys:
        raise ValueError(
            f"{demonstrations.root} has {len(demonstrations.tasks)} tasks, and no world shows the task of a "
            "frame: choose one by --dataset.task"
        )
    result = trainer.train()
    with Events(folder.tensorboard) as writer:
        best = latest = _validated(0, result, len(demonstrations.lengths), float("nan"), dagger)
        known = _without_task(demonstrations)
        _tell(latest, writer, on_iteration)
        for number in range(1, dagger.iterations + 1):
            new, agreement = _gathered(latest, known, told, dagger, folder.path / "gathered")
            labels = torch.cat([latest.result.found.labels, annotate(latest.result.policy, new).labels])
            known = known.joined(new)
            trainer = Trainer(known, _settled(options, latest.result), RunFolder.inner(runs / str(number)))
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
    successes = _successes(number, result, dagger)
    return Iteration(number, trajectories, agreement, successes, dagger.validation_episodes, result)


@stage
def _successes(number: int, result: TrainingResult, dagger: DaggerOptions) -> int:
    source, n_runs = PlannerSource("policy", result.pretrained), dagger.validation_episodes
    seeds = range(dagger.validation_seed, dagger.validation_seed + n_runs)
    with closing(iter_episodes(source, result.policy.config.world, seeds, dagger.workers)) as episodes:
        bar = tqdm(episodes, f"Validating {number}", n_runs, unit="run")
        return sum(episode.success for episode in bar)


def _gathered(
    latest: Iteration, known: Demonstrations, told: Recording, dagger: DaggerOptions, folder: Path
) -> tuple[Demonstrations, float]:
    """New runs of the latest planner, also as a dataset in `folder`, and how often it agreed there."""
    root = folder / str(latest.number + 1)
    agreement = _agreement(latest, known, told, dagger, root)
    sizes = {camera: known.observations[camera].shape[2:0:-1] for camera in known.cameras}
    new = Demonstrations.load(
        root,
        inputs=list(known.observations),
        truth=known.truth_name if known.truth_name in told.truth else "none",
        transform=ImageTransform(sizes),
    )
    return replace(_without_task(new), tasks=known.tasks), agreement


@stage
def _agreement(
    latest: Iteration, known: Demonstrations, told: Recording, dagger: DaggerOptions, root: Path
) -> float:
    """How often the latest planner agrees with the teacher in new runs of its own, written to `root`."""
    if root.exists():  # written just before the run was stopped
        shutil.rmtree(root)
    source, world = PlannerSource("policy", latest.result.pretrained), known.world
    first = dagger.seed + latest.number * dagger.episodes
    seeds = range(first, first + dagger.episodes)
    agreed: list[np.ndarray] = []
    with (
        writing_runs(root, world, told) as writer,
        closing(gather(source, world, _inputs(known), seeds, dagger.workers)) as visits,
        tqdm(visits, f"Gathering {latest.number + 1}", dagger.episodes, unit="run") as bar,
    ):
        for visit in bar:
            if visit is None or len(visit.taught) < 2:  # a trajectory has two frames at least
                continue
            driver = dict(zip(DRIVERS, [visit.taught.astype(np.int64)], strict=True))
            writer.add(replace(visit.run, truth=visit.run.truth | driver))
            agreed.append(visit.agreed[~visit.taught])
        if not agreed:
            raise ValueError(
                f"all runs of seeds {seeds[0]} to {seeds[-1]} in {world['id']} ended on their first frame: "
                "give another --dagger.seed"
            )
    return float(np.concatenate(agreed).mean())


def _told(demonstrations: Demonstrations) -> Recording:
    """What the gathered datasets say: what recordings of the world do, by the demonstrations' own names."""
    told = recording_of(demonstrations.world["id"])
    return replace(
        told,
        truth={**told.truth, **DRIVERS},
        actions=demonstrations.action_names,
        fps=round(demonstrations.fps),
        symmetric=demonstrations.symmetric,
        states=demonstrations.state_names,
    )


def _inputs(demonstrations: Demonstrations) -> dict[str, tuple[int, ...]]:
    """What a world has to show: shapes by LeRobot's keys, of pictures before they were shrunk."""
    shapes = {
        key: (*stored, 3) if (stored := demonstrations.stored_shapes.get(key)) else values.shape[1:]
        for key, values in demonstrations.observations.items()
    }
    return {key: shape for key, shape in shapes.items() if key != TASK}


def _check_world(demonstrations: Demonstrations) -> None:
    """Raise WorldError where the world shows or takes other things than the demonstrations have."""
    world, names = demonstrations.world, len(demonstrations.action_names)
    env = make_world(world)
    try:
        ObservationMap.fit(
            world["id"], env.observation_space, _inputs(demonstrations), world.get("observations")
        )
        numbers = (None, names) if demonstrations.vector else (names, None)
        ActionMap.fit(world["id"], env.action_space, *numbers)
    finally:
        env.close()


def _without_task(demonstrations: Demonstrations) -> Demonstrations:
    """The demonstrations without the task as an observation."""
    shown = {key: values for key, values in demonstrations.observations.items() if key != TASK}
    return replace(demonstrations, observations=shown)


def _settled(options: TrainOptions, result: TrainingResult) -> TrainOptions:
    """Options with the number and the order of macro-actions that the first training settled on."""
    if options.planner.type == "baseline":
        return options
    config = result.policy.config
    most = None if config.order == "chain" else config.max_transitions  # in a chain there is no choice
    planner = replace(options.planner, macros=config.macros, max_transitions=most, order=config.order)
    return replace(options, planner=planner)


def _tell(iteration: Iteration, writer: Events, on_iteration: Callable[[Iteration], None]) -> None:
    scalars: dict[str, Any] = {
        "pc_success": 100 * iteration.successes / iteration.runs,
        "agreement": iteration.agreement,
        "trajectories": iteration.trajectories,
    }
    for name, value in scalars.items():
        writer.add_scalar(f"dagger/{name}", value, iteration.number)
    on_iteration(iteration)
