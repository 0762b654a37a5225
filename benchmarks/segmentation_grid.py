"""What the peers share: the columns that they may be given, how cuts are named, and which setting counts.

Where a peer has settings (how many components, how much the actions count, the window), *truth* chooses: of
a small grid the setting with the largest sum of frame accuracy and boundary F1, for every case and seed anew.
No user could choose so well; it favours the peer.
"""

import warnings
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from segmentation_sources import Source, standardised, vector_columns

from dpmacro.metrics import segmentation_scores

__all__ = [
    "ALL",
    "DIMENSIONS",
    "QUICK_DIMENSIONS",
    "Found",
    "Setting",
    "chosen_by_truth",
    "clustered",
    "named",
    "settings",
    "sliding_means",
    "varying",
]

ALL = -1  # in place of a number of components: the standardised columns as they are
DIMENSIONS, VECTOR_DIMENSIONS, QUICK_DIMENSIONS = (8, 32), (ALL, 8, 32), (8,)
SHARES, QUICK_SHARES = (0.0, 0.5, 0.9), (0.5,)
NOISE = 0.3  # standard deviation added to one-hot actions, without which their densities are infinite


@dataclass(frozen=True)
class Found:
    """A segmentation, and the setting that found it."""

    labels: np.ndarray  # int64 [frames]
    setting: str


@dataclass(frozen=True)
class Setting:
    """Columns that a peer works on: components in all, and the actions' share of the variance, 0..1."""

    dimensions: int
    share: float

    def __str__(self) -> str:
        if self.share == 1:
            return "actions"
        observed = "columns" if self.dimensions == ALL else f"{self.dimensions} components"
        return f"{observed}, actions {self.share:g}"

    def matrix(self, source: Source, seed: int) -> np.ndarray:
        """float64 [frames, columns] of total variance 1; all 0 where nothing varies."""
        parts = [(_observed(source, self.dimensions), 1 - self.share), (_acted(source, seed), self.share)]
        weighted = [
            np.sqrt(share / part.var(0).sum()) * part for part, share in parts if share > 0 and part.size
        ]
        return np.hstack(weighted) if weighted else np.zeros((len(source.truth), 1))


def settings(source: Source, quick: bool, shares: Sequence[float] = SHARES) -> list[Setting]:
    """The grid; without observations the number of components is no matter."""
    if quick:
        return [Setting(n, share) for n in QUICK_DIMENSIONS for share in QUICK_SHARES]
    dimensions = VECTOR_DIMENSIONS if source.vectors else DIMENSIONS
    return [*(Setting(n, share) for n in dimensions for share in shares), Setting(0, 1.0)]


def chosen_by_truth(source: Source, found: Iterable[Found]) -> Found:
    """The best of the grid by frame accuracy plus boundary F1; one macro-action where none has a model."""

    def merit(one: Found) -> float:
        scores = segmentation_scores(one.labels, source.truth, source.lengths, source.tolerance)
        return scores.accuracy + scores.boundary_f1

    return max(found, key=merit, default=Found(np.zeros_like(source.truth), "no setting led to a model"))


def named(source: Source, parts: np.ndarray, seed: int, by: Iterable[Setting], how: str) -> Iterator[Found]:
    """Macro-labels for the parts of trajectories that a method of one trajectory finds.

    Parts are numbered over the whole dataset, int64 [frames], so that those of a trajectory follow one
    another in the order in which they begin. The means of all parts, weighted by their lengths, are clustered
    by k-means into Q, once for every setting in `by`. Where actions are vectors, parts are also named by
    their order in the trajectory, which is best where all demonstrations have the same stages. `how` says in
    what manner the parts were found.
    """
    parts = np.unique(parts, return_inverse=True)[1]
    sizes = np.bincount(parts)
    for setting in by:
        values = setting.matrix(source, seed)
        sums = np.zeros((len(sizes), values.shape[1]))
        np.add.at(sums, parts, values)
        labels = clustered(sums / sizes[:, None], source.macros, seed, sizes)
        yield Found(labels[parts], f"{how}; named by {setting}")
    if source.vectors:
        firsts = [parts[frames].min() for frames in source.trajectories]
        order = parts - np.repeat(firsts, source.lengths)
        yield Found(np.minimum(order, source.macros - 1), f"{how}; named in order")


def clustered(values: np.ndarray, macros: int, seed: int, weights: np.ndarray | None = None) -> np.ndarray:
    """k-means of rows, at most `macros` labels, int64."""
    from sklearn.cluster import KMeans

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of fewer distinct rows than labels
        model = KMeans(min(macros, len(values)), n_init=4, random_state=seed)
        return model.fit(values, sample_weight=weights).labels_.astype(np.int64)


def sliding_means(values: np.ndarray, trajectories: list[slice], window: int) -> np.ndarray:
    """Means over a centred window, shortened at the ends of a trajectory, like `values` [frames, columns]."""
    half, means = window // 2, np.empty_like(values)
    for frames in trajectories:
        sums = np.vstack([np.zeros_like(values[:1]), values[frames].cumsum(0)])
        places = np.arange(len(sums) - 1)
        first, last = np.maximum(places - half, 0), np.minimum(places + half + 1, len(places))
        means[frames] = (sums[last] - sums[first]) / (last - first)[:, None]
    return means


def varying(source: Source) -> np.ndarray:
    """Vectors of actions, standardised, float64 [frames, dimensions that vary]."""
    return standardised(source.actions)


def _observed(source: Source, dimensions: int) -> np.ndarray:
    if dimensions == ALL:
        return standardised(vector_columns(source))
    each = dimensions // len(source.components)
    return np.hstack([block[:, :each] for block in source.components])


def _acted(source: Source, seed: int) -> np.ndarray:
    if source.vectors:
        return varying(source)
    one_hot = np.eye(source.actions.max() + 1)[source.actions][:, np.unique(source.actions)]
    return one_hot + NOISE * np.random.default_rng(seed).normal(size=one_hot.shape)
