"""What is learned from: the observations, actions as targets, and the columns that are searched.

Demonstrations become tensors on the training's device; vectors become standardised targets; the encoder is
made for what a frame shows, and a plan holds its columns in the memory there is.
"""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Int64, Num
from torch import Tensor
from tqdm import tqdm

from dpmacro.boosting.crossfit import CLASSIFIER_FOLDS
from dpmacro.data.demonstrations import Demonstrations
from dpmacro.data.images import ImageTransform
from dpmacro.data.vectors import ActionTransform
from dpmacro.discovery.candidates import FINALISTS, LEADERS
from dpmacro.discovery.fields import drawn_of
from dpmacro.discovery.refinement import REFINED
from dpmacro.features.base import Encoder, Observation, frame_bytes
from dpmacro.features.columns import prepare
from dpmacro.features.kinds import CameraSpec, ObservationSpec, StateSpec, TaskSpec, make_encoder
from dpmacro.features.levels import SortedLevels
from dpmacro.features.memory import DRAWN, Demand, Plan
from dpmacro.features.quantising import Quantiser
from dpmacro.parallel import ALONE, Ranks
from dpmacro.policy.recovery import MAX_ACTIONS
from dpmacro.switching.settings import SWITCH_FOLDS
from dpmacro.training.options import DatasetOptions, TrainOptions

__all__ = ["Columns", "TrainingData", "read_demonstrations", "state_key"]

TASK = "task_index"
WINDOW = 0.5  # seconds of the longer change of a state
EPISODES = 5  # demonstrations of a task, on average, for it to be an input
PAIRS = 512  # differences of two numbers of a state, at most
MIRRORED = 3  # images for one while networks get mirror images: the mirror image, and both in one tensor
TABLES = 10  # float tables of a row per frame while boosting: scores, losses, weights, ...


def read_demonstrations(dataset: DatasetOptions, memory: float, ranks: Ranks = ALONE) -> Demonstrations:
    """The demonstrations that options name; their images take `memory` GiB at most. Ranks share the work.

    Errors are those of `Demonstrations.load`, and ValueError where no dataset is named.
    """
    if dataset.root is None:
        raise ValueError("no demonstrations: give --dataset.root=<folder of a LeRobot dataset>")
    return Demonstrations.load(
        dataset.root,
        dataset.episodes,
        inputs=dataset.inputs,
        camera=dataset.camera,
        action=dataset.action,
        truth=dataset.truth,
        transform=ImageTransform(dataset.image_size, memory=memory),
        task=dataset.task,
        ranks=ranks,
    )


@dataclass(frozen=True)
class Columns:
    """Feature columns of every frame: what computes them, their cuts, and their levels."""

    encoder: Encoder
    quantiser: Quantiser
    levels: SortedLevels


class TrainingData:
    """Demonstrations as a training takes them.

    Args:
        demonstrations: what to learn from.
        options: how.
        most: the largest number of macro-actions that is tried.
        generator: draws columns.
        ranks: who holds a share of the columns each.

    Attributes:
        observations: by key, on the training's device.
        actions: classes, or standardised vectors of the dimensions that vary.
        lengths: frames of every trajectory.
        transform: from vectors as stored to targets and back; None for classes.
        mirror: whether switch functions learn from mirror images, too: in a symmetric world only.
        encoder: all columns that there are to choose from.
        plan: how they are held.

    Raises ValueError naming the option where the demonstrations do not allow it.
    """

    def __init__(
        self,
        demonstrations: Demonstrations,
        options: TrainOptions,
        most: int,
        generator: torch.Generator,
        ranks: Ranks = ALONE,
    ) -> None:
        self._options, self._generator, self._ranks = options, generator, ranks
        self.observations: Observation = {
            key: torch.from_numpy(values).to(options.device)
            for key, values in demonstrations.observations.items()
        }
        self.lengths = torch.from_numpy(demonstrations.lengths)
        self.transform = _transform(demonstrations, options)
        self.actions = _targets(demonstrations, self.transform)
        self.mirror = most > 1 and _mirror(demonstrations, options)
        self.camera = _network_camera(demonstrations, options)
        planner = options.planner
        spec = _spec(demonstrations)
        window = max(round(WINDOW * demonstrations.fps), 2)
        self.encoder = make_encoder(spec, planner.features, planner.rectangles, window, PAIRS, generator)
        self.plan = self._plan(most)

    @property
    def outputs(self) -> int:
        """Classes, or dimensions."""
        return int(self.actions.max()) + 1 if self.actions.ndim == 1 else self.actions.shape[1]

    @property
    def groups(self) -> Int64[Tensor, " trajectories"]:
        """The number of every trajectory: each is left out alone."""
        return torch.arange(len(self.lengths))

    def prepare(self) -> Columns:
        """Features of every frame, quantised and, where memory allows, sorted."""
        with tqdm(desc="Features", total=-(-self.plan.columns // self._ranks.size), unit="column") as bar:
            given = self.observations, self.lengths, self.encoder, self.plan, self._generator
            return Columns(*prepare(*given, bar.update, self._ranks))

    def _plan(self, most: int) -> Plan:
        planner = self._options.planner
        n_frames = int(self.lengths.sum())
        one = TABLES * 4 * most * self.outputs  # of every macro-action
        tables = one
        if most > 1:  # a search sees some of the frames, and its outcome is judged on all
            searched = int(self.lengths[drawn_of(self.lengths, self._options.seed)].sum())
            share = 1.0 if planner.recipe == "paper" else searched / n_frames
            tried = max(planner.restarts, (FINALISTS + LEADERS) * CLASSIFIER_FOLDS)
            tables = max(round(one * tried * share), one * REFINED * CLASSIFIER_FOLDS)
        stumps, networks = planner.switch_learner == "stumps", planner.switch_learner == "convnet"
        switches = TABLES * 4 * most * (most - 1) * (SWITCH_FOLDS + 1) + stumps * DRAWN * planner.switch_drawn
        seen = {key: self.observations[key] for key in self.encoder.keys}
        image_bytes = frame_bytes(seen)
        demand = Demand(
            n_frames,
            image_bytes,
            self.encoder.count,
            tables,
            copies=int(self.mirror and stumps),
            switch_bytes=(1 + self.mirror) * switches + (self.mirror and networks) * MIRRORED * image_bytes,
            always=int((~self.encoder.sees_pixels).sum()),
            inputs=len(seen),
            ranks=self._ranks.size,
        )
        return Plan.fitting(demand, planner.memory_limit)


def _transform(demonstrations: Demonstrations, options: TrainOptions) -> ActionTransform | None:
    if not demonstrations.vector:
        return None
    relative = {"auto": None, "true": True, "false": False}[options.dataset.action_relative]
    state = demonstrations.observations.get(state_key(demonstrations))
    return ActionTransform.fit(
        demonstrations.actions,
        demonstrations.lengths,
        state=state,
        relative=relative,
        names=demonstrations.action_names,
    )


def state_key(demonstrations: Demonstrations) -> str:
    """The vector that absolute actions are targets for: `observation.state`, else the first; "" for none."""
    vectors = [key for key, values in demonstrations.observations.items() if values.ndim == 2]
    return "observation.state" if "observation.state" in vectors else next(iter(vectors), "")


def _targets(
    demonstrations: Demonstrations, transform: ActionTransform | None
) -> Num[Tensor, "frames *dims"]:
    if transform is not None:
        state = demonstrations.observations.get(state_key(demonstrations))
        return torch.from_numpy(transform.targets(demonstrations.actions, state))
    actions = torch.from_numpy(demonstrations.actions)
    if int(actions.max()) >= MAX_ACTIONS:
        raise ValueError(
            f"{demonstrations.root} has an action {int(actions.max())}: number them from 0, "
            f"a policy holds {MAX_ACTIONS} at most"
        )
    return actions


def _spec(demonstrations: Demonstrations) -> ObservationSpec:
    """What a frame shows, without numbers that never vary, and without tasks that are done too seldom."""
    spec: dict[str, CameraSpec | StateSpec | TaskSpec] = {}
    for key, values in demonstrations.observations.items():
        if values.ndim == 4:
            spec[key] = CameraSpec(*values.shape[1:3])
        elif key == TASK:
            if len(np.unique(values)) * EPISODES <= len(demonstrations.lengths):
                spec[key] = TaskSpec(max(len(demonstrations.tasks), int(values.max()) + 1))
        else:
            varies = np.flatnonzero(values.max(0) > values.min(0))
            names = demonstrations.state_names.get(key, tuple(map(str, range(values.shape[1]))))
            spec[key] = StateSpec(names, tuple(varies.tolist()))
    return spec


def _mirror(demonstrations: Demonstrations, options: TrainOptions) -> bool:
    given = options.dataset.symmetric
    if options.planner.recipe == "paper":
        return False
    blind = [key for key in demonstrations.observations if key not in demonstrations.cameras]
    if given and blind:
        raise ValueError(
            f"dataset.symmetric is true and {blind[0]} has no mirror image: leave it out, or learn from "
            "--dataset.inputs that are cameras"
        )
    return (demonstrations.symmetric if given is None else given) and not blind


def _network_camera(demonstrations: Demonstrations, options: TrainOptions) -> str | None:
    """The camera that networks look at; None where there are no networks."""
    if {options.planner.learner, options.planner.switch_learner} == {"stumps"}:
        return None
    cameras = demonstrations.cameras
    if len(demonstrations.observations) != 1 or len(cameras) != 1:
        raise ValueError(
            f"networks look at one camera and {demonstrations.root} shows "
            f"{', '.join(demonstrations.observations)}: name one as --dataset.camera, or use stumps"
        )
    height, width = demonstrations.observations[cameras[0]].shape[1:3]
    if min(height, width) < 2:
        raise ValueError(f"images are {height}x{width}: networks need 2x2 pixels at least, use stumps")
    return cameras[0]
