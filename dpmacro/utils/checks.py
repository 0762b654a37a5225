"""Arguments as they must be: each function returns its argument, or raises a ValueError that names it."""

import math
import numbers
from typing import Any

import numpy as np
import torch
from torch import Tensor

__all__ = ["as_count", "as_flag", "as_number", "as_tensor", "as_whole_vector"]


def as_count(name: str, value: Any, least: int = 1, most: int | None = None) -> int:
    """A whole number of `least` or more, and `most` or less."""
    upper = "" if most is None else f" and up to {most}"
    if isinstance(value, bool | np.bool_) or not isinstance(value, numbers.Integral):
        raise ValueError(f"{name} is {value!r}: give a whole number, {least} or more{upper}")
    whole = int(value)
    if whole < least or (most is not None and whole > most):
        raise ValueError(f"{name} is {value}: give {least} or more{upper}")
    return whole


def as_flag(name: str, value: Any) -> bool:
    """True or False."""
    if not isinstance(value, bool | np.bool_):
        raise ValueError(f"{name} is {value!r}: give True or False")
    return bool(value)


def as_number(name: str, value: Any, above: float, most: float = math.inf) -> float:
    """A finite number above `above` and up to `most`."""
    upper = "" if most == math.inf else f" and up to {most:g}"
    if isinstance(value, bool | np.bool_) or not isinstance(value, numbers.Real):
        raise ValueError(f"{name} is {value!r}: give a number above {above:g}{upper}")
    number = float(value)
    if not (above < number <= most and math.isfinite(number)):
        raise ValueError(f"{name} is {value}: give a number above {above:g}{upper}")
    return number


def as_tensor(name: str, value: Any, dims: int, shape: str) -> Tensor:
    """A dense tensor of real numbers with so many dimensions, detached, none of them of length 0.

    `shape` says in words what is wanted. float16 and bfloat16 become float32.
    """
    try:
        found = value if isinstance(value, Tensor) else torch.as_tensor(np.asarray(value))
    except (TypeError, ValueError, RuntimeError) as error:
        raise ValueError(f"{name} cannot be a tensor ({error}): give {shape}") from error
    if found.layout != torch.strided:
        raise ValueError(f"{name} are stored as {found.layout}: give a dense {shape}")
    if found.is_complex() or found.is_quantized:
        raise ValueError(f"{name} are of type {found.dtype}: give real numbers, {shape}")
    if found.ndim != dims or 0 in found.shape:
        raise ValueError(f"{name} have shape {list(found.shape)}: give {shape}")
    found = found.detach()
    return found.float() if found.dtype in (torch.float16, torch.bfloat16) else found


def as_whole_vector(name: str, value: Any, least: int, shape: str) -> Tensor:
    """Whole numbers of `least` or more as int64, whatever type holds them."""
    found = as_tensor(name, value, 1, shape)
    if found.is_floating_point():
        wrong = (~(found.isfinite() & (found == found.round()))).nonzero()
        if len(wrong):
            place = int(wrong[0])
            raise ValueError(f"{name}[{place}] is {float(found[place])}: give whole numbers, {shape}")
    whole = found.long()
    if int(whole.min()) < least:
        place = int(whole.argmin())
        raise ValueError(f"{name}[{place}] is {int(whole[place])}: give {least} or more")
    return whole
