"""A training run's folder, in LeRobot's manner.

<output_dir>/tensorboard/                  events
<output_dir>/checkpoints/000000/           of a run that is not over: its options, and what it found so far
<output_dir>/checkpoints/000300/           a round: pretrained_model/ and training_state/
<output_dir>/checkpoints/last              a link to the newest
"""

import json
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from datetime import datetime
from pathlib import Path
from typing import Any

from jaxtyping import Int64
from safetensors.torch import save_file
from torch import Tensor

from dpmacro.policy.policy import MacroPolicy
from dpmacro.utils.claims import CLAIM, claimed
from dpmacro.utils.files import replacing

__all__ = ["RunFolder", "dated_folder", "plain_options"]

OWN = ("tensorboard", "checkpoints", "iterations")  # what a run puts there before anything is found


def dated_folder(job_name: str) -> Path:
    """outputs/train/<date>/<time>_<job>."""
    return Path("outputs/train") / f"{datetime.now():%Y-%m-%d/%H-%M-%S}_{job_name}"


class RunFolder:
    """Where a run writes; refuses a folder that already holds one, unless the run goes on.

    Args:
        path: the folder.
        resume: whether a run goes on that is there.

    Raises ValueError where `path` exists and is not empty, but for `resume`; where it is a file.
    """

    def __init__(self, path: Path, resume: bool = False) -> None:
        self.path = path
        if path.exists() and (not path.is_dir() or (not resume and _contents(path))):
            going_on = f", go on with it by {self.going_on}" if self.begun.exists() else ""
            raise ValueError(f"{path} exists: choose another --output_dir{going_on}, or remove it")

    @classmethod
    def inner(cls, path: Path) -> "RunFolder":
        """A run that is a part of another, in that one's folder; it goes on where it is there."""
        path.mkdir(parents=True, exist_ok=True)
        return cls(path, resume=True)

    @classmethod
    @contextmanager
    def claimed(cls, path: Path, resume: bool = False) -> Iterator["RunFolder"]:
        """The same for a run that alone writes to the folder until the block is left.

        Raises ValueError where another process writes to the folder.
        """
        with claimed(path):
            yield cls(path, resume)

    @property
    def last(self) -> Path:
        """The folder of the newest policy."""
        return self.path / "checkpoints" / "last" / "pretrained_model"

    @property
    def tensorboard(self) -> Path:
        """Where TensorBoard events go."""
        return self.path / "tensorboard"

    @property
    def begun(self) -> Path:
        """Options of a run that is not over."""
        return self._unfinished / "pretrained_model" / "train_config.json"

    @property
    def going_on(self) -> str:
        """The options of train.py by which such a run goes on."""
        return f"--config_path={self.last / 'train_config.json'} --resume=true"

    @property
    def stages(self) -> Path:
        """Where such a run keeps what its stages found."""
        return self._unfinished / "training_state" / "stages"

    @property
    def data_digest(self) -> str:
        """What tells the demonstrations of such a run from others."""
        return str(json.loads(self._data.read_text())["sha256"])

    @property
    def over(self) -> bool:
        """Whether a run has ended here."""
        return (self.last / "model.safetensors").exists() and not self.begun.exists()

    @property
    def figures(self) -> Path:
        """Where pictures go."""
        return self.path / "figures"

    def saved(self) -> str:
        """What is safe where a run ends early, in words."""
        if (self.last / "model.safetensors").exists():
            return f"the policy is safe in {self.last}"
        if self.begun.exists():
            return f"what was found so far is safe: train.py {self.going_on} goes on"
        return "no policy is saved yet"

    def begin(self, options: dict[str, Any], data_digest: str) -> None:
        """Write down what a run begins with, so that it can go on if it is stopped."""
        _write_json(self._data, {"sha256": data_digest})
        _write_json(self.begun, options)
        self._link(self._unfinished)

    def forget(self) -> None:
        """Remove what a run has left that ends before anything is found."""
        for name in OWN:
            shutil.rmtree(self.path / name, ignore_errors=True)

    def end(self) -> None:
        """Remove what was kept to go on with: the run is over."""
        self.begun.unlink(missing_ok=True)  # first, since it alone says that the run is not over
        shutil.rmtree(self._unfinished, ignore_errors=True)

    def checkpoint(
        self,
        rounds: int,
        policy: MacroPolicy,
        options: dict[str, Any],
        labels: Int64[Tensor, " frames"],
        lengths: Int64[Tensor, " trajectories"],
    ) -> Path:
        """Save a policy, its training options and the segmentation; returns the pretrained_model folder.

        `checkpoints/last` points at it once everything is written.
        """
        folder = self.path / "checkpoints" / f"{rounds:06d}"
        pretrained, state = folder / "pretrained_model", folder / "training_state"
        policy.save(pretrained)
        _write_json(pretrained / "train_config.json", options)
        _write_json(state / "training_step.json", {"step": rounds})
        with replacing(state / "segmentation.safetensors") as path:
            save_file({"labels": labels.cpu().contiguous(), "lengths": lengths.cpu().contiguous()}, path)
        return self._link(folder) / "pretrained_model"

    @property
    def _unfinished(self) -> Path:
        return self.path / "checkpoints" / "000000"

    @property
    def _data(self) -> Path:
        return self._unfinished / "training_state" / "data.json"

    def _link(self, folder: Path) -> Path:
        """Let `checkpoints/last` point at a folder; returns that link."""
        link, last = folder.with_name(f".last-{os.getpid()}"), folder.with_name("last")
        link.symlink_to(folder.name)
        link.replace(last)
        return last


def _contents(folder: Path) -> list[Path]:
    return [path for path in folder.iterdir() if path.name != CLAIM]


def _write_json(path: Path, values: dict[str, Any]) -> None:
    with replacing(path) as temporary:
        temporary.write_text(json.dumps(values, indent=2) + "\n")


def plain_options(options: Any) -> dict[str, Any]:
    """Options as JSON holds them: paths become strings."""
    return _plain(asdict(options))


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {name: _plain(part) for name, part in value.items()}
    return str(value) if isinstance(value, Path) else value
