"""Runs with an expert's actions as a LeRobot dataset, whatever a world shows and takes."""

import json
import shutil
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, nullcontext, suppress
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float32

from dpmacro.data.images import DatasetError
from dpmacro.data.lerobot.compat import create_dataset, embedding_at_once, quiet
from dpmacro.data.lerobot.reader import WORLD_FILE
from dpmacro.evaluation.recording import Run
from dpmacro.utils import interrupts
from dpmacro.worlds.base import Recording, WorldError

__all__ = ["VIEW", "RunWriter", "writing_runs"]

VIEW = "observation.images.view"
"""The camera of pictures for people, stored as video."""


@contextmanager
def writing_runs(
    root: Path, world: Mapping[str, Any], told: Recording, noise: float = 0.0, building: Path | None = None
) -> Iterator["RunWriter"]:
    """A writer of a new dataset, which is in `root`, and complete, once the block has been left.

    An exception or an interrupt leaves nothing behind. Raises DatasetError where `root` exists, and
    ValueError where no run was added.

    Args:
        root: the dataset's folder.
        world: {"id": of the world, **its options}, kept in `meta/dpmacro.json`.
        told: what recordings of the world say; truth, its names and the symmetry are kept there as well.
        noise: of the actions done, kept there likewise.
        building: a folder that does not exist, on the same disk, to write in before `root` is there; by
            default a hidden one beside it.
    """
    root = root.absolute()
    _refuse_existing(root)
    root.parent.mkdir(parents=True, exist_ok=True)
    if building is None:
        building = Path(tempfile.mkdtemp(prefix=f".{root.name}.", suffix=".partial", dir=root.parent))
    folder = building
    writer = RunWriter(folder / "dataset", told)
    try:
        yield writer
        if writer.frames == 0:
            raise ValueError(f"dataset {root}: no run was added, so there is nothing to write")
        writer.close()
        about = {"world": dict(world), "truth": told.truth, "symmetric": told.symmetric}
        about |= {"noise": noise} if noise else {}
        (folder / "dataset" / WORLD_FILE).write_text(json.dumps(about, indent=2) + "\n")
        _sort_statistics(folder / "dataset/meta/stats.json")
        shutil.rmtree(folder / "dataset/images", ignore_errors=True)  # LeRobot leaves an empty one behind
        _refuse_existing(root)
        (folder / "dataset").rename(root)
    finally:
        with suppress(Exception):  # left open, its files abort the interpreter at its end
            writer.close()
        shutil.rmtree(folder, ignore_errors=True)


class RunWriter:
    """Writes runs into a dataset whose features are those of the first run.

    Classes are stored as `discrete_action`, and as one-hot vectors in `action`, which LeRobot's tools need.

    Attributes:
        frames: that were written.
    """

    def __init__(self, folder: Path, told: Recording) -> None:
        self.frames = 0
        self._folder, self._told = folder, told
        self._dataset: Any = None
        self._features: dict[str, dict[str, Any]] = {}

    def add(self, run: Run) -> None:
        """Append a run of at least two frames.

        Raises ValueError for one frame only, a single class, an action or a true label beyond the names there
        are, and for observations and views that are others than those of the first run.
        """
        told, classes = self._told, run.actions.ndim == 1
        if len(run.actions) < 2:
            raise ValueError(
                f"a run of {len(run.actions)} frame: demonstrations have at least two, leave it out"
            )
        if classes and len(told.actions) < 2:
            raise ValueError(f"the only action is {told.actions[0]!r}: LeRobot's tools need two at least")
        columns = {"actions": (run.actions, told.actions)} if classes else {}
        columns |= {name: (run.truth[name], names) for name, names in told.truth.items()}
        for what, (values, names) in columns.items():
            if values.min() < 0 or values.max() >= len(names):
                raise ValueError(
                    f"{what} from {values.min()} to {values.max()}; there are {len(names)}, "
                    f"{', '.join(names)}"
                )
        features = _features(run, told)
        if self._dataset is None:
            self._features = features
            with interrupts.held_back():
                self._dataset = create_dataset(self._folder, told.fps, features)
        for name in {**self._features, **features}:
            first, now = (of.get(name, {}).get("shape") for of in (self._features, features))
            if first != now:
                raise ValueError(
                    f"{name} has shape {now}, and had {first} in the first run: record one world, with or "
                    "without views"
                )
        ends = np.arange(len(run.actions)) == len(run.actions) - 1
        vectors = np.eye(len(told.actions), dtype=np.float32)[run.actions] if classes else run.actions
        every = {**run.observations, "action": vectors}
        every |= {VIEW: run.views} if run.views is not None else {}
        pictures = any(values.ndim == 4 for values in every.values())
        single = {"discrete_action": run.actions} if classes else {}
        single |= {**run.truth, "next.reward": run.rewards}
        single |= {"next.done": ends, "next.success": ends & run.success}
        # Within, Hugging Face's `datasets` would now and then swallow an interrupt.
        with interrupts.held_back(), quiet():
            for t in range(len(run.actions)):
                self._dataset.add_frame(
                    {name: values[t] for name, values in every.items()}
                    | {name: values[t : t + 1] for name, values in single.items()}
                    | {"task": run.task}
                )
            with embedding_at_once() if pictures else nullcontext():
                self._dataset.save_episode()
        self.frames += len(run.actions)

    def close(self) -> None:
        """Complete the files; a second call does nothing."""
        if self._dataset is not None:
            dataset, self._dataset = self._dataset, None
            dataset.finalize()


def _features(run: Run, told: Recording) -> dict[str, dict[str, Any]]:
    """What every frame has, in LeRobot's terms."""
    number = {"shape": (1,), "names": None}
    pictures = {name: (values, "image") for name, values in run.observations.items() if values.ndim == 4}
    pictures |= {VIEW: (run.views, "video")} if run.views is not None else {}
    vectors = {name: values for name, values in run.observations.items() if values.ndim == 2}
    return {
        **{
            name: {"dtype": kind, "shape": values.shape[1:], "names": ["height", "width", "channels"]}
            for name, (values, kind) in pictures.items()
        },
        **{
            name: {"dtype": "float32", "shape": values.shape[1:], "names": _names(name, values, told)}
            for name, values in vectors.items()
        },
        "action": {"dtype": "float32", "shape": (len(told.actions),), "names": list(told.actions)},
        **({"discrete_action": {"dtype": "int64", **number}} if run.actions.ndim == 1 else {}),
        **{name: {"dtype": "int64", **number} for name in told.truth},
        "next.reward": {"dtype": "float32", **number},
        "next.done": {"dtype": "bool", **number},
        "next.success": {"dtype": "bool", **number},
    }


def _sort_statistics(path: Path) -> None:
    """Put the features of LeRobot's statistics into an order: theirs is another one in every process."""
    statistics = json.loads(path.read_text(encoding="utf-8"))
    ordered = {name: statistics[name] for name in sorted(statistics)}
    path.write_text(json.dumps(ordered, indent=4, ensure_ascii=False) + "\n", encoding="utf-8")


def _refuse_existing(root: Path) -> None:
    if root.exists() or root.is_symlink():
        raise DatasetError(f"dataset {root}: exists already; remove it or give another --root")


def _names(key: str, values: Float32[np.ndarray, "frames dims"], told: Recording) -> list[str] | None:
    """Names of a vector's numbers. Raises WorldError where the world has another number of them."""
    names = told.states.get(key)
    if names is None:
        return None
    if len(names) != values.shape[1]:
        raise WorldError(
            f"the recording names {len(names)} numbers of {key}, and the world shows {values.shape[1]}: "
            "correct its Recording"
        )
    return list(names)
