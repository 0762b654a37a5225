"""True labels out of a LeRobot dataset's columns, for metrics only."""

import re

import numpy as np
from jaxtyping import Int64

from dpmacro.data.images import DatasetError
from dpmacro.data.lerobot.reader import StoredDataset

__all__ = ["choose_truth", "true_labels"]

COUNTERS = ("frame_index", "episode_index", "index")  # of LeRobot's, which number frames
MOST_CLASSES = 1000  # of labels; a column with more is of something else, as times or identifiers


def choose_truth(store: StoredDataset, truth: str | None) -> str | None:
    """The column of true labels; None where neither the caller nor the data names one."""
    whole = [name for name, one in store.features.items() if name not in COUNTERS and _may_be_labels(one)]
    if truth is None:
        return next((name for name in (*store.truth, "phase", "subgoal") if name in whole), None)
    if truth == "none":
        return None
    if truth not in whole:
        raise DatasetError(
            f"dataset {store.root}: no integer column {truth!r} to be the truth, nor one of text; it has "
            f"{', '.join(whole)}"
        )
    return truth


def true_labels(
    store: StoredDataset, truth: str, column: np.ndarray
) -> tuple[Int64[np.ndarray, " frames"], tuple[str, ...]]:
    """The labels of a column, 0..K-1, and the names of the K classes.

    Integers are labels as they are, their numbers as text where the dataset names none; where they go beyond
    MOST_CLASSES, and where they are text, those that occur are numbered in their order. Raises DatasetError
    for negative labels and for more than MOST_CLASSES.
    """
    values, where = column.reshape(-1), f"dataset {store.root}: {truth}"
    if len(values) != len(column):
        raise DatasetError(f"{where} has {column.shape[1]} values a frame; name a column of one as truth")
    if values.dtype.kind not in "biuO":
        raise DatasetError(
            f"{where} is of type {values.dtype}; name a column of whole numbers or text as truth"
        )
    if values.dtype.kind in "bi" and values.min() < 0:
        frame = int((values < 0).argmax())
        raise DatasetError(
            f"{where} {values[frame]} of frame {frame} is negative; name another column as truth, or none"
        )
    named = tuple(store.truth.get(truth, ()))
    largest = (
        -1 if values.dtype.kind == "O" else max(int(values.max()), -1 if named else store.largest(truth))
    )
    if values.dtype.kind != "O" and largest < MOST_CLASSES:
        return values.astype(np.int64), named + tuple(map(str, range(len(named), largest + 1)))
    classes, labels = np.unique(values, return_inverse=True)
    if len(classes) > MOST_CLASSES:
        raise DatasetError(
            f"{where} has {len(classes)} different labels, from {classes[0]} to {classes[-1]}; name "
            "another column "
            "as truth, or none"
        )
    return labels.reshape(-1).astype(np.int64), tuple(map(str, classes))


def _may_be_labels(feature: dict) -> bool:
    shape = feature.get("shape")
    kind = re.fullmatch(r"u?int\d+|string|str|large_string", feature["dtype"])
    return bool(kind) and (shape is None or list(shape) in ([], [1]))
