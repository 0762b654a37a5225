"""TW-FINCH (Sarfraz et al., CVPR 2021): frames that are alike and near in time are clustered, in hierarchies.

Every frame is linked to its nearest neighbour under distance times time apart; linked frames are a cluster;
the means of clusters are linked in the same manner, until few are left.
"""

from collections.abc import Iterator

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from segmentation_grid import Found, chosen_by_truth, named, settings
from segmentation_sources import NotApplicableError, Source

__all__ = ["temporal_clusters", "weighted_clusters"]

LONGEST = 5000  # frames of a trajectory: distances between all pairs stand in memory
DISTANCES, QUICK_DISTANCES = ("cosine", "Euclidean"), ("cosine",)


def temporal_clusters(source: Source, seed: int, quick: bool) -> Found:
    """TW-FINCH of every trajectory, told its true number of segments, or of classes as in the paper.

    Clusters are named by `named`. Grid: that number; cosine distances as in the paper, or Euclidean; columns
    as for `kernel_changes`.
    """
    if source.lengths.max() > LONGEST:
        raise NotApplicableError(f"a trajectory of more than {LONGEST} frames takes too much memory")
    counts = {"segments": [changes + 1 for changes in source.changes]}
    classes = [len(np.unique(source.truth[frames])) for frames in source.trajectories]
    if classes != counts["segments"]:
        counts["classes"] = classes

    def found() -> Iterator[Found]:
        for setting in settings(source, quick):
            values = setting.matrix(source, seed)
            for distance in QUICK_DISTANCES if quick else DISTANCES:
                for how, numbers in counts.items():
                    parts, before = np.zeros(len(values), np.int64), 0
                    for frames, count in zip(source.trajectories, numbers, strict=True):
                        clusters = weighted_clusters(values[frames], count, distance)
                        parts[frames] = before + clusters
                        before += clusters.max() + 1
                    means = f"{setting}, {distance}, true number of {how}"
                    yield from named(source, parts, seed, [setting], means)

    return chosen_by_truth(source, found())


def weighted_clusters(values: np.ndarray, count: int, distance: str) -> np.ndarray:
    """`count` clusters of the frames of one trajectory, or fewer where it has fewer frames.

    Algorithms 1 and 2 of the paper: partitions get coarser while they have `count` clusters or more; those of
    the last such one are merged, two at a time, the nearest first.

    Args:
        values: [frames, columns].
        count: 1 or more.
        distance: "cosine" or "Euclidean".

    Returns:
        int64 [frames], 0 for the cluster that begins first, 1 for the next, and so on.
    """
    labels = np.arange(len(values))
    while (now := labels.max() + 1) > count:
        weights = _weights(*_means(values, labels), distance, len(values))
        nearest = weights.argmin(1)
        joined = _components(np.arange(now), nearest, now)
        if joined.max() + 1 < count:  # one partition too coarse
            break
        labels = joined[labels]
    while (now := labels.max() + 1) > count:
        weights = _weights(*_means(values, labels), distance, len(values))
        one, other = np.unravel_index(weights.argmin(), weights.shape)
        labels = _components(np.array([one]), np.array([other]), now)[labels]
    firsts = np.unique(labels, return_index=True)[1]
    return firsts.argsort().argsort()[labels]


def _weights(values: np.ndarray, times: np.ndarray, distance: str, frames: int) -> np.ndarray:
    """Distance times share of the trajectory that lies between, [clusters, clusters]; infinite to oneself."""
    if distance == "cosine":
        unit = values / np.maximum(np.linalg.norm(values, axis=1, keepdims=True), 1e-12)
        apart = np.maximum(1 - unit @ unit.T, 0)
    else:
        squares = (values**2).sum(1)
        apart = np.sqrt(np.maximum(squares[:, None] + squares[None] - 2 * values @ values.T, 0))
    weights = apart * np.abs(times[:, None] - times[None]) / frames
    np.fill_diagonal(weights, np.inf)
    return weights


def _means(values: np.ndarray, labels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean of the values and of the times of every cluster."""
    sizes = np.bincount(labels)
    sums = np.zeros((len(sizes), values.shape[1]))
    np.add.at(sums, labels, values)
    return sums / sizes[:, None], np.bincount(labels, np.arange(len(labels))) / sizes


def _components(ones: np.ndarray, others: np.ndarray, count: int) -> np.ndarray:
    """Numbers of the connected components of `count` nodes that are linked in pairs."""
    links = coo_matrix((np.ones(len(ones)), (ones, others)), shape=(count, count))
    return connected_components(links, directed=False)[1].astype(np.int64)
