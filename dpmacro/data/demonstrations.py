"""Demonstrations: what was seen and which action was taken, frame after frame, read from LeRobot datasets."""

import sys
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Int64, UInt8

from dpmacro.data.actions import Actions
from dpmacro.data.images import DatasetError, ImageTransform
from dpmacro.data.lerobot.frames import TOLERANCE
from dpmacro.data.loading import load_parts
from dpmacro.parallel import ALONE, Ranks
from dpmacro.utils.checks import as_count, as_entries, as_kind, as_number, as_path, as_text, shown

__all__ = ["DatasetError", "Demonstrations"]

AS_USUAL = ImageTransform()
IMAGE = "observation.image"  # what LeRobot calls the images of an only camera


@dataclass(frozen=True)
class Demonstrations:
    """Trajectories, concatenated frame by frame; `lengths` says where each ends.

    Raises ValueError where an attribute is no array of numbers for all frames.

    Attributes:
        observations: what the policy sees, keyed as in LeRobot: RGB images of cameras, uint8
            [frames, height, width, 3]; vectors, float32 [frames, size]; where the dataset has several tasks,
            `task_index`, int64 [frames]. At least one.
        actions: the action taken at each frame: classes 0..M-1 [frames], or vectors [frames, dims].
        lengths: frames per trajectory, at least 2.
        action_names: M names of classes, or one per dimension; numbers as text where the dataset names none.
        fps: frames per second, as stored.
        truth: the true macro-label, for metrics only, 0..K-1; None where the data has none.
        world: {"id": its gymnasium id, **options} of the world recorded from; {} where the data does not say.
        root: the dataset's folder.
        truth_name: the column that `truth` comes from, "phase" or "subgoal" say; None without truth.
        truth_classes: names of the true labels 0..K-1; the numbers as text where the data names none.
        stored_shapes: height and width of a camera's images before they were shrunk; None where not.
        symmetric: whether the world and its mirror image are alike, as the dataset declares.
        state_names: names of the numbers of every vector in `observations`.
        tasks: what there is to do, in words, by task_index; () where the data does not say.
        notes: what a user should know of the choices made in reading, a line each.
        episodes: the dataset's numbers of the trajectories; () where the data does not say.
    """

    observations: dict[str, np.ndarray]
    actions: Actions
    lengths: Int64[np.ndarray, " trajectories"]
    action_names: tuple[str, ...]
    fps: int | float
    truth: Int64[np.ndarray, " frames"] | None
    world: dict[str, Any]
    root: Path
    truth_name: str | None = None
    truth_classes: tuple[str, ...] = ()
    stored_shapes: dict[str, tuple[int, int] | None] = field(default_factory=dict)
    symmetric: bool = False
    state_names: dict[str, tuple[str, ...]] = field(default_factory=dict)
    tasks: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    episodes: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        lengths = as_kind("lengths", self.lengths, np.ndarray, "an array of whole numbers")
        if lengths.ndim != 1 or lengths.dtype.kind not in "iu" or not len(lengths) or lengths.min() < 1:
            raise ValueError(f"lengths are {shown(lengths)}: give the frames of each, 1 or more")
        framed = {"actions": self.actions, **as_kind("observations", self.observations, dict)}
        framed |= {} if self.truth is None else {"truth": self.truth}
        for name, values in framed.items():
            as_kind(str(name), values, np.ndarray, "an array")
            if not values.ndim or len(values) != int(lengths.sum()) or values.dtype.kind not in "biuf":
                raise ValueError(
                    f"{name} have shape {list(values.shape)} and type {values.dtype}: give numbers for each "
                    f"of {int(lengths.sum())} frames, to which lengths add up"
                )

    @classmethod
    def of_images(
        cls, images: UInt8[np.ndarray, "frames height width 3"], *parts: Any, camera: str = IMAGE, **more: Any
    ) -> "Demonstrations":
        """Demonstrations of one camera: images in place of `observations`, other arguments as they are."""
        return cls({camera: images}, *parts, **more)

    @classmethod
    def load(
        cls,
        root: str | Path,
        episodes: Sequence[int] | None = None,
        *,
        inputs: Sequence[str] | None = None,
        camera: str | None = None,
        action: str | Sequence[str] | None = None,
        truth: str | None = None,
        transform: ImageTransform = AS_USUAL,
        task: str | int | None = None,
        tolerance_s: float = TOLERANCE,
        ranks: Ranks = ALONE,
    ) -> "Demonstrations":
        """Reads a LeRobot dataset of format v3 or v2, without touching the network.

        Args:
            root: the dataset's folder.
            episodes: those to read, in the order given; all by default.
            inputs: features that the policy sees. By default all cameras and all vectors that begin with
                `observation.`; where exactly one camera is stored as images, those stored as video are left
                out. The task is seen wherever the dataset has several.
            camera: short for `inputs` of this one camera.
            action: the feature, or features, to learn. By default `discrete_action`, else `action`, else
                `actions`, else all that begin with `action.`. Whole numbers and one-hot vectors are classes.
            truth: the column of true labels, integers or text; "none" for no truth. By default the first that
                was recorded as such, else `phase` or `subgoal`, where there is one.
            transform: what is done to the images.
            task: read only the episodes of this task, by its words or its task_index.
            tolerance_s: seconds that a frame of a video may be off its recorded time, as in LeRobot.
            ranks: who decode a share of the pictures each; all have all in the end.

        Raises DatasetError, one line that names the place, the value and a remedy, for anything it cannot
        read as demonstrations of at least two frames each; ValueError for an argument of another kind.
        """
        as_path("root", root)
        as_kind("transform", transform, ImageTransform)
        as_number("tolerance_s", tolerance_s, least=0.0)
        if episodes is not None:
            _numbers("episodes", episodes)
        for name, value in (("inputs", inputs), ("action", action)):
            if value is not None and not isinstance(value, str):
                as_entries(name, value)
        for name, text in (("camera", camera), ("truth", truth)):
            if text is not None:
                as_text(name, text)
        if task is not None and (isinstance(task, bool) or not isinstance(task, str | int)):
            raise DatasetError(f"task is {shown(task)}: give its words or its task_index")
        if camera is not None:
            if inputs is not None:
                raise DatasetError(
                    f"dataset {root}: camera={camera} and inputs={list(inputs)}; give one of them"
                )
            inputs = [camera]
        given = Path(root), episodes, inputs, action, truth, transform, task, tolerance_s
        return cls(**load_parts(*given, ranks))

    @property
    def vector(self) -> bool:
        """Whether actions are vectors of numbers rather than classes."""
        return self.actions.ndim == 2

    @property
    def numbers(self) -> tuple[int, ...]:
        """The dataset's numbers of the trajectories, 0, 1, ... where the data does not say."""
        return self.episodes or tuple(range(len(self.lengths)))

    @property
    def cameras(self) -> tuple[str, ...]:
        """The observations that are images."""
        return tuple(name for name, values in self.observations.items() if values.ndim == 4)

    @property
    def images(self) -> UInt8[np.ndarray, "frames height width 3"]:
        """What the first camera sees. Raises ValueError where there is none."""
        if not self.cameras:
            raise ValueError(f"{self.root} has no camera: it has {', '.join(self.observations)}")
        return self.observations[self.cameras[0]]

    @property
    def stored_shape(self) -> tuple[int, int] | None:
        """Height and width of the first camera's images before they were shrunk; None where they were not."""
        return self.stored_shapes.get(self.cameras[0]) if self.cameras else None

    @property
    def trajectories(self) -> list[slice]:
        """The frames of each trajectory."""
        ends = np.cumsum(self.lengths).tolist()
        return [slice(end - length, end) for end, length in zip(ends, self.lengths.tolist(), strict=True)]

    def select(self, trajectory_indices: Sequence[int] | Int64[np.ndarray, " chosen"]) -> "Demonstrations":
        """The given trajectories (0..I-1, any order, repeats allowed) as demonstrations of their own.

        Raises ValueError where there is none, or one that does not exist.
        """
        chosen = _numbers("trajectory_indices", trajectory_indices)
        wrong = [index for index in chosen if not 0 <= index < len(self.lengths)]
        if wrong or not chosen:
            raise ValueError(f"trajectories {wrong or chosen}: choose from 0..{len(self.lengths) - 1}")
        slices = self.trajectories
        frames = np.concatenate([np.arange(slices[index].start, slices[index].stop) for index in chosen])
        return replace(
            self,
            observations={name: values[frames] for name, values in self.observations.items()},
            actions=self.actions[frames],
            lengths=self.lengths[chosen],
            truth=None if self.truth is None else self.truth[frames],
            episodes=tuple(self.episodes[index] for index in chosen) if self.episodes else (),
        )

    def joined(self, others: "Demonstrations") -> "Demonstrations":
        """These trajectories, then the others; truth stays where both have the same column.

        Raises ValueError where observations or actions differ.
        """
        as_kind("others", others, Demonstrations)
        ours, theirs = (
            {name: one.shape[1:] for name, one in of.observations.items()} for of in (self, others)
        )
        if ours.keys() != theirs.keys():
            raise ValueError(
                f"{self.root} has {', '.join(ours)} and {others.root} {', '.join(theirs)}: join like "
                "with like"
            )
        pairs: list[tuple[str, Any, Any]] = [
            (f"{'images' if name in self.cameras else 'vectors'} of", shape[:2], theirs[name][:2])
            for name, shape in ours.items()
        ]
        pairs += [
            ("the actions", self.action_names, others.action_names),
            ("the tasks", self.tasks, others.tasks),
        ]
        pairs += [("vectors as actions:", self.vector, others.vector)]
        for what, one, other in pairs:
            if one != other:
                raise ValueError(
                    f"{self.root} has {what} {one} and {others.root} {other}: join like with like"
                )
        same_truth = self.truth_name is not None and self.truth_name == others.truth_name
        return replace(
            self,
            observations={
                name: np.concatenate([values, others.observations[name]])
                for name, values in self.observations.items()
            },
            actions=np.concatenate([self.actions, others.actions]),
            lengths=np.concatenate([self.lengths, others.lengths]),
            truth=np.concatenate([self.truth, others.truth]) if same_truth else None,
            truth_name=self.truth_name if same_truth else None,
            truth_classes=max(self.truth_classes, others.truth_classes, key=len) if same_truth else (),
            episodes=(),
        )


def _numbers(name: str, value: Any) -> list[int]:
    """Whole numbers, in a list or a vector."""
    if isinstance(value, str) or not isinstance(value, Sequence | np.ndarray) or np.ndim(value) != 1:
        raise ValueError(f"{name} is {shown(value)}: give a list of whole numbers")
    return [as_count(f"{name}[{place}]", one, -sys.maxsize) for place, one in enumerate(value)]
