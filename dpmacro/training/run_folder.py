"""A training run's folder, in LeRobot's manner.

<output_dir>/tensorboard/                  events
<output_dir>/checkpoints/000300/           a round: pretrained_model/ and training_state/
<output_dir>/checkpoints/last              a link to the newest
"""

import json
import os
import shutil
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path
from typing import Any

from jaxtyping import Int64
from safetensors.torch import save_file
from torch import Tensor

from dpmacro.policy.policy import MacroPolicy
from dpmacro.utils.claims import CLAIM, claimed
from dpmacro.utils.files import replacing

__all__ = ["RunFolder", "dated_folder"]

OWN = ("tensorboard", "figures", "checkpoints", "iterations")  # what a run puts into its folder


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
        if path.exists() and (not path.is_dir() or (not resume and _contents(path))):
            raise ValueError(f"{path} exists: choose another --output_dir, or remove it")
        self.path = path

    @classmethod
    @contextmanager
    def claimed(cls, path: Path, resume: bool = False) -> Iterator["RunFolder"]:
        """The same for a run that alone writes to the folder until the block is left.

        Where a run was killed before it saved a policy, what it wrote is removed, with a warning, unless
        `resume`.

        Raises ValueError where another process writes to the folder.
        """
        with claimed(path) as claim:
            folder = cls(path, resume=True)
            if claim.dead is not None and not resume and not folder.last.exists():
                folder._clear()
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
    def figures(self) -> Path:
        """Where pictures go."""
        return self.path / "figures"

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
        link = folder.with_name(f".last-{os.getpid()}")
        link.symlink_to(folder.name)
        link.replace(folder.with_name("last"))
        return self.last

    def saved(self) -> str:
        """What is safe where a run ends early, in words."""
        return f"the policy is safe in {self.last}" if self.last.exists() else "no policy is saved yet"

    def _clear(self) -> None:
        """Remove what a run leaves that was killed before it saved a policy."""
        left = [path for path in _contents(self.path) if path.name in OWN and path.is_dir()]
        for path in left:
            shutil.rmtree(path)
        if left:
            names = ", ".join(sorted(path.name for path in left))
            warnings.warn(f"{self.path}: removed {names} of the killed run, without a policy", stacklevel=2)


def _contents(folder: Path) -> list[Path]:
    return [path for path in folder.iterdir() if path.name != CLAIM]


def _write_json(path: Path, values: dict[str, Any]) -> None:
    with replacing(path) as temporary:
        temporary.write_text(json.dumps(values, indent=2) + "\n")
