"""What a world shows, by the keys that a policy was trained with."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from torch import Tensor

from dpmacro.features.base import Observation
from dpmacro.policy.config import PolicyConfig
from dpmacro.utils.checks import as_kind

__all__ = ["blank", "checked", "observed"]

IMAGES, PREFIX = "images.", "observation."


def observed(raw: Mapping[str, Any], config: PolicyConfig) -> dict[str, np.ndarray]:
    """The inputs of a policy in one observation of a world, images shrunk as the demonstrations' were.

    A world may use the policy's own keys, or gymnasium's as LeRobot reads them: `pixels`, one image or one
    by the camera's name, and `agent_pos` for the state. Raises ValueError for what is missing, and for
    images of another size than those of the demonstrations.
    """
    found = {}
    for key, one in config.inputs.items():
        value = _value(raw, key)
        if value is None:
            raise ValueError(f"the observation has no {key}: it has {', '.join(map(str, raw))}")
        value = np.asarray(value)
        if one.is_camera:
            value = config.image_transform.of(key).apply(value, "the observation")
        found[key] = value if value.dtype == np.uint8 or not one.shape else value.astype(np.float32)
    return found


def checked(observation: Mapping[str, Tensor], config: PolicyConfig, device: torch.device) -> Observation:
    """The observation. Raises ValueError where an input is missing or is not what the policy can look at."""
    as_kind("observation", observation, Mapping)
    for key, one in config.inputs.items():
        if key not in observation:
            raise ValueError(f"the observation has no {key}: it has {', '.join(map(str, observation))}")
        value = as_kind(key, observation[key], Tensor)
        found = tuple(value.shape[1:])
        if found != one.shape:
            shapes = ("x".join(map(str, shape)) for shape in (found, one.shape))
            raise ValueError("{} is {}: the policy was trained on {}".format(key, *shapes))
        if value.device != device:
            raise ValueError(f"{key} is on {value.device}: give it on {device}, where the policy is")
        if value.is_complex() or (value.is_floating_point() and not bool(value.isfinite().all())):
            raise ValueError(f"{key} is not finite in places: give finite numbers")
    return observation


def blank(config: PolicyConfig, device: torch.device) -> dict[str, Tensor]:
    """The inputs of a policy that sees nothing, one row: black images, vectors of 0, task 0."""
    kinds = {0: torch.int64, 1: torch.float32, 3: torch.uint8}
    return {
        key: torch.zeros(1, *one.shape, dtype=kinds[len(one.shape)], device=device)
        for key, one in config.inputs.items()
    }


def _value(raw: Mapping[str, Any], key: str) -> Any:
    name = key.removeprefix(PREFIX)
    for own in (key, name):
        if own in raw:
            return raw[own]
    if name == "image" or name.startswith(IMAGES):
        pixels = raw.get("pixels")
        return pixels.get(name.removeprefix(IMAGES)) if isinstance(pixels, Mapping) else pixels
    return raw.get("agent_pos") if name == "state" else None
