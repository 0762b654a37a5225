"""Demonstrations: what was seen and which action was taken, frame after frame, read from LeRobot datasets."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Int64, UInt8

from dpmacro.data.actions import discrete_actions
from dpmacro.data.images import DatasetError, FrameBuffer, ImageTransform
from dpmacro.data.lerobot.reader import StoredDataset

__all__ = ["DatasetError", "Demonstrations"]

AS_STORED = ImageTransform()


@dataclass(frozen=True)
class Demonstrations:
    """Trajectories, concatenated frame by frame; `lengths` says where each ends.

    Attributes:
        images: what the policy sees, RGB.
        actions: the action taken at each image, 0..M-1.
        lengths: frames per trajectory, at least 2.
        action_names: M names; the numbers as text where the dataset names none.
        fps: frames per second.
        truth: the true macro-label, for metrics only, 0..K-1; None where the data has none.
        world: {"id": "TwoFlags-v0", **options} of the world recorded from; {} where the data does not say.
        root: the dataset's folder.
        truth_name: the column that `truth` comes from, "phase" or "subgoal" say; None without truth.
        truth_classes: names of the true labels 0..K-1; the numbers as text where the data names none.
        stored_shape: height and width of the images before they were shrunk; None where they were not.
        symmetric: whether the world and its mirror image are alike, as the dataset declares.
    """

    images: UInt8[np.ndarray, "frames height width 3"]
    actions: Int64[np.ndarray, " frames"]
    lengths: Int64[np.ndarray, " trajectories"]
    action_names: tuple[str, ...]
    fps: int
    truth: Int64[np.ndarray, " frames"] | None
    world: dict[str, Any]
    root: Path
    truth_name: str | None = None
    truth_classes: tuple[str, ...] = ()
    stored_shape: tuple[int, int] | None = None
    symmetric: bool = False

    @classmethod
    def load(
        cls,
        root: str | Path,
        episodes: Sequence[int] | None = None,
        camera: str | None = None,
        truth: str | None = None,
        transform: ImageTransform = AS_STORED,
    ) -> "Demonstrations":
        """Reads a LeRobot v3 dataset with discrete actions, without touching the network.

        Actions are `discrete_action` where there is one, else `action`: whole numbers of any type, or
        one-hot vectors. `episodes` chooses some, in the order given; `camera` names the image feature where
        there are several (it may stay None where exactly one of them is stored as images rather than video);
        `truth` names the integer column of true labels, "none" for no truth; by default it is the first that
        was recorded as such, else `phase` or `subgoal`, where there is one. `transform` says
        what is done to the images.

        Raises DatasetError, one line that names folder, value and remedy, for anything it cannot read as
        demonstrations of at least two frames each.
        """
        root = Path(root)
        store = StoredDataset.open(root)
        chosen = store.choose(episodes)
        for row in chosen:
            if row["length"] < 2:
                raise DatasetError(
                    f"dataset {root}: episode {row['episode_index']} has {row['length']} frame; "
                    "dpmacro needs at least two frames per episode"
                )
        camera = _choose_camera(store, camera)
        truth = _choose_truth(store, truth)
        wanted = dict.fromkeys(("action", "discrete_action", truth))
        names = [name for name in wanted if name is not None and name in store.features]
        columns = store.columns(names, chosen)
        actions, action_names = discrete_actions(store, columns)
        labels, classes = (None, ()) if truth is None else _true_labels(store, truth, columns[truth])
        buffer = FrameBuffer(len(actions), transform, f"dataset {root}, {camera}")
        store.fill(buffer, camera, chosen)
        return cls(
            images=buffer.images,
            actions=actions,
            lengths=np.array([row["length"] for row in chosen], np.int64),
            action_names=action_names,
            fps=int(store.info["fps"]),
            truth=labels,
            world=store.world,
            root=root,
            truth_name=truth,
            truth_classes=classes,
            stored_shape=buffer.stored_shape,
            symmetric=store.symmetric,
        )

    @property
    def trajectories(self) -> list[slice]:
        """The frames of each trajectory."""
        ends = np.cumsum(self.lengths).tolist()
        return [slice(end - length, end) for end, length in zip(ends, self.lengths.tolist(), strict=True)]

    def select(self, trajectory_indices: Sequence[int] | Int64[np.ndarray, " chosen"]) -> "Demonstrations":
        """The given trajectories (0..I-1, any order, repeats allowed) as demonstrations of their own.

        Raises ValueError where there is none, or one that does not exist.
        """
        chosen = [int(index) for index in trajectory_indices]
        wrong = [index for index in chosen if not 0 <= index < len(self.lengths)]
        if wrong or not chosen:
            raise ValueError(f"trajectories {wrong or chosen}: choose from 0..{len(self.lengths) - 1}")
        slices = self.trajectories
        frames = np.concatenate([np.arange(slices[index].start, slices[index].stop) for index in chosen])
        return replace(
            self,
            images=self.images[frames],
            actions=self.actions[frames],
            lengths=self.lengths[chosen],
            truth=None if self.truth is None else self.truth[frames],
        )

    def joined(self, others: "Demonstrations") -> "Demonstrations":
        """These trajectories, then the others; truth stays where both have the same column.

        Raises ValueError where images or actions differ.
        """
        for what, ours, theirs in (
            ("images of", self.images.shape[1:3], others.images.shape[1:3]),
            ("the actions", self.action_names, others.action_names),
        ):
            if ours != theirs:
                raise ValueError(
                    f"{self.root} has {what} {ours} and {others.root} {theirs}: join like with like"
                )
        same_truth = self.truth_name is not None and self.truth_name == others.truth_name
        return replace(
            self,
            images=np.concatenate([self.images, others.images]),
            actions=np.concatenate([self.actions, others.actions]),
            lengths=np.concatenate([self.lengths, others.lengths]),
            truth=np.concatenate([self.truth, others.truth]) if same_truth else None,
            truth_name=self.truth_name if same_truth else None,
            truth_classes=max(self.truth_classes, others.truth_classes, key=len) if same_truth else (),
        )


def _choose_camera(store: StoredDataset, camera: str | None) -> str:
    """The image feature that the policy sees."""
    cameras = [name for name, feature in store.features.items() if feature["dtype"] in ("image", "video")]
    if not cameras:
        raise DatasetError(f"dataset {store.root}: has no image feature; dpmacro learns from images")
    if camera is not None:
        if camera not in cameras:
            raise DatasetError(f"dataset {store.root}: no camera {camera!r}; it has {', '.join(cameras)}")
        return camera
    lossless = [name for name in cameras if store.features[name]["dtype"] == "image"]
    for only in (cameras, lossless):
        if len(only) == 1:
            return only[0]
    raise DatasetError(f"dataset {store.root}: several cameras, {', '.join(cameras)}; name one as camera")


def _choose_truth(store: StoredDataset, truth: str | None) -> str | None:
    """The column of true labels; None where neither the caller nor the data names one."""
    whole = [
        name
        for name, feature in store.features.items()
        if re.fullmatch(r"u?int\d+", feature["dtype"]) and list(feature["shape"]) in ([], [1])
    ]
    if truth is None:
        return next((name for name in (*store.truth, "phase", "subgoal") if name in whole), None)
    if truth == "none":
        return None
    if truth not in whole:
        raise DatasetError(
            f"dataset {store.root}: no integer column {truth!r} to be the truth; it has {', '.join(whole)}"
        )
    return truth


def _true_labels(
    store: StoredDataset, truth: str, column: np.ndarray
) -> tuple[Int64[np.ndarray, " frames"], tuple[str, ...]]:
    """The labels of a column and the names of their classes, numbers as text where the dataset names none."""
    labels = column.reshape(-1).astype(np.int64)
    if labels.min() < 0:
        frame = int((labels < 0).argmax())
        raise DatasetError(
            f"dataset {store.root}: {truth} {labels[frame]} of frame {frame} is negative; "
            "name another column as truth, or none"
        )
    named = tuple(store.truth.get(truth, ()))
    largest = max(int(labels.max()), -1 if named else store.largest(truth))
    return labels, named + tuple(str(label) for label in range(len(named), largest + 1))
