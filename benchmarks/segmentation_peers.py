"""What a researcher could cut demonstrations with instead, each at the best setting that is fair to give it.

All peers see whitened principal components of the frames and one-hot actions, are told the true number Q of
macro-actions, and the hidden Markov models the true rate of changes to start from. Where a peer has settings
(how many components, how much the actions count, the window), *truth* chooses: of a small grid the
setting with the largest sum of frame accuracy and boundary F1, for every case and seed anew. No user could
choose so well; it favours the peer. Within a setting, restarts are chosen by likelihood as a user would.
"""

import logging
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from segmentation_sources import Source

from dpmacro.metrics import random_cuts_like, segmentation_scores, uniform_cuts

__all__ = ["PEERS", "Found", "Setting"]

DIMENSIONS, QUICK_DIMENSIONS = (8, 32), (8,)
SHARES, QUICK_SHARES = (0.0, 0.5, 0.9), (0.5,)
MIXED, QUICK_MIXED = (0.0, 0.5), (0.5,)
WINDOWS, QUICK_WINDOWS = (1, 3, 5, 9, 17, 33, 65, 129), (5, 33)
RESTARTS, QUICK_RESTARTS = 6, 2
STEPS, QUICK_STEPS = 50, 10  # of expectation maximisation at most
SETTLED = 1e-4  # nats a frame that another step must gain
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
        return "actions" if self.share == 1 else f"{self.dimensions} components, actions {self.share:g}"

    def matrix(self, source: Source, seed: int) -> np.ndarray:
        """float64 [frames, columns] of total variance 1."""
        each = self.dimensions // len(source.components)
        observed = np.hstack([block[:, :each] for block in source.components])
        one_hot = np.eye(source.actions.max() + 1)[source.actions][:, np.unique(source.actions)]
        one_hot = one_hot + NOISE * np.random.default_rng(seed).normal(size=one_hot.shape)
        parts = [(observed, 1 - self.share), (one_hot, self.share)]
        return np.hstack([np.sqrt(share / part.var(0).sum()) * part for part, share in parts if share > 0])


def _settings(shares: tuple[float, ...], quick: bool) -> list[Setting]:
    """The grid; without observations the number of components is no matter."""
    found = [Setting(n, share) for n in (QUICK_DIMENSIONS if quick else DIMENSIONS) for share in shares]
    return found if quick else [*found, Setting(0, 1.0)]


def gaussian_hmm(source: Source, seed: int, quick: bool) -> Found:
    """GaussianHMM of hmmlearn, Viterbi decoded.

    Columns have unit variance. Grid: 8 or 32 components with or without actions, or actions alone;
    diagonal or full covariances. Six starts (`_starts`), the likeliest kept, each from the means of its
    labels and, as hmmlearn has it, the covariance of all frames; at most 50 steps of expectation
    maximisation.
    """
    from hmmlearn.hmm import GaussianHMM

    logging.getLogger("hmmlearn").setLevel(logging.ERROR)  # it reports every rounding error

    def likeliest(values: np.ndarray, covariance: str) -> np.ndarray | None:
        best, best_score = None, -np.inf
        for start in _starts(source, values, seed, quick):
            steps, settled = QUICK_STEPS if quick else STEPS, SETTLED * len(values)
            model = GaussianHMM(source.macros, covariance, n_iter=steps, tol=settled, init_params="")
            model.startprob_ = np.full(source.macros, 1 / source.macros)
            model.transmat_ = _sticky(source)
            model.means_ = np.stack([values[start == q].mean(0) for q in range(source.macros)])
            spread = np.cov(values.T) + 1e-3 * np.eye(values.shape[1])
            model.covars_ = np.stack([np.diag(spread) if covariance == "diag" else spread] * source.macros)
            try:
                score = model.fit(values, source.lengths).score(values, source.lengths)
                labels = model.predict(values, source.lengths)
            except (ValueError, np.linalg.LinAlgError):  # a covariance that is none
                continue
            if score > best_score:
                best, best_score = labels, score
        return best

    def found() -> Iterator[Found]:
        for setting in _settings(QUICK_MIXED if quick else MIXED, quick):
            values = _standardised(setting.matrix(source, seed))
            for covariance in ("full",) if quick else ("diag", "full"):
                labels = likeliest(values, covariance)
                if labels is not None:
                    yield Found(labels, f"{setting}, {covariance}")

    return _chosen_by_truth(source, found())


def autoregressive_hmm(source: Source, seed: int, quick: bool) -> Found:
    """LinearAutoregressiveHMM of dynamax, lag 1, Viterbi decoded.

    Columns, starts and steps as for `gaussian_hmm`, but full covariances, which is all it has.
    """
    from segmentation_dynamax import autoregression

    def found() -> Iterator[Found]:
        for setting in _settings(QUICK_MIXED if quick else MIXED, quick):
            values = _standardised(setting.matrix(source, seed))
            starts = _starts(source, values, seed, quick)
            steps = QUICK_STEPS if quick else STEPS
            labels = autoregression(values, source.lengths, starts, _sticky(source), steps)
            if labels is not None:
                yield Found(labels, str(setting))

    return _chosen_by_truth(source, found())


def regression_hmm(source: Source, seed: int, quick: bool) -> Found:
    """CategoricalRegressionHMM of dynamax: every state is a softmax regression of the action on what is seen.

    The hidden Markov model whose question is ours: what does each macro-action do at which observation. Grid:
    8 or 32 components; starts and steps as for `gaussian_hmm`.
    """
    from segmentation_dynamax import regression

    def found() -> Iterator[Found]:
        for dimensions in QUICK_DIMENSIONS if quick else DIMENSIONS:
            setting = Setting(dimensions, 0.0)
            values = _standardised(setting.matrix(source, seed))
            starts = _starts(source, values, seed, quick)
            steps = QUICK_STEPS if quick else STEPS
            labels = regression(values, source.actions, source.lengths, starts, _sticky(source), steps)
            if labels is not None:
                yield Found(labels, f"{dimensions} components")

    return _chosen_by_truth(source, found())


def kernel_changes(source: Source, seed: int, quick: bool) -> Found:
    """KernelCPD of ruptures (rbf, median heuristic), told the true number of changes of every trajectory.

    Segments are named by k-means of their means over the whole dataset, weighted by their lengths.
    Grid: 8 or 32 components; actions none, half or nine tenths of the variance, or alone.
    """
    from ruptures import KernelCPD

    def found() -> Iterator[Found]:
        for setting in _settings(QUICK_SHARES if quick else SHARES, quick):
            values = setting.matrix(source, seed)
            ends: list[int] = []
            for frames, changes in zip(source.trajectories, source.changes, strict=True):
                cuts = [len(values[frames])]
                if changes:
                    cuts = KernelCPD(kernel="rbf", min_size=1).fit(values[frames]).predict(n_bkps=changes)
                ends += [frames.start + end for end in cuts]
            sizes = np.diff([0, *ends])
            means = np.add.reduceat(values, np.r_[0, ends[:-1]]) / sizes[:, None]
            yield Found(np.repeat(_clustered(means, source.macros, seed, sizes), sizes), str(setting))

    return _chosen_by_truth(source, found())


def clustered_windows(source: Source, seed: int, quick: bool) -> Found:
    """k-means of sliding means, centred, shortened at the ends of a trajectory.

    Grid: windows of 1, 3, 5, 9, 17, 33, 65 or 129 frames; columns as for `kernel_changes`.
    """

    def found() -> Iterator[Found]:
        for setting in _settings(QUICK_SHARES if quick else SHARES, quick):
            values = setting.matrix(source, seed)
            for window in QUICK_WINDOWS if quick else WINDOWS:
                if window <= source.lengths.max():
                    means = _sliding_means(values, source.trajectories, window)
                    labels = _clustered(means, source.macros, seed)
                    yield Found(labels, f"{setting}, window {window}")

    return _chosen_by_truth(source, found())


def uniform(source: Source, seed: int, quick: bool) -> Found:
    """The true macro-labels in their true order, cut at equal lengths: all but the when."""
    return Found(uniform_cuts(source.truth, source.lengths), "true order")


def random(source: Source, seed: int, quick: bool) -> Found:
    """Likewise, cut at random points."""
    return Found(random_cuts_like(source.truth, source.lengths, np.random.default_rng(seed)), "true order")


PEERS: dict[str, Callable[[Source, int, bool], Found]] = {
    "GaussianHMM": gaussian_hmm,
    "AR-HMM": autoregressive_hmm,
    "regression HMM": regression_hmm,
    "KernelCPD": kernel_changes,
    "k-means": clustered_windows,
    "uniform cuts": uniform,
    "random cuts": random,
}


def _chosen_by_truth(source: Source, found: Iterator[Found]) -> Found:
    """The best of the grid by frame accuracy plus boundary F1; one macro-action where none has a model."""

    def merit(one: Found) -> float:
        scores = segmentation_scores(one.labels, source.truth, source.lengths, source.tolerance)
        return scores.accuracy + scores.boundary_f1

    return max(found, key=merit, default=Found(np.zeros_like(source.truth), "no setting led to a model"))


def _starts(source: Source, values: np.ndarray, seed: int, quick: bool) -> list[np.ndarray]:
    """Labels to start expectation maximisation from, every macro-label among them.

    Half are the true number of segments in every trajectory, cut at random and numbered in turn, so that
    all trajectories begin with the same one; half are clusters of frames.
    """
    rng, starts = np.random.default_rng(seed), []
    for number in range(QUICK_RESTARTS if quick else RESTARTS):
        if number % 2:
            labels = _clustered(values, source.macros, seed + number)
        else:
            cut = zip(source.lengths.tolist(), source.changes, strict=True)
            numbered = [
                np.searchsorted(np.sort(rng.choice(length - 1, n, False)), np.arange(length))
                for length, n in cut
            ]
            labels = np.concatenate(numbered) % source.macros
        labels[rng.choice(len(labels), source.macros, False)] = np.arange(source.macros)
        starts.append(labels)
    return starts


def _sticky(source: Source) -> np.ndarray:
    """Transition probabilities [Q, Q] to start from: changes as rare as they truly are."""
    leaving = max(sum(source.changes), 1) / len(source.truth)
    others = leaving / max(source.macros - 1, 1)
    return np.where(np.eye(source.macros, dtype=bool), 1 - leaving, others)


def _standardised(values: np.ndarray) -> np.ndarray:
    return (values - values.mean(0)) / values.std(0)


def _sliding_means(values: np.ndarray, trajectories: list[slice], window: int) -> np.ndarray:
    half, means = window // 2, np.empty_like(values)
    for frames in trajectories:
        sums = np.vstack([np.zeros_like(values[:1]), values[frames].cumsum(0)])
        places = np.arange(len(sums) - 1)
        first, last = np.maximum(places - half, 0), np.minimum(places + half + 1, len(places))
        means[frames] = (sums[last] - sums[first]) / (last - first)[:, None]
    return means


def _clustered(values: np.ndarray, macros: int, seed: int, weights: np.ndarray | None = None) -> np.ndarray:
    from sklearn.cluster import KMeans

    found = KMeans(min(macros, len(values)), n_init=4, random_state=seed).fit(values, sample_weight=weights)
    return found.labels_.astype(np.int64)
