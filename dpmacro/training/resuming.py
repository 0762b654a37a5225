"""Trainings that go on where they were stopped, in LeRobot's manner.

A run that is not over has `checkpoints/last/pretrained_model/train_config.json`, its options, and beside that
what its stages found so far (`dpmacro.utils.stages`). Reading demonstrations and preparing features is done
anew; the policy and the segmentation are those of a run that nothing stopped, bit for bit.
"""

import hashlib
import json
from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Int64
from torch import Tensor

from dpmacro.data.demonstrations import Demonstrations
from dpmacro.training.options import TrainOptions
from dpmacro.training.run_folder import RunFolder, plain_options
from dpmacro.utils.stages import Stages

__all__ = ["folder_of", "stages_of"]

SAMPLED = 97  # one frame of so many stands for all, of what was observed
FREE = ("resume", "save_freq", "output_dir")  # options that change nothing of what is found


def folder_of(options: TrainOptions) -> RunFolder | None:
    """The run's folder, a new one or, with `resume`, that of the run to go on with; None where that is over.

    Raises ValueError where there is nothing to go on with, or it has other options than these.
    """
    if not options.resume:
        if options.output_dir:
            return RunFolder(options.output_dir)
        return RunFolder.dated(options.job_name or options.planner.type)
    how = "--config_path=<run>/checkpoints/last/pretrained_model/train_config.json --resume=true"
    if options.output_dir is None:
        raise ValueError(f"resume is true without a run to go on with: give {how}")
    folder = RunFolder(options.output_dir, resume=True)
    if folder.over:
        return None
    if not folder.begun.exists():
        raise ValueError(f"{folder.path} holds no run to go on with: give {how}, or leave resume out")
    known, given = json.loads(folder.begun.read_text()), plain_options(options)
    for name, value in sorted(_flat(given).items()):
        if name not in FREE and value != (before := _flat(known).get(name)):
            raise ValueError(
                f"{name} is {value}, and {folder.path} was begun with {before}: give {how} alone, or begin "
                "anew in another --output_dir"
            )
    return folder


def stages_of(
    folder: RunFolder,
    options: TrainOptions,
    demonstrations: Demonstrations,
    given: Int64[Tensor, " frames"] | None,
) -> Stages:
    """Where the run keeps its stages; to be entered for all of it. Begins the run unless that was done.

    Raises ValueError where the run was begun with other demonstrations, or other labels of them.
    """
    data = _digest(demonstrations, given)
    if folder.begun.exists():
        if folder.data_digest != data:
            raise ValueError(
                f"{demonstrations.root} is not what {folder.path} was begun with: begin anew in another "
                "--output_dir"
            )
    else:
        folder.begin(plain_options(replace(options, output_dir=folder.path, resume=False)), data)
    return Stages(folder.stages, options.save_freq)


def _flat(options: dict[str, Any], above: str = "") -> dict[str, Any]:
    """Options by their names on the command line."""
    flat: dict[str, Any] = {}
    for name, value in options.items():
        flat |= _flat(value, f"{above}{name}.") if isinstance(value, dict) else {above + name: value}
    return flat


def _digest(demonstrations: Demonstrations, given: Int64[Tensor, " frames"] | None) -> str:
    """Tells demonstrations apart: actions, lengths, labels, and one in `SAMPLED` frames of what was seen."""
    found = hashlib.sha256()
    parts = [demonstrations.actions, demonstrations.lengths]
    parts += [demonstrations.observations[key][::SAMPLED] for key in sorted(demonstrations.observations)]
    parts += [] if given is None else [given.numpy()]
    for part in parts:
        found.update(np.ascontiguousarray(part).tobytes())
    return found.hexdigest()
