"""Demonstrations whose true macro-labels are known, as what every method of the segmentation table gets.

digits      scikit-learn's digits, a hidden rule of the action changing at hidden points
two_flags   a recorded dataset of TwoFlags-v0, the phase its truth
babyai      recorded datasets of BabyAI levels, the bot's subgoal their truth

Those whose actions are vectors are read by segmentation_vectors.py.
"""

import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from dpmacro.data.demonstrations import Demonstrations
from dpmacro.metrics import transitions

__all__ = [
    "COMPONENTS",
    "TOLERANCES",
    "VECTOR_TOLERANCES",
    "NotApplicableError",
    "Source",
    "check_recorded",
    "from_dataset",
    "sources",
    "standardised",
    "vector_columns",
]

TOLERANCES = {"digits": 3, "two_flags": 10, "babyai": 1}  # frames that a boundary may be off
VECTOR_TOLERANCES = {"metaworld": 5, "mocap6": 10, "cr5": 5}  # likewise, where actions are vectors
CONSTANT = 1e-4  # standard deviation up to which a column says nothing
RULES, QUICK_RULES = (2, 3, 4), (2,)
QUICK_EPISODES = 6
COMPONENTS = 32  # principal components that a peer may ask for, of all blocks
HALF = 2  # sides of images are halved before their principal components are sought


class NotApplicableError(ValueError):
    """A method has no answer for a source; the message says why."""


@dataclass(frozen=True)
class Source:
    """Trajectories, concatenated frame by frame.

    Attributes:
        name, case: "digits" and "Q=3"; "babyai" and the level.
        frames: float32 [frames, columns], or RGB images uint8 [frames, height, width, 3].
        actions: classes, int64 [frames], or vectors, float32 [frames, dimensions].
        lengths: int64 [trajectories].
        truth: int64 [frames].
        gripper: the dimension of vectors that closes a gripper; None where none is seen.
        body: how many columns of the frames, from the first on, are the robot itself; None for all.
    """

    name: str
    case: str
    frames: np.ndarray
    actions: np.ndarray
    lengths: np.ndarray
    truth: np.ndarray
    gripper: int | None = None
    body: int | None = None

    @property
    def vectors(self) -> bool:
        """Whether actions are vectors."""
        return self.actions.ndim == 2

    @property
    def macros(self) -> int:
        """Q, the number of true classes."""
        return len(np.unique(self.truth))

    @property
    def tolerance(self) -> int:
        """Frames that a boundary may be off."""
        return (TOLERANCES | VECTOR_TOLERANCES)[self.name]

    @cached_property
    def changes(self) -> list[int]:
        """True changes of every trajectory."""
        return [len(points) for points in transitions(self.truth, self.lengths)]

    @property
    def trajectories(self) -> list[slice]:
        """The frames of every trajectory."""
        ends = np.cumsum(self.lengths).tolist()
        return [slice(end - length, end) for end, length in zip(ends, self.lengths.tolist(), strict=True)]

    @cached_property
    def digest(self) -> str:
        """Changes with the data: results of other data are not reused."""
        parts = (self.frames, self.actions, self.lengths, self.truth)
        checksum = 0
        for part in parts:
            checksum = zlib.crc32(np.ascontiguousarray(part).data, checksum)
        return f"{checksum:08x}"

    @cached_property
    def components(self) -> list[np.ndarray]:
        """Whitened principal components, largest first, float64 [frames, up to `COMPONENTS`]: unit variance.

        One block for numbers, where actions are vectors of the standardised `vector_columns`. For images two:
        of their pixels, and of the difference to the previous image, which apart is not drowned by the image.
        """
        if self.vectors:
            return [_whitened(standardised(vector_columns(self)))]
        if self.frames.ndim == 2:
            return [_whitened(self.frames)]
        n_frames, height, width, _ = self.frames.shape
        even = self.frames[:, : height // HALF * HALF, : width // HALF * HALF]
        shape = n_frames, height // HALF, HALF, width // HALF, HALF, 3
        images = even.reshape(shape).mean((2, 4), dtype=np.float32).reshape(n_frames, -1)
        changes = np.zeros_like(images)
        for frames in self.trajectories:
            changes[frames][1:] = np.diff(images[frames], axis=0)
        return [_whitened(images), _whitened(changes)]


def vector_columns(source: Source) -> np.ndarray:
    """What every method sees where actions are vectors: the state and its change over one frame.

    float32 [frames, twice the state's columns]; the change is 0 at the first frame of a trajectory.
    """
    changes = np.zeros_like(source.frames)
    for frames in source.trajectories:
        changes[frames][1:] = np.diff(source.frames[frames], axis=0)
    return np.hstack([source.frames, changes])


def standardised(values: np.ndarray) -> np.ndarray:
    """Mean 0 and variance 1 in every column, float64, those that hardly vary left out."""
    values = values.astype(np.float64)
    spread = values.std(0)
    kept = spread > CONSTANT
    return (values[:, kept] - values[:, kept].mean(0)) / spread[kept]


def sources(
    names: Sequence[str], seeds: Sequence[int], two_flags: Path, babyai: Path, truth: str, quick: bool
) -> Iterator[tuple[int, Source]]:
    """Every source with every seed: of the generator and the methods for digits, else of the methods alone.

    `truth` is the column of BabyAI's. `quick` is the easiest digits and a few episodes of each dataset.
    Raises DatasetError where a dataset cannot be read.
    """
    for name in names:
        if name == "digits":
            from dpmacro.data.synthetic import digits

            for rules in QUICK_RULES if quick else RULES:
                for seed in seeds:
                    made = digits(rules, seed)
                    frames = np.asarray(made.features, np.float32)
                    yield seed, Source(name, f"Q={rules}", frames, made.actions, made.lengths, made.truth)
        else:
            flags = name == "two_flags"
            for root in [two_flags] if flags else _levels(babyai):
                column = None if flags else truth
                source = from_dataset(name, root, column, range(QUICK_EPISODES) if quick else None)
                yield from ((seed, source) for seed in seeds)


def from_dataset(
    name: str, root: Path, truth: str | None = None, episodes: Sequence[int] | None = None
) -> Source:
    """A recorded dataset; its folder's name and the column of its truth are the case.

    Raises ValueError where it has no truth.
    """
    recorded = Demonstrations.load(root, episodes, truth=truth)
    if recorded.truth is None:
        raise ValueError(f"dataset {root} has no true macro-labels: record it anew")
    case = f"{root.name} {recorded.truth_name}"
    return Source(name, case, recorded.images, recorded.actions, recorded.lengths, recorded.truth)


def check_recorded(names: Sequence[str], two_flags: Path, babyai: Path) -> None:
    """Raises ValueError with the remedy where a dataset is not there, before hours are spent on others."""
    wanted = {"two_flags": two_flags, "babyai": babyai}
    for name, root in wanted.items():
        found = _levels(root) if name == "babyai" else [root] * (root / "meta/info.json").exists()
        if name in names and not found:
            raise ValueError(f"{name} is not in {root}: `make bench-segmentation` records it")


def _levels(babyai: Path) -> list[Path]:
    return sorted(path.parents[1] for path in babyai.glob("*/meta/info.json"))


def _whitened(values: np.ndarray) -> np.ndarray:
    """Principal components by a randomised solver, those without variance left out."""
    from sklearn.decomposition import PCA

    if not values.shape[1]:
        return np.zeros(values.shape)
    count = min(COMPONENTS, *values.shape)
    found = PCA(count, svd_solver="randomized", random_state=0).fit(values)
    kept = found.explained_variance_ > 1e-6 * found.explained_variance_[0]
    scale = np.sqrt(found.explained_variance_[kept])
    return found.transform(values)[:, kept].astype(np.float64) / scale
