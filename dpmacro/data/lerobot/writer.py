"""Recording: episodes into a LeRobot v3 dataset that LeRobot's own tools open."""

import json
import shutil
import tempfile
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from jaxtyping import Float32, Int64, UInt8

from dpmacro.data.images import DatasetError
from dpmacro.data.lerobot.compat import create_dataset, embedding_at_once, quiet, resume_dataset
from dpmacro.data.lerobot.reader import WORLD_FILE, StoredDataset
from dpmacro.utils import interrupts
from dpmacro.utils.files import replace_folder

AVATAR = "observation.images.avatar"
VIEW = "observation.images.view"
_OF_LEROBOT = {"timestamp", "frame_index", "episode_index", "index", "task_index"}  # on every frame, unasked


class DemonstrationWriter:
    """Writes episodes to a dataset that carries its final name only once it is complete.

    Used as a context manager: leaving the block finalizes the dataset, leaving it by an exception or an
    interrupt removes what was written so far.

        with DemonstrationWriter.create(root, ("forward", "left", "right"), 30, world, view=False) as writer:
            writer.add_episode(images, actions, {}, rewards, success, "reach the door")
        with DemonstrationWriter.extend(root) as writer:
            writer.add_episode(images, actions, {}, rewards, success, "reach the door")
    """

    def __init__(
        self,
        root: Path,
        action_names: Sequence[str],
        fps: int | float,
        world: dict[str, Any],
        view: bool,
        classes: Mapping[str, Sequence[str]],
        symmetric: bool,
    ):
        self.root = root
        self.action_names = tuple(action_names)
        self.fps = int(fps) if fps == int(fps) else fps  # LeRobot's encoders want a whole number
        self.world = world
        self.view = view
        self.symmetric = symmetric
        self.classes = {name: tuple(of_column) for name, of_column in classes.items()}
        self._folder = Path(tempfile.mkdtemp(prefix=f".{root.name}.", suffix=".partial", dir=root.parent))
        self._dataset: Any = None
        self._sizes: dict[str, tuple[int, ...]] = {}  # height, width, 3 of every camera's pictures
        self._old: StoredDataset | None = None  # what is extended

    @classmethod
    def create(
        cls,
        root: str | Path,
        action_names: Sequence[str],
        fps: int | float,
        world: dict[str, Any],
        view: bool,
        classes: Mapping[str, Sequence[str]] | None = None,
        symmetric: bool = False,
    ) -> "DemonstrationWriter":
        """A writer of a new dataset.

        Args:
            root: folder of the dataset; its parent is created where needed.
            action_names: M >= 2 names.
            fps: frames per second.
            world: {"id": of the world, **its options}, kept in `meta/dpmacro.json`.
            view: whether every episode comes with the avatar's view for people, stored as video.
            classes: columns of true labels, each with the names of its labels 0..K-1, kept in
                `meta/dpmacro.json`; readers take the first column as the truth. By default there are none.
            symmetric: whether the world and its mirror image are alike, kept in `meta/dpmacro.json`; readers
                may then learn from mirror images of the pictures.

        Raises DatasetError where `root` exists, and ValueError for fewer than two actions.
        """
        root = Path(root).absolute()
        if len(action_names) < 2:
            raise ValueError(f"action_names {tuple(action_names)}: LeRobot's tools need at least two actions")
        _refuse_existing(root)
        root.parent.mkdir(parents=True, exist_ok=True)
        return cls(root, action_names, fps, world, view, classes or {}, symmetric)

    @classmethod
    def extend(cls, root: str | Path) -> "DemonstrationWriter":
        """A writer of more episodes for a dataset that was recorded before.

        Actions, frames per second, world, its symmetry, columns of truth, sizes of pictures and whether there
        is a view are those of the dataset. What is written is a copy of it, which takes its place once
        complete: until then, and whatever happens, the folder `root` holds the old one.

        Raises DatasetError where `root` is no dataset, not one that this writer recorded, or not whole.
        """
        old = _recorded(Path(root).resolve())
        features = old.features
        names = features["action"]["names"]
        about = old.world, VIEW in features, old.truth, old.symmetric
        writer = cls(old.root, names, old.fps, *about)
        writer._sizes = {camera: tuple(features[camera]["shape"]) for camera in {AVATAR, VIEW} & {*features}}
        writer._old = old
        return writer

    def add_episode(
        self,
        images: UInt8[np.ndarray, "frames height width 3"],
        actions: Int64[np.ndarray, " frames"],
        truth: Mapping[str, Int64[np.ndarray, " frames"]],
        rewards: Float32[np.ndarray, " frames"],
        success: bool,
        task: str,
        views: UInt8[np.ndarray, "frames view_height view_width 3"] | None = None,
    ) -> None:
        """Appends one episode; frame t holds the observation before action t, reward t what it earned.

        `truth` holds the labels of every column that `create` was told; `task` says in words what the episode
        is about. Every episode has pictures of the same size. Raises ValueError for an action outside
        0..M-1, a true label outside 0..K-1, one frame only, pictures of another size than the dataset's, and
        views given or missing against what `create` was told; DatasetError where the dataset to extend is
        no longer what it was.
        """
        if len(actions) < 2:
            raise ValueError(f"an episode of {len(actions)} frame; dpmacro needs at least two per episode")
        for what, values, names in (
            ("actions", actions, self.action_names),
            *((name, truth[name], names) for name, names in self.classes.items()),
        ):
            if values.min() < 0 or values.max() >= len(names):
                raise ValueError(
                    f"{what} from {values.min()} to {values.max()}; there are {len(names)}, "
                    f"{', '.join(names)}"
                )
        if (views is not None) != self.view:
            raise ValueError(
                f"views given: {views is not None}, but the dataset was created with {self.view=}"
            )
        for camera, pictures in {AVATAR: images, VIEW: views}.items():
            if pictures is None:
                continue
            height, width, _ = self._sizes.setdefault(camera, pictures.shape[1:])
            if pictures.shape[1:3] != (height, width):
                raise ValueError(
                    f"{camera} of {pictures.shape[1]}x{pictures.shape[2]}: dataset {self.root} has "
                    f"{height}x{width}, give pictures of that size"
                )
        if self._dataset is None:
            self._open()
        one_hot = np.eye(len(self.action_names), dtype=np.float32)
        last = len(actions) - 1
        # Within, Hugging Face's `datasets` would now and then swallow an interrupt.
        with interrupts.held_back(), quiet():
            for t, action in enumerate(actions):
                frame = {
                    AVATAR: images[t],
                    "action": one_hot[action],
                    "discrete_action": actions[t : t + 1],
                    **{name: truth[name][t : t + 1] for name in self.classes},
                    "next.reward": rewards[t : t + 1],
                    "next.done": np.array([t == last]),
                    "next.success": np.array([t == last and success]),
                    "task": task,
                }
                if views is not None:
                    frame[VIEW] = views[t]
                self._dataset.add_frame(frame)
            with embedding_at_once():
                self._dataset.save_episode()

    def finalize(self) -> None:
        """Completes the dataset and gives it its name.

        Raises ValueError where no episode was added, DatasetError where `root` has come into being meanwhile,
        or the dataset to extend has changed.
        """
        if self._dataset is None:
            raise ValueError(f"dataset {self.root}: no episode was added, so there is nothing to write")
        self._dataset.finalize()
        self._dataset = None
        shutil.rmtree(self._data / "images", ignore_errors=True)  # emptied by LeRobot, but left behind
        self._refuse_surprises()
        if self._old is None:
            self._data.rename(self.root)
        else:
            replace_folder(self.root, self._data, self._folder / "old")
        shutil.rmtree(self._folder, ignore_errors=True)

    def __enter__(self) -> "DemonstrationWriter":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            if kind is None and self._folder.exists():
                self.finalize()
        finally:
            self._abandon()

    @property
    def _data(self) -> Path:
        return self._folder / "dataset"

    def _abandon(self) -> None:
        if self._dataset is not None:
            # Left open, its parquet files abort the interpreter at its end. Why they cannot be closed does
            # not matter: they go, and an error is on its way already.
            with suppress(Exception):
                self._dataset.finalize()
            self._dataset = None
        shutil.rmtree(self._folder, ignore_errors=True)

    def _open(self) -> None:
        self._refuse_surprises()
        if self._old is None:
            with interrupts.held_back():
                features = _features(self.action_names, self.classes, self._sizes)
                self._dataset = create_dataset(self._data, self.fps, features)
            recorded = {"world": self.world, "truth": self.classes, "symmetric": self.symmetric}
            (self._data / WORLD_FILE).write_text(json.dumps(recorded, indent=2) + "\n")
        else:
            shutil.copytree(self.root, self._data)
            with interrupts.held_back():
                self._dataset = resume_dataset(self._data, self.view, cache=self._folder / "cache")

    def _refuse_surprises(self) -> None:
        if self._old is None:
            _refuse_existing(self.root)
        elif StoredDataset.open(self.root).info != self._old.info:
            raise DatasetError(f"dataset {self.root}: changed while it was being extended; extend it again")


def _features(
    action_names: Sequence[str], classes: Mapping[str, Sequence[str]], sizes: Mapping[str, Sequence[int]]
) -> dict[str, dict[str, Any]]:
    """What every frame has, in LeRobot's terms."""
    number = {"shape": (1,), "names": None}
    pictures = {AVATAR: "image", VIEW: "video"}
    return {
        **{
            camera: {"dtype": pictures[camera], "shape": size, "names": ["height", "width", "channels"]}
            for camera, size in sizes.items()
        },
        "action": {"dtype": "float32", "shape": (len(action_names),), "names": list(action_names)},
        "discrete_action": {"dtype": "int64", **number},
        **{name: {"dtype": "int64", **number} for name in classes},
        "next.reward": {"dtype": "float32", **number},
        "next.done": {"dtype": "bool", **number},
        "next.success": {"dtype": "bool", **number},
    }


def _recorded(root: Path) -> StoredDataset:
    """The dataset in a folder; DatasetError where it is not just as DemonstrationWriter leaves it."""
    store = StoredDataset.open(root)
    if not (root / WORLD_FILE).is_file():
        raise DatasetError(
            f"dataset {root}: has no {WORLD_FILE}, so dpmacro did not record it; extend one that "
            "datasets/record.py recorded"
        )
    expected = {AVATAR, *_features((), store.truth, {})}
    differing = sorted((expected ^ store.features.keys()) - _OF_LEROBOT - {VIEW})
    if differing:
        raise DatasetError(
            f"dataset {root}: lacks or adds {', '.join(differing)}, so it is not as it was recorded; extend "
            "one that is"
        )
    for name in ("meta/tasks.parquet", "meta/stats.json"):
        if not (root / name).is_file():
            raise DatasetError(f"dataset {root}: {name} is missing; it is half-copied, copy it again")
    store.columns(["index"], store.episodes)
    return store


def _refuse_existing(root: Path) -> None:
    if root.exists() or root.is_symlink():
        raise DatasetError(f"dataset {root}: exists already; remove it or give another --root")
