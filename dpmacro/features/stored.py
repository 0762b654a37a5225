"""Columns out of a file: whether they look at what there is, and at no more than memory holds.

An encoder that this package made is sound. One that a file describes may name pixels outside the image or
frames of a year ago: silently it would look at others, or fill memory.
"""

import math
from collections.abc import Callable, Mapping
from typing import Any

import torch
from torch import Tensor

from dpmacro.features.base import Encoder
from dpmacro.features.encoders.camera import CameraEncoder
from dpmacro.features.encoders.concat import Concat
from dpmacro.features.encoders.pixels import Pixels
from dpmacro.features.encoders.rectangles import CHANNELS, Rectangles
from dpmacro.features.encoders.state import NONE, State
from dpmacro.features.encoders.task import Task
from dpmacro.features.levels import LEVELS
from dpmacro.features.quantising import Quantiser
from dpmacro.utils.checks import as_count, as_text, shown

__all__ = ["check_encoder", "check_quantiser", "check_range", "check_tensor"]

MOST_LAG = 10_000  # frames that a change of a state may be over
MOST_KEPT = 2**26  # numbers of a state that are remembered for it


def check_tensor(name: str, value: Tensor, types: tuple[torch.dtype, ...], *shape: int | None) -> None:
    """Raise ValueError where a tensor has another type or shape; None is any size."""
    wanted = f"[{', '.join('any' if size is None else str(size) for size in shape)}]"
    fits = value.ndim == len(shape) and all(
        own in (size, None) for own, size in zip(shape, value.shape, strict=True)
    )
    if value.dtype not in types or not fits:
        raise ValueError(
            f"{name} is {value.dtype} of shape {shown(list(value.shape))}: give {types[0]} of shape {wanted}"
        )
    if value.is_floating_point() and not bool(value.isfinite().all()):
        raise ValueError(f"{name} holds a number that is not finite: give finite ones")


def check_range(name: str, value: Tensor, least: int, most: int) -> None:
    """Raise ValueError for whole numbers below `least` or above `most`."""
    wrong = value[(value < least) | (value > most)]
    if len(wrong):
        raise ValueError(f"{name} holds {int(wrong[0])}: give {least} to {most}")


def check_encoder(encoder: Encoder, shapes: Mapping[str, tuple[int, ...]]) -> None:
    """Raise ValueError where columns look beyond what is seen.

    Args:
        encoder: of one part, or of several side by side.
        shapes: of a frame of every input, by its key.
    """
    parts = encoder.parts if isinstance(encoder, Concat) else (encoder,)
    if not parts:
        raise ValueError("an encoder has no parts: give one at least")
    keys: set[str] = set()
    for part in parts:
        key = as_text(
            "the key of an encoder", part.camera if isinstance(part, CameraEncoder) else part.keys[0]
        )
        if key not in shapes or key in keys:
            where = "twice among the encoders" if key in keys else "no input"
            raise ValueError(f"{shown(key)} is {where}: give each of {', '.join(shapes)} once at most")
        keys.add(key)
        _CHECKS[type(part)](part, shapes[key])


def check_quantiser(quantiser: Quantiser, encoder: Encoder) -> None:
    """Raise ValueError where cuts are not those of the encoder's columns, or do not ascend."""
    cuts = quantiser.cuts
    fractions = (torch.float32, torch.float64)
    types = (torch.int32, torch.int64, *fractions) if encoder.dtype == torch.int32 else fractions
    check_tensor("cuts", cuts, types, encoder.count, LEVELS - 1)
    if bool((cuts[:, 1:] < cuts[:, :-1]).any()):
        raise ValueError("cuts do not ascend: train the policy again")


def _check_camera(part: CameraEncoder, shape: tuple[int, ...]) -> None:
    for name in ("height", "width"):
        as_count(f"{name} of an encoder", getattr(part, name))
    if shape != (part.height, part.width, 3):
        raise ValueError(
            f"an encoder of {part.camera} is for {part.width}x{part.height} pixels: its input is {shape}"
        )


def _check_rectangles(part: Rectangles, shape: tuple[int, ...]) -> None:
    _check_camera(part, shape)
    for name, boxes in (("first", part.first), ("second", part.second)):
        check_tensor(name, boxes, (torch.int32,), len(part.first) if part.first.ndim else None, 5)
        channel, top, left, tall, wide = boxes.long().unbind(1)
        check_range(f"the channel in {name}", channel, 0, len(CHANNELS) - 1)
        for side, start, size, most in (
            ("height", top, tall, part.height),
            ("width", left, wide, part.width),
        ):
            check_range(f"the start of a {side} in {name}", start, 0, most)
            check_range(f"a {side} in {name}", size, 0, most)
            check_range(f"the end of a {side} in {name}", start + size, 0, most)


def _check_pixels(part: Pixels, shape: tuple[int, ...]) -> None:
    _check_camera(part, shape)
    check_tensor("places", part.places, (torch.int64,), None)
    check_range("places", part.places, 0, 6 * part.height * part.width - 1)


def _check_state(part: State, shape: tuple[int, ...]) -> None:
    for place, name in enumerate(part.dimensions):
        as_text(f"dimensions[{place}]", name)
    size = len(part.dimensions)
    if shape != (size,):
        raise ValueError(f"an encoder of {part.key} is for {size} numbers: its input is {shape}")
    check_tensor("table", part.table, (torch.int32,), None, 3)
    first, second, lag = part.table.long().unbind(1)
    check_range("the first number in table", first, 0, size - 1)
    check_range("the second number in table", second, NONE, size - 1)
    check_range("frames back in table", lag, 0, min(MOST_LAG, MOST_KEPT // math.prod(shape)))


def _check_task(part: Task, shape: tuple[int, ...]) -> None:
    if shape != ():
        raise ValueError(f"an encoder of {part.key} is for a task's number: its input is {shape}")
    check_tensor("tasks", part.tasks, (torch.int64,), None)


_CHECKS: dict[type, Callable[[Any, tuple[int, ...]], None]] = {
    Rectangles: _check_rectangles,
    Pixels: _check_pixels,
    State: _check_state,
    Task: _check_task,
}
