"""Recording: episodes into a LeRobot v3 dataset that LeRobot's own tools open."""

import json
import os
import shutil
import signal
import sys
import tempfile
import threading
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from types import FrameType, TracebackType
from typing import Any
from unittest.mock import patch

import av
import numpy as np
from jaxtyping import Float32, Int64, UInt8

from dpmacro.decoding import DatasetError
from dpmacro.lerobot_v3 import WORLD_FILE

AVATAR = "observation.images.avatar"
VIEW = "observation.images.view"
TASK = "reach the blue flag, then the red flag"
PHASES = {"phase": ("before blue", "after blue")}


class DemonstrationWriter:
    """Writes episodes to a dataset that carries its final name only once it is complete.

    Used as a context manager: leaving the block finalizes the dataset, leaving it by an exception or an
    interrupt removes what was written so far.

        with DemonstrationWriter.create(root, ("forward", "left", "right"), 30, world, view=False) as writer:
            writer.add_episode(images, actions, truth, rewards, success)
    """

    def __init__(
        self,
        root: Path,
        action_names: Sequence[str],
        fps: int,
        world: dict[str, Any],
        view: bool,
        classes: Mapping[str, Sequence[str]],
    ):
        self.root = root
        self.action_names = tuple(action_names)
        self.fps = fps
        self.world = world
        self.view = view
        self.classes = {name: tuple(of_column) for name, of_column in classes.items()}
        self._folder = Path(tempfile.mkdtemp(prefix=f".{root.name}.", suffix=".partial", dir=root.parent))
        self._dataset: Any = None

    @classmethod
    def create(
        cls,
        root: str | Path,
        action_names: Sequence[str],
        fps: int,
        world: dict[str, Any],
        view: bool,
        classes: Mapping[str, Sequence[str]] = PHASES,
    ) -> "DemonstrationWriter":
        """A writer of a new dataset.

        Args:
            root: folder of the dataset; its parent is created where needed.
            action_names: M >= 2 names.
            fps: frames per second.
            world: {"id": of the world, **its options}, kept in `meta/dpmacro.json`.
            view: whether every episode comes with the avatar's view for people, stored as video.
            classes: columns of true labels, each with the names of its labels 0..K-1, kept in
                `meta/dpmacro.json`; readers take the first column as the truth.

        Raises DatasetError where `root` exists, and ValueError for fewer than two actions.
        """
        root = Path(root).absolute()
        if len(action_names) < 2:
            raise ValueError(f"action_names {tuple(action_names)}: LeRobot's tools need at least two actions")
        _refuse_existing(root)
        root.parent.mkdir(parents=True, exist_ok=True)
        return cls(root, action_names, fps, world, view, classes)

    def add_episode(
        self,
        images: UInt8[np.ndarray, "frames height width 3"],
        actions: Int64[np.ndarray, " frames"],
        truth: Mapping[str, Int64[np.ndarray, " frames"]],
        rewards: Float32[np.ndarray, " frames"],
        success: bool,
        views: UInt8[np.ndarray, "frames view_height view_width 3"] | None = None,
        task: str = TASK,
    ) -> None:
        """Appends one episode; frame t holds the observation before action t, reward t what it earned.

        `truth` holds the labels of every column that `create` was told; `task` says in words what the episode
        is about. Every episode has pictures of the same size. Raises ValueError for an action outside
        0..M-1, a true label outside 0..K-1, one frame only, and views given or missing against what
        `create` was told.
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
        if self._dataset is None:
            with _interrupt_held_back():
                self._dataset = self._open(images.shape[1:], None if views is None else views.shape[1:])
        one_hot = np.eye(len(self.action_names), dtype=np.float32)
        last = len(actions) - 1
        with _interrupt_held_back(), _quiet():
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
            with _embedding_at_once():
                self._dataset.save_episode()

    def finalize(self) -> None:
        """Completes the dataset and gives it its name.

        Raises ValueError where no episode was added, DatasetError where `root` has come into being meanwhile.
        """
        if self._dataset is None:
            raise ValueError(f"dataset {self.root}: no episode was added, so there is nothing to write")
        self._dataset.finalize()
        self._dataset = None
        recorded = {"world": self.world, "truth": self.classes}
        (self._data / WORLD_FILE).write_text(json.dumps(recorded, indent=2) + "\n")
        shutil.rmtree(self._data / "images", ignore_errors=True)  # emptied by LeRobot, but left behind
        _refuse_existing(self.root)
        self._data.rename(self.root)
        self._folder.rmdir()

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

    def _open(self, image_shape: tuple[int, ...], view_shape: tuple[int, ...] | None) -> Any:
        # Here and not above: processes that only run the teacher need not wait seconds for this import.
        from lerobot.datasets.lerobot_dataset import LeRobotDataset

        pixels = ["height", "width", "channels"]
        features: dict[str, dict[str, Any]] = {
            AVATAR: {"dtype": "image", "shape": image_shape, "names": pixels},
            "action": {
                "dtype": "float32",
                "shape": (len(self.action_names),),
                "names": list(self.action_names),
            },
            "discrete_action": {"dtype": "int64", "shape": (1,), "names": None},
            **{name: {"dtype": "int64", "shape": (1,), "names": None} for name in self.classes},
            "next.reward": {"dtype": "float32", "shape": (1,), "names": None},
            "next.done": {"dtype": "bool", "shape": (1,), "names": None},
            "next.success": {"dtype": "bool", "shape": (1,), "names": None},
        }
        if view_shape is not None:
            features[VIEW] = {"dtype": "video", "shape": view_shape, "names": pixels}
        return LeRobotDataset.create(
            repo_id=f"dpmacro/{self.root.name}",
            root=self._data,
            fps=self.fps,
            features=features,
            use_videos=self.view,
            video_backend="pyav",
            # Twice as fast as going through PNG files; 0 is a queue without a limit, since a full one
            # drops frames.
            streaming_encoding=self.view,
            encoder_queue_maxsize=0,
        )


def _refuse_existing(root: Path) -> None:
    if root.exists() or root.is_symlink():
        raise DatasetError(f"dataset {root}: exists already; remove it or give another --root")


@contextmanager
def _interrupt_held_back() -> Iterator[None]:
    """Ctrl-C acts once the block is left: within, Hugging Face's `datasets` would now and then swallow it."""
    handler = signal.getsignal(signal.SIGINT)
    if not callable(handler) or threading.current_thread() is not threading.main_thread():
        yield
        return
    caught: list[tuple[int, FrameType | None]] = []
    signal.signal(signal.SIGINT, lambda number, frame: caught.append((number, frame)))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, handler)
    if caught:
        handler(*caught[0])


@contextmanager
def _embedding_at_once() -> Iterator[None]:
    """Images enter an episode's table in one call; LeRobot makes one for each, half of its time."""
    modules = [
        module
        for name in ("lerobot.datasets.lerobot_dataset", "lerobot.datasets.dataset_writer")
        if hasattr(module := sys.modules.get(name), "embed_images")
    ]
    with ExitStack() as stack:
        for module in modules:
            stack.enter_context(patch.object(module, "embed_images", _embed_images))
        yield


def _embed_images(dataset: Any) -> Any:
    import datasets
    from datasets.table import InMemoryTable, embed_table_storage

    table = embed_table_storage(dataset.with_format("arrow")[:])
    embedded = datasets.Dataset(InMemoryTable(table), info=dataset.info, split=dataset.split)
    return embedded.with_format(**dataset.format)


@contextmanager
def _quiet() -> Iterator[None]:
    """No bar per episode from Hugging Face's `datasets`, no chatter of video encoders or about statistics."""
    import datasets

    bars_disabled = datasets.are_progress_bars_disabled()
    encoder_log = os.environ.get("SVT_LOG")
    datasets.disable_progress_bars()
    os.environ["SVT_LOG"] = "1"  # errors only
    av.logging.set_libav_level(av.logging.WARNING)
    try:
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", "Converting input from bool", RuntimeWarning)
            yield
    finally:
        av.logging.set_libav_level(av.logging.INFO)  # libav's own default; it cannot be asked
        if encoder_log is None:
            del os.environ["SVT_LOG"]
        else:
            os.environ["SVT_LOG"] = encoder_log
        if not bars_disabled:
            datasets.enable_progress_bars()
