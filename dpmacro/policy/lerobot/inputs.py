"""What LeRobot shows a policy, as the policy's own inputs."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import torch
from jaxtyping import Float32, Int64, UInt8
from torch import Tensor

from dpmacro.policy.config import InputConfig, PolicyConfig

__all__ = ["inputs_of"]

TASK = "task"  # in words, a string for every row
RENAME = """rename it, like --rename_map='{"observation.image": "observation.images.front"}'"""


def inputs_of(batch: Mapping[str, Any], config: PolicyConfig, device: torch.device) -> dict[str, Tensor]:
    """The inputs of a policy, a row for every environment, in one batch of observations.

    LeRobot's images are floats from 0 to 1, channels first; they become the bytes that they were, and are
    shrunk as the demonstrations' were. Its task is words; it becomes the number of the task.

    Args:
        batch: by LeRobot's keys: images [rows, 3, height, width], floats or bytes; vectors [rows, size]; the
            task, a string for every row.
        config: of the policy.
        device: of what is returned.

    Raises ValueError where an input is missing, of another type or size, or not finite, and for a task that
    the policy does not know.
    """
    found = {}
    for key, one in config.inputs.items():
        if not one.shape:
            found[key] = _task_numbers(batch, key, config.tasks).to(device)
            continue
        value = batch.get(key)
        if value is None:
            shown = ", ".join(name for name in batch if name.startswith("observation.")) or "none"
            raise ValueError(
                f"the policy sees {key}, which is not among the observations ({shown}): {RENAME}"
            )
        if not isinstance(value, Tensor):
            raise ValueError(f"{key} is a {type(value).__name__}: give a tensor, a row for every environment")
        value = _images(value, key, config) if one.is_camera else _vectors(value, key, one)
        found[key] = value.to(device)
    rows = {key: len(value) for key, value in found.items()}
    if len(set(rows.values())) > 1:
        raise ValueError(f"the observations have different numbers of rows ({rows}): give one an environment")
    return found


def _images(value: Tensor, key: str, config: PolicyConfig) -> UInt8[Tensor, "rows height width 3"]:
    if value.ndim != 4 or value.shape[1] != 3:
        raise ValueError(
            f"{key} has the shape {tuple(value.shape)}: give [rows, 3, height, width], channels first"
        )
    if value.is_floating_point():
        value = _bytes(value, key)
    elif value.dtype != torch.uint8:
        raise ValueError(f"{key} is of {value.dtype}: give floats from 0 to 1, or bytes")
    transform = config.image_transform.of(key)
    height, width = value.shape[2:]
    value = value.permute(0, 2, 3, 1)
    if transform.sized(width, height, key) == (width, height):
        return value
    images = np.ascontiguousarray(value.cpu().numpy())
    return torch.from_numpy(np.stack([transform.apply(image, key) for image in images]))


def _bytes(value: Tensor, key: str) -> UInt8[Tensor, "rows 3 height width"]:
    """The bytes that LeRobot divided by 255; that many floats tell them apart."""
    scaled = value * 255
    low, high = scaled.aminmax()
    if not (low > -0.5 and high < 255.5):  # nor where one is NaN
        raise ValueError(
            f"{key} has values from {float(low) / 255:.4g} to {float(high) / 255:.4g}: give floats from 0 "
            "to 1, or bytes"
        )
    return scaled.round_().to(torch.uint8)


def _vectors(value: Tensor, key: str, one: InputConfig) -> Float32[Tensor, "rows size"]:
    if value.shape[1:] != one.shape or value.ndim != 2:
        raise ValueError(
            f"{key} has the shape {tuple(value.shape)}: the policy was trained on [rows, {one.shape[0]}]"
        )
    if value.dtype in (torch.bool, torch.complex64, torch.complex128):
        raise ValueError(f"{key} is of {value.dtype}: give float32")
    value = value.to(torch.float32)
    if not bool(value.isfinite().all()):
        row, place = (~value.isfinite()).nonzero()[0].tolist()
        raise ValueError(
            f"{key} is {float(value[row, place])} in row {row} at {place}: give finite numbers alone"
        )
    return value


def _task_numbers(batch: Mapping[str, Any], key: str, tasks: Sequence[str]) -> Int64[Tensor, " rows"]:
    """The number of the task of every row."""
    told = batch.get(TASK)
    words = [told] if isinstance(told, str) else told
    if not isinstance(words, list | tuple):
        raise ValueError(
            f"the policy sees {key}, and {TASK} is {told!r}: give the task of every row in words"
        )
    known = {task: number for number, task in enumerate(tasks)}
    unknown = [task for task in words if task not in known]
    if unknown:
        raise ValueError(
            f"the task is {unknown[0]!r}: the policy knows {', '.join(map(repr, tasks)) or 'none'}"
        )
    return torch.tensor([known[task] for task in words])
