"""Which features of a LeRobot dataset are what the policy sees: cameras, state-like vectors, the task."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32, Int64

from dpmacro.data.actions import BOOKKEEPING, finite
from dpmacro.data.images import DatasetError, FrameBuffer, ImageTransform, refuse_too_many
from dpmacro.data.lerobot.frames import TOLERANCE, fill, is_depth, picture
from dpmacro.data.lerobot.layout import StoredEpisode
from dpmacro.data.lerobot.reader import StoredDataset
from dpmacro.data.lerobot.rows import Rows
from dpmacro.features.memory import GIB
from dpmacro.parallel import ALONE, Ranks

__all__ = ["Inputs", "choose_inputs", "read_cameras", "read_vectors", "task_indices", "task_names"]

TASK = "task_index"
MOST_TASKS = 10_000
LARGEST_VECTOR = 1000  # numbers; larger ones, as clouds of points, are inputs only where they are asked for
_NUMBERS = ("float16", "float32", "float64", "bool")


@dataclass(frozen=True)
class Inputs:
    """The features chosen, and what to tell a user of those left out."""

    cameras: tuple[str, ...]
    vectors: tuple[str, ...]
    notes: tuple[str, ...]


def choose_inputs(store: StoredDataset, inputs: Sequence[str] | None, outputs: Sequence[str]) -> Inputs:
    """The features asked for or, by default, all cameras and all vectors that begin with `observation.`.

    Where exactly one camera is stored as images, those stored as video are for people and left out. Vectors
    named `state` count where none begins with `observation.`; depth maps and vectors of more than
    LARGEST_VECTOR numbers are left out. `outputs`, the action and the truth, are never inputs. Raises
    DatasetError where there is none, or one asked for is no input.
    """
    where = f"dataset {store.root}"
    cameras = [name for name, feature in store.features.items() if feature["dtype"] in ("image", "video")]
    if inputs is not None:
        for name in inputs:
            if name not in store.features or not (name in cameras or _is_vector(store, name)):
                vectors = [other for other in store.features if _is_vector(store, other)]
                have = ", ".join(other for other in (*cameras, *vectors) if other not in outputs)
                raise DatasetError(f"{where}: no input {name!r}; it has {have or 'none'}")
            if name in outputs:
                raise DatasetError(
                    f"{where}: {name} is the action or the truth, so it is no input; leave it out"
                )
            if name in cameras and is_depth(store.features[name]):
                raise depth_refused(store, name)
        if not inputs:
            raise DatasetError(f"{where}: inputs are none; name at least one")
        chosen = dict.fromkeys(inputs)
        return Inputs(
            tuple(name for name in chosen if name in cameras),
            tuple(name for name in chosen if name not in cameras),
            (),
        )
    notes = []
    depth = [name for name in cameras if is_depth(store.features[name])]
    cameras = [name for name in cameras if name not in depth]
    notes += [f"{name} is left out: a depth map" for name in depth]
    lossless = [name for name in cameras if store.features[name]["dtype"] == "image"]
    if len(lossless) == 1 and len(cameras) > 1:
        notes += [f"{name} is left out: a video beside images" for name in cameras if name not in lossless]
        cameras = lossless
    vectors = [name for name in store.features if name.startswith("observation.") and _is_vector(store, name)]
    if not vectors and _is_vector(store, "state"):
        vectors = ["state"]
    vectors = [name for name in vectors if name not in outputs]
    large = [name for name in vectors if _size(store, name) > LARGEST_VECTOR]
    notes += [f"{name} is left out: {_size(store, name)} numbers a frame" for name in large]
    vectors = [name for name in vectors if name not in large]
    if not cameras and not vectors:
        raise DatasetError(
            f"{where}: has no image feature and, beside the action, no vector that begins with observation.; "
            "name what the policy sees: --dataset.inputs="
        )
    return Inputs(tuple(cameras), tuple(vectors), tuple(notes))


def depth_refused(store: StoredDataset, name: str) -> DatasetError:
    """That a camera's pictures hold no colours."""
    return DatasetError(
        f"dataset {store.root}: {name} is a depth map, not colours; leave it out of --dataset.inputs"
    )


def read_vectors(
    store: StoredDataset, names: Sequence[str], columns: dict[str, np.ndarray]
) -> dict[str, Float32[np.ndarray, "frames dims"]]:
    """The named columns as float32 vectors, each finite."""
    vectors = {}
    for name in names:
        values = columns[name].reshape(len(columns[name]), -1)
        if values.dtype.kind not in "biuf":
            raise DatasetError(
                f"dataset {store.root}: {name} is of type {values.dtype}; an input holds numbers"
            )
        finite(values, f"dataset {store.root}: {name}")
        vectors[name] = values.astype(np.float32)
    return vectors


def read_cameras(
    store: StoredDataset,
    inputs: Inputs,
    asked: bool,
    episodes: Sequence[StoredEpisode],
    rows: Rows,
    transform: ImageTransform,
    tolerance: float = TOLERANCE,
    ranks: Ranks = ALONE,
) -> tuple[dict[str, FrameBuffer], list[str]]:
    """The pictures of the cameras, transformed, and notes; ranks decode a share each.

    What turns out to hold depths is refused where cameras were `asked` for, else left out. Raises
    DatasetError, before anything is decoded, where all pictures take more memory than there is.
    """
    count, sizes, notes = int(rows.lengths.sum()), {}, []
    with ranks.together():
        for camera in inputs.cameras:
            found = picture(store, camera, episodes, rows)
            name = f"dataset {store.root}, {camera}"
            if found.depth:
                if asked:
                    raise depth_refused(store, camera)
                notes.append(f"{camera} is left out: a depth map")
                continue
            sizes[camera] = transform.of(camera).sized(found.width, found.height, name)
        if not sizes and not inputs.vectors:
            raise DatasetError(
                f"dataset {store.root}: has no image feature but depth maps, and no state; dpmacro needs one"
            )
        taken = 4 * count * sum(_size(store, name) for name in inputs.vectors) / GIB
        if sizes:
            left = None if transform.memory is None else transform.memory - taken
            refuse_too_many(f"dataset {store.root}, {next(iter(sizes))}", count, list(sizes.values()), left)
    buffers = {}
    for camera in sizes:
        buffers[camera] = FrameBuffer(count, transform.of(camera), f"dataset {store.root}, {camera}")
        fill(buffers[camera], store, camera, episodes, rows, tolerance, ranks)
    return buffers, notes


def task_indices(store: StoredDataset, column: np.ndarray) -> Int64[np.ndarray, " frames"]:
    """The task of every frame by its number. Raises DatasetError for what is no such number."""
    name = f"dataset {store.root}: task_index"
    if column.size != len(column) or column.dtype.kind not in "biuf":
        raise DatasetError(f"{name} is not one number a frame; number tasks from 0")
    finite(column, name)
    values = column.reshape(-1).astype(np.float64)
    wrong = values[(np.abs(values) > 2**53) | (values != np.round(values))]
    if len(wrong):
        raise DatasetError(f"{name} is {wrong[0]:g}; number tasks from 0")
    return values.astype(np.int64)


def task_names(store: StoredDataset, indices: Int64[np.ndarray, " frames"] | None = None) -> tuple[str, ...]:
    """What there is to do, in words, by task_index; the number as text where no file says."""
    if indices is not None and indices.min() < 0:
        raise DatasetError(f"dataset {store.root}: task_index is {indices.min()}; number tasks from 0")
    largest = max([*store.tasks, -1 if indices is None else int(indices.max())], default=-1)
    if largest >= MOST_TASKS:
        raise DatasetError(f"dataset {store.root}: task_index goes up to {largest}; number tasks from 0")
    return tuple(store.tasks.get(index, str(index)) for index in range(largest + 1))


def _is_vector(store: StoredDataset, name: str) -> bool:
    kind = store.features.get(name, {}).get("dtype", "")
    return name not in BOOKKEEPING and (kind in _NUMBERS or kind.startswith(("int", "uint")))


def _size(store: StoredDataset, name: str) -> int:
    """Numbers of a vector feature at a frame; 1 where the metadata does not say."""
    shape = store.features[name].get("shape")
    sizes = [size for size in (shape if isinstance(shape, list | tuple) else []) if isinstance(size, int)]
    return math.prod(sizes)
