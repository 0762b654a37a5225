"""What a world gives in a run, checked as it is given: its code may be a stranger's, and give anything."""

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
from jaxtyping import UInt8

from dpmacro.worlds.base import Planner, WorldError
from dpmacro.worlds.making import blamed

__all__ = ["EXPERT", "Step", "act", "begin", "close", "render", "take"]

EXPERT = "the expert of the world"  # who is blamed where an expert raises


class Step(NamedTuple):
    """What a world gives for an action."""

    observation: Any
    reward: float
    terminated: bool
    truncated: bool
    info: dict[str, Any]


def begin(env: gym.Env, world: str, seed: int, when: str) -> tuple[Any, dict[str, Any]]:
    """The first observation of the run of a seed, and its info.

    Args:
        env: the world.
        world: its id, for messages.
        seed: of the run.
        when: the step and the run, in words, for messages.

    Raises WorldError where the world raises anything, or gives something else. So do all functions here.
    """
    with blamed(world, when):
        given = env.reset(seed=seed)
    observation, info = _parts(given, 2, "reset", world, when)
    return observation, _info(info, "reset", world, when)


def take(env: gym.Env, world: str, action: Any, when: str) -> Step:
    """What the world gives for an action."""
    with blamed(world, when):
        given = env.step(action)
    observation, reward, terminated, truncated, info = _parts(given, 5, "step", world, when)
    return Step(
        observation,
        _number(reward, world, when),
        _flag(terminated, "terminated", world, when),
        _flag(truncated, "truncated", world, when),
        _info(info, "step", world, when),
    )


def render(env: gym.Env, world: str, when: str) -> UInt8[np.ndarray, "height width 3"]:
    """The picture for people of what is there now."""
    with blamed(world, when):
        picture = np.asarray(env.render())
    if picture.dtype != np.uint8 or picture.ndim != 3 or picture.shape[2] != 3 or not picture.size:
        raise WorldError(
            f"the world {world} renders an array of shape {picture.shape} and type {picture.dtype}, {when}: "
            "a picture is uint8 [height, width, 3]; correct the world, or leave pictures out"
        )
    return picture


def act(planner: Planner, world: str, observation: Any, info: dict[str, Any], when: str) -> Any:
    """What an expert does, whose code comes with the world; GaveUp passes."""
    with blamed(world, when, EXPERT):
        return planner.act(observation, info)


def close(env: gym.Env, world: str) -> None:
    """Let go of the world."""
    with blamed(world, "as it was closed"):
        env.close()


def _parts(given: Any, count: int, method: str, world: str, when: str) -> tuple[Any, ...]:
    if not isinstance(given, tuple) or len(given) != count:
        what = f"a tuple of {len(given)}" if isinstance(given, tuple) else f"a {type(given).__name__}"
        raise WorldError(
            f"the world {world} gives {what} by {method}(), {when}: gymnasium's give a tuple of {count}; "
            "correct the world, or wrap an older one by shimmy"
        )
    return given


def _info(info: Any, method: str, world: str, when: str) -> dict[str, Any]:
    if not isinstance(info, Mapping):
        raise WorldError(
            f"the world {world} gives a {type(info).__name__} as the info of {method}(), {when}: it must be "
            "a dict; correct the world"
        )
    return dict(info)


def _number(reward: Any, world: str, when: str) -> float:
    number = _single(reward, "biuf")
    if number is None or not math.isfinite(number):
        raise WorldError(
            f"the world {world} gives {_shown(reward)} as reward, {when}: it must be a finite number; "
            "correct the world"
        )
    return float(number)


def _flag(value: Any, name: str, world: str, when: str) -> bool:
    flag = _single(value, "biu")
    if flag is None:
        raise WorldError(
            f"the world {world} gives {_shown(value)} as {name}, {when}: it must be true or false; correct "
            "the world"
        )
    return bool(flag)


def _single(value: Any, kinds: str) -> Any:
    """The one number in a value, of one of these kinds of numpy's types; None where it is something else."""
    try:
        values = np.asarray(value)
    except (ValueError, TypeError, RuntimeError):  # lists of lists of other lengths, tensors on a GPU
        return None
    return values.item() if values.size == 1 and values.dtype.kind in kinds else None


def _shown(value: Any) -> str:
    text = " ".join(repr(value).split())
    return text if len(text) <= 60 else f"{text[:57]}..."
