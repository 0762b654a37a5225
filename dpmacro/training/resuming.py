"""Trainings that go on where they were stopped, in LeRobot's manner.

A run that is not over has `checkpoints/last/pretrained_model/train_config.json`, its options, and beside that
what its stages found so far (`dpmacro.utils.stages`). Reading demonstrations and preparing features is done
anew; the policy and the segmentation are those of a run that nothing stopped, bit for bit.
"""

import hashlib
import json
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Int64
from torch import Tensor

from dpmacro.data.demonstrations import Demonstrations
from dpmacro.parallel import ALONE, Ranks
from dpmacro.training.options import TrainOptions
from dpmacro.training.run_folder import RunFolder, dated_folder, plain_options
from dpmacro.utils.stages import Stages

__all__ = ["check_unchanged", "kept_stages", "path_of"]

SAMPLED = 97  # one frame of so many stands for all, of what was observed
FREE = ("resume", "save_freq", "output_dir")  # options that change nothing of what is found


HOW = "--config_path=<run>/checkpoints/last/pretrained_model/train_config.json --resume=true"


def path_of(options: TrainOptions) -> Path:
    """The run's folder: the one given, or a dated one.

    Raises ValueError where a run is to go on and no folder is given, or none is there.
    """
    if options.resume and options.output_dir is None:
        raise ValueError(f"resume is true without a run to go on with: give {HOW}")
    path = options.output_dir or dated_folder(options.job_name or options.planner.type)
    if options.resume and not path.is_dir():
        raise ValueError(f"{path} is no folder: give {HOW}, and --output_dir=<run> if it was moved")
    return path


def check_unchanged(options: TrainOptions, folder: RunFolder) -> None:
    """Raise ValueError unless the run that goes on was begun in this folder, and with these options."""
    if not folder.begun.exists():
        raise ValueError(f"{folder.path} holds no run to go on with: give {HOW}, or leave resume out")
    before = _flat(json.loads(folder.begun.read_text()))
    given = json.loads(json.dumps(plain_options(options)))  # tuples become lists there
    for name, value in sorted(_flat(given).items()):
        if name not in FREE and value != before.get(name):
            raise ValueError(
                f"{name} is {value}, and {folder.path} was begun with {before.get(name)}: give {HOW} alone, "
                "or begin anew in another --output_dir"
            )


@contextmanager
def kept_stages(
    folder: RunFolder,
    options: TrainOptions,
    demonstrations: Demonstrations,
    given: Int64[Tensor, " frames"] | None,
    ranks: Ranks = ALONE,
) -> Iterator[None]:
    """Keep the stages of the block, in which the run is; begins the run unless that was done.

    A run that ends before anything is found leaves nothing. Ranks that do not lead write nothing.

    Raises ValueError where the run was begun with other demonstrations, or other labels of them, and where
    ranks have read different ones.
    """
    data = _digest(demonstrations, given)
    leading = ranks.told(data)
    with ranks.together():
        if data != leading:
            raise ValueError(
                f"{demonstrations.root} is not what rank 0 has read there: give all ranks the same"
            )
    if not ranks.leads:
        with Stages(folder.stages, options.save_freq, ranks):
            yield
        return
    if folder.begun.exists():
        if folder.data_digest != data:
            raise ValueError(
                f"{demonstrations.root} is not what {folder.path} was begun with: begin anew in another "
                "--output_dir"
            )
    else:
        folder.begin(plain_options(replace(options, output_dir=folder.path, resume=False)), data)
    try:
        with Stages(folder.stages, options.save_freq, ranks):
            yield
    except BaseException:
        if not any(folder.stages.iterdir()):
            folder.forget()
        raise


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
