"""Runs of an evaluation as lines of JSON, and back, each number as it was."""

import base64
import binascii
import math
import zlib
from collections.abc import Mapping
from typing import Any

import numpy as np

from dpmacro.worlds.base import Episode

__all__ = ["episode_of", "line_of"]

STEPS = 10**8  # of a run, at most
BYTES = 2**28  # of one of its arrays, at most
ACTIONS = ("uint8", "int64", "float32")


def line_of(episode: Episode) -> dict[str, Any]:
    """What JSON holds of a run; arrays are packed by zlib and base64."""
    return {
        "seed": episode.seed,
        "outcome": episode.outcome,
        "steps": episode.steps,
        "reward": episode.reward,
        "loop": episode.loop,
        "period": episode.period,
        "clipped": episode.clipped,
        "first_success": episode.first_success,
        "success_by": episode.success_by,
        "actions": _packed(episode.actions),
        "phases": _packed(episode.phases),
        "macros": _packed(episode.macros),
        "rewards": _packed(episode.rewards),
        "positions": None if episode.positions is None else _packed(episode.positions),
    }


def episode_of(line: Mapping[str, Any]) -> Episode:
    """The run that `line_of` made a line of. Raises ValueError, which names the field, for any other line."""
    steps = _number(line, "steps", 1, STEPS)
    action_shape = _shape_of(line)
    positions = line.get("positions")
    first = line.get("first_success")
    return Episode(
        seed=_number(line, "seed", 0, 2**63),
        outcome=_text(line, "outcome"),
        actions=_unpacked(line, "actions", ACTIONS, (steps, *action_shape)),
        phases=_unpacked(line, "phases", ("int8",), (steps,)),
        macros=_unpacked(line, "macros", ("int8",), (steps,)),
        rewards=_unpacked(line, "rewards", ("float32",), (steps,)),
        loop=_number(line, "loop", 0, STEPS),
        positions=None if positions is None else _unpacked(line, "positions", ("float32",), (steps, 2)),
        period=_number(line, "period", 0, STEPS),
        clipped=_number(line, "clipped", 0, steps),
        first_success=None if first is None else _number(line, "first_success", 0, steps - 1),
        success_by=_text(line, "success_by"),
    )


def _packed(values: np.ndarray) -> dict[str, Any]:
    data = zlib.compress(np.ascontiguousarray(values).tobytes(), 1)
    return {
        "type": str(values.dtype),
        "shape": list(values.shape),
        "zlib": base64.b64encode(data).decode("ascii"),
    }


def _shape_of(line: Mapping[str, Any]) -> tuple[int, ...]:
    """The shape of one action: () for classes, (dims,) for vectors."""
    actions = line.get("actions")
    shape = actions.get("shape") if isinstance(actions, Mapping) else None
    if not isinstance(shape, list) or len(shape) not in (1, 2):
        raise ValueError("actions have no shape of one or two numbers")
    return tuple(_number({"actions.shape": size}, "actions.shape", 1, STEPS) for size in shape[1:])


def _unpacked(
    line: Mapping[str, Any], name: str, types: tuple[str, ...], shape: tuple[int, ...]
) -> np.ndarray:
    packed = line.get(name)
    if not isinstance(packed, Mapping) or packed.get("type") not in types or packed.get("shape") != [*shape]:
        raise ValueError(f"{name} are no {' or '.join(types)} of the shape {list(shape)}")
    kind = np.dtype(packed["type"])
    size = math.prod(shape) * kind.itemsize
    text = packed.get("zlib")
    if size > BYTES or not isinstance(text, str):
        raise ValueError(f"{name} are {size:,} bytes in a {type(text).__name__}; {BYTES:,} may be, in a text")
    unpacking = zlib.decompressobj()
    try:
        data = unpacking.decompress(base64.b64decode(text, validate=True), size)
    except (zlib.error, binascii.Error, ValueError) as error:
        raise ValueError(f"{name} cannot be unpacked ({error})") from error
    if len(data) != size:
        raise ValueError(f"{name} have {len(data):,} bytes and not {size:,}")
    return np.frombuffer(data, kind).reshape(shape).copy()


def _number(line: Mapping[str, Any], name: str, least: int, most: int) -> int:
    value = line.get(name)
    if type(value) is not int or not least <= value <= most:
        raise ValueError(f"{name} is {str(value)[:60]!r}: a whole number from {least} to {most} was written")
    return value


def _text(line: Mapping[str, Any], name: str) -> str:
    value = line.get(name)
    if not isinstance(value, str):
        raise ValueError(f"{name} is {str(value)[:60]!r}: a text was written")
    return value
