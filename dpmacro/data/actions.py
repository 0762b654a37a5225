"""Actions out of a LeRobot dataset's columns: classes, or vectors of numbers."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float32, Int64

from dpmacro.data.images import DatasetError
from dpmacro.data.lerobot.reader import StoredDataset
from dpmacro.data.names import entry_names

__all__ = ["BOOKKEEPING", "Actions", "actions_of", "choose_action", "finite"]

Actions = Int64[np.ndarray, " frames"] | Float32[np.ndarray, "frames dims"]

BOOKKEEPING = ("index", "frame_index", "episode_index", "timestamp", "task_index")
LARGEST_ACTION = 2**16  # a policy holds fewer, and larger numbers are of something else
LARGEST_FLOAT = 255  # whole numbers stored as fractions are classes up to here, counts of something beyond


def choose_action(store: StoredDataset, action: str | Sequence[str] | None) -> list[str]:
    """The features that make up the action.

    By default `discrete_action`, else `action`, else `actions`, else all that begin with `action.`. Raises
    DatasetError where there is none, for one that does not exist and for one of BOOKKEEPING.
    """
    if action is not None and not action:
        raise DatasetError(f"dataset {store.root}: action names no feature; name one, or leave it out")
    names = [action] if isinstance(action, str) else list(action or [])
    counting = [name for name in names if name in BOOKKEEPING]
    if counting:
        raise DatasetError(
            f"dataset {store.root}: {counting[0]} numbers frames, so it is no action; name another feature"
        )
    missing = [name for name in names if name not in store.features]
    if missing:
        raise DatasetError(
            f"dataset {store.root}: has no feature {missing[0]!r} to be the action; it has "
            f"{', '.join(store.features)}"
        )
    if names:
        return names
    for name in ("discrete_action", "action", "actions"):
        if name in store.features:
            return [name]
    parts = [name for name in store.features if name.startswith("action.")]
    if not parts:
        raise DatasetError(
            f"dataset {store.root}: has no action feature; name the one, or those, to learn from: "
            "--dataset.action="
        )
    return parts


def actions_of(
    store: StoredDataset, names: Sequence[str], columns: dict[str, np.ndarray]
) -> tuple[Actions, tuple[str, ...]]:
    """The actions in the named columns: classes 0..M-1 with M names, or vectors with a name per dimension.

    Classes are `discrete_action`, integers, whole numbers up to LARGEST_FLOAT, and vectors of at least two
    numbers of which one is 1 and the others 0 at every frame; everything else is a vector. Numbers have the
    names of the one-hot vectors in `action` beside them; without any their own, as text. Raises DatasetError
    for what is no number, not finite, or no class from 0 on.
    """
    where = f"dataset {store.root}"
    for name in names:
        if columns[name].dtype.kind not in "biuf":
            raise DatasetError(
                f"{where}: {name} is of type {columns[name].dtype} (first {columns[name].flat[0]!r}); "
                "dpmacro needs "
                "numbers"
            )
        finite(columns[name], f"{where}: {name}")
    if len(names) > 1:
        return _joined(store, names, columns)
    (name,), values = names, columns[names[0]]
    if values.ndim == 2 and values.shape[1] > 1:
        labels = entry_names(store.features[name], values.shape[1])
        return (
            values.argmax(axis=1).astype(np.int64) if _is_one_hot(values) else values.astype(np.float32)
        ), labels
    values = values.reshape(-1)
    if name == "discrete_action" or values.dtype.kind in "biu" or _are_classes(values):
        return _classes(store, name, values, columns.get("action"))
    return values.astype(np.float32)[:, None], entry_names(store.features[name], 1)


def finite(values: np.ndarray, what: str) -> None:
    """Raise DatasetError, beginning with `what`, for the first value that is not a finite float32."""
    with np.errstate(over="ignore"):
        wrong = np.flatnonzero(~np.isfinite(values.astype(np.float32)).reshape(len(values), -1))
    if wrong.size:
        frame, dim = divmod(int(wrong[0]), int(np.prod(values.shape[1:], dtype=int)))
        raise DatasetError(
            f"{what} is {values.reshape(len(values), -1)[frame, dim]} at frame {frame}, number {dim}; "
            "correct it, or "
            "leave out the episode by --dataset.episodes"
        )


def _joined(
    store: StoredDataset, names: Sequence[str], columns: dict[str, np.ndarray]
) -> tuple[Float32[np.ndarray, "frames dims"], tuple[str, ...]]:
    """Vectors of the numbers of several features, each with its feature's name."""
    labels = []
    for name in names:
        short, size = name.removeprefix("action."), columns[name].reshape(len(columns[name]), -1).shape[1]
        labels += (
            [short]
            if size == 1
            else [f"{short}.{entry}" for entry in entry_names(store.features[name], size)]
        )
    pieces = [columns[name].reshape(len(columns[name]), -1).astype(np.float32) for name in names]
    return np.concatenate(pieces, axis=1), tuple(labels)


def _classes(
    store: StoredDataset, name: str, values: np.ndarray, vectors: np.ndarray | None
) -> tuple[Int64[np.ndarray, " frames"], tuple[str, ...]]:
    where = f"dataset {store.root}"
    if values.dtype.kind == "f" and not (values == np.round(values)).all():
        raise DatasetError(f"{where}: {name} is {values[0]:g} at frame 0; it must hold whole numbers")
    actions = values.astype(np.int64)
    if vectors is not None and vectors.ndim == 2 and vectors.shape[1] > 1 and np.isin(vectors, (0, 1)).all():
        names = entry_names(store.features["action"], vectors.shape[1])
    else:  # numbers without names: the statistics know actions that the chosen episodes lack
        largest = max(int(actions.max()), store.largest(name))
        if largest > LARGEST_ACTION:
            raise DatasetError(f"{where}: {name} goes up to {largest}; dpmacro needs actions numbered from 0")
        names = tuple(str(action) for action in range(largest + 1))
    outside = np.flatnonzero((actions < 0) | (actions >= len(names)))
    if len(outside):
        frame = outside[0]
        raise DatasetError(
            f"{where}: {name} {actions[frame]} of frame {frame} is outside 0..{len(names) - 1}; number "
            "actions "
            "from 0, or store them as float32 to have them learned as numbers"
        )
    return actions, names


def _are_classes(values: np.ndarray) -> bool:
    """Whether fractions are whole numbers from 0 on, few enough to be classes."""
    return bool(((values == np.round(values)) & (values >= 0) & (values <= LARGEST_FLOAT)).all())


def _is_one_hot(vectors: np.ndarray) -> bool:
    return bool(np.isin(vectors, (0, 1)).all() and (vectors.sum(axis=1) == 1).all())
