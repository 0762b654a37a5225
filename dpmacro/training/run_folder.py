"""A training run's folder, in LeRobot's manner.

<output_dir>/tensorboard/                  events
<output_dir>/checkpoints/000300/           a round: pretrained_model/ and training_state/
<output_dir>/checkpoints/last              a link to the newest
"""

import json
import os
from datetime import datetime
from pathlib import Path
from typing import Any

from jaxtyping import Int64
from safetensors.torch import save_file
from torch import Tensor

from dpmacro.policy.policy import MacroPolicy
from dpmacro.utils.files import replacing

__all__ = ["RunFolder"]


class RunFolder:
    """Where a run writes; refuses a folder that already holds one.

    Raises ValueError where `path` exists and is not empty.
    """

    def __init__(self, path: Path) -> None:
        if path.exists() and (not path.is_dir() or any(path.iterdir())):
            raise ValueError(f"{path} exists: choose another --output_dir, or remove it")
        self.path = path

    @classmethod
    def dated(cls, job_name: str) -> "RunFolder":
        """outputs/train/<date>/<time>_<job>."""
        return cls(Path("outputs/train") / f"{datetime.now():%Y-%m-%d/%H-%M-%S}_{job_name}")

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
        return folder.with_name("last") / "pretrained_model"


def _write_json(path: Path, values: dict[str, Any]) -> None:
    with replacing(path) as temporary:
        temporary.write_text(json.dumps(values, indent=2) + "\n")
