"""Arrays and devices as they must be: each function returns its argument for torch, or raises one line."""

import numbers
from typing import Any

import numpy as np
import torch
from jaxtyping import Int64
from torch import Tensor

from dpmacro.utils.checks import shown

__all__ = ["ArrayLike", "as_device", "as_lengths", "as_tensor", "as_whole_vector"]

ArrayLike = (
    Any  # a tensor, a NumPy array, a pandas object or nested sequences: what `as_tensor` turns into one
)

SMALL_FLOAT = 2  # bytes: CPUs lack operations for such numbers and smaller ones
UNSIGNED = (torch.uint16, torch.uint32, torch.uint64)  # likewise


def as_device(device: Any) -> torch.device:
    """The device that tensors can be put on; "cuda" becomes the card that it means.

    Raises ValueError for one that does not exist here, or holds no values.
    """
    if not isinstance(device, str | torch.device):
        raise ValueError(f"device is {shown(device)}: give its name, 'cpu' or 'cuda:0' say")
    try:
        probe = torch.zeros(1, device=device)
        probe.item()
    except (RuntimeError, AssertionError, TypeError, ValueError) as error:
        raise ValueError(f"device is {shown(str(device))}, which cannot be used here: give 'cpu'") from error
    return probe.device


def as_tensor(name: str, value: ArrayLike, dims: int, shape: str) -> Tensor:
    """A dense tensor of real numbers with so many dimensions, detached, none of them of length 0.

    `shape` says in words what is wanted. Types that lack operations become others: floating point of 16 or
    8 bits float32, truth values uint8, unsigned numbers of more than 8 bits int64.
    """
    found = value if isinstance(value, Tensor) else _from_array(name, value, shape)
    if found.layout != torch.strided or found.is_nested:
        layout = "nested tensors" if found.is_nested else found.layout
        raise ValueError(f"{name} are stored as {layout}: give a dense tensor, {shape}")
    if found.is_complex() or found.is_quantized:
        raise ValueError(f"{name} are of type {found.dtype}: give real numbers, {shape}")
    if found.is_meta:
        raise ValueError(f"{name} are on the device meta, which holds no values: give {shape}")
    if found.ndim != dims or 0 in found.shape:
        raise ValueError(f"{name} have shape {list(found.shape)}: give {shape}")
    found = found.detach().resolve_neg()
    if found.dtype == torch.bool:
        return found.to(torch.uint8)
    if found.is_floating_point() and found.itemsize <= SMALL_FLOAT:
        return found.float()
    if found.dtype not in UNSIGNED:
        return found
    whole = found.long()
    if found.dtype == torch.uint64 and bool((whole < 0).any()):
        raise ValueError(f"{name} hold {2**63} or more: give smaller numbers, {shape}")
    return whole


def as_whole_vector(
    name: str, value: ArrayLike, shape: str, *, least: int, most: int | None = None
) -> Int64[Tensor, " entries"]:
    """Whole numbers of `least` or more, and `most` or less, whatever type holds them."""
    found = as_tensor(name, value, 1, shape)
    if found.is_floating_point():
        wrong = (~((found.abs() < 2**63) & (found == found.round()))).nonzero()  # NaN is wrong, too
        if len(wrong):
            place = int(wrong[0])
            raise ValueError(f"{name}[{place}] is {found[place].item()}: give whole numbers, {shape}")
    whole = found.long()
    wrong = (whole < least if most is None else (whole < least) | (whole > most)).nonzero()
    if len(wrong):
        place = int(wrong[0])
        wanted = f"{least} or more" if most is None else f"{least} to {most}"
        raise ValueError(f"{name}[{place}] is {int(whole[place])}: give {wanted}")
    return whole


def as_lengths(value: ArrayLike, n_frames: int, framed: str) -> Int64[Tensor, " trajectories"]:
    """Frames of each trajectory, 1 or more, adding up to those of the argument `framed`; on the CPU."""
    found = as_whole_vector("lengths", value, "[trajectories], the frames of each", least=1).cpu()
    total = sum(found.tolist())
    if total != n_frames:
        raise ValueError(f"lengths add up to {total} frames but {framed} have {n_frames}: make them agree")
    return found


def _from_array(name: str, value: ArrayLike, shape: str) -> Tensor:
    if np.ma.is_masked(value):
        raise ValueError(f"{name} are masked in places: fill those or leave them out, {shape}")
    try:
        found = np.asarray(value)
        if found.dtype == object and all(isinstance(one, numbers.Real) for one in found.flat):
            found = np.array(found.tolist())  # numbers that pandas or a list keeps as objects
    except (TypeError, ValueError, RuntimeError) as error:
        raise ValueError(f"{name} cannot be an array ({shown(str(error))}): give {shape}") from error
    if found.dtype.kind not in "biuf":
        raise ValueError(
            f"{name} are {shown(value)}, of type {found.dtype}: give dense real numbers, {shape}"
        )
    native = np.dtype(np.float64) if found.dtype == np.longdouble else found.dtype.newbyteorder("=")
    found = found.astype(native, copy=False)
    if not found.flags.writeable or any(step < 0 or step % found.itemsize for step in found.strides):
        found = found.copy()  # torch warns of the first and refuses the others
    return torch.from_numpy(found)
