"""Discrete actions out of a LeRobot dataset's columns: numbers of any type, or one-hot vectors."""

from typing import Any

import numpy as np
from jaxtyping import Int64

from dpmacro.data.images import DatasetError
from dpmacro.data.lerobot.reader import StoredDataset

__all__ = ["discrete_actions"]

LARGEST_ACTION = 2**16  # a policy holds fewer, and larger numbers are of something else


def discrete_actions(
    store: StoredDataset, columns: dict[str, np.ndarray]
) -> tuple[Int64[np.ndarray, " frames"], tuple[str, ...]]:
    """Actions 0..M-1 and their M names, from `discrete_action` where there is one, else from `action`.

    Numbers have the names of the one-hot vectors beside them; without any their own, as text. Raises
    DatasetError where actions are continuous, negative, or no numbers.
    """
    where = f"dataset {store.root}"
    name = "discrete_action" if "discrete_action" in columns else "action"
    if name not in columns:
        raise DatasetError(f"{where}: has no action feature; dpmacro learns from actions")
    actions, vectors = columns[name], columns.get("action")
    if actions.ndim == 2 and actions.shape[1] > 1:
        return _from_one_hot(actions, where), _names(store.features[name], actions.shape[1])
    actions = _whole(actions.reshape(-1), f"{where}: {name}")
    if vectors is not None and vectors.ndim == 2 and vectors.shape[1] > 1 and np.isin(vectors, (0, 1)).all():
        names = _names(store.features["action"], vectors.shape[1])
    else:  # numbers without names: the statistics know actions that the chosen episodes lack
        largest = max(int(actions.max()), store.largest(name))
        if largest > LARGEST_ACTION:
            raise DatasetError(f"{where}: {name} goes up to {largest}; dpmacro needs actions numbered from 0")
        names = tuple(str(action) for action in range(largest + 1))
    outside = np.flatnonzero((actions < 0) | (actions >= len(names)))
    if len(outside):
        frame = outside[0]
        raise DatasetError(
            f"{where}: {name} {actions[frame]} of frame {frame} is outside 0..{len(names) - 1}"
        )
    return actions, names


def _whole(values: np.ndarray, what: str) -> Int64[np.ndarray, " frames"]:
    """Whole numbers, whatever their type."""
    if values.dtype.kind not in "biuf":
        raise DatasetError(
            f"{what} is of type {values.dtype} (first {values[0]!r}); dpmacro needs whole numbers"
        )
    if values.dtype.kind == "f" and not (np.isfinite(values) & (values == np.round(values))).all():
        raise DatasetError(f"{what}: continuous actions (first {values[0]:g}); dpmacro needs discrete ones")
    return values.astype(np.int64)


def _from_one_hot(vectors: np.ndarray, where: str) -> Int64[np.ndarray, " frames"]:
    """The position of the one in every row."""
    if not np.isin(vectors, (0, 1)).all():
        raise DatasetError(f"{where}: continuous actions (first {vectors[0]}); dpmacro needs discrete ones")
    wrong = np.flatnonzero(vectors.sum(axis=1) != 1)
    if len(wrong):
        raise DatasetError(f"{where}: action {vectors[wrong[0]]} of frame {wrong[0]} is not one-hot")
    return vectors.argmax(axis=1).astype(np.int64)


def _names(feature: dict[str, Any], count: int) -> tuple[str, ...]:
    """The names of a vector feature's entries, a list or LeRobot's {"motors": list}; else their numbers."""
    names = feature.get("names")
    if isinstance(names, dict):
        names = next(iter(names.values()), None)
    if isinstance(names, list) and len(names) == count:
        return tuple(str(name) for name in names)
    return tuple(str(action) for action in range(count))
