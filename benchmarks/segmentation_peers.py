"""What a researcher could cut demonstrations with instead, each at the best setting that is fair to give it.

All peers see whitened principal components of the frames and one-hot actions; where actions are vectors, the
standardised columns, too, or their components. They are told the true number Q of macro-actions, and the
hidden Markov models the true rate of changes to start from. Settings are chosen by the truth
(segmentation_grid.py); within a setting, restarts are chosen by likelihood as a user would.
"""

import logging
from collections.abc import Callable, Iterator

import numpy as np
from segmentation_finch import temporal_clusters
from segmentation_grid import (
    ALL,
    DIMENSIONS,
    QUICK_DIMENSIONS,
    Found,
    Setting,
    chosen_by_truth,
    clustered,
    named,
    settings,
    sliding_means,
    varying,
)
from segmentation_heuristics import gripper_changes, gripper_or_slow, slow_moments, waypoints
from segmentation_sources import Source

from dpmacro.metrics import random_cuts_like, uniform_cuts

__all__ = ["PEERS", "Found", "Setting"]

MIXED = (0.0, 0.5)  # shares of the actions
WINDOWS, QUICK_WINDOWS = (1, 3, 5, 9, 17, 33, 65, 129), (5, 33)
RESTARTS, QUICK_RESTARTS = 6, 2
STEPS, QUICK_STEPS = 50, 10  # of expectation maximisation at most
SETTLED = 1e-4  # nats a frame that another step must gain
FLOORS, QUICK_FLOORS = (0.001, 0.1), (0.1,)  # variance added to a linear model of vectors


def gaussian_hmm(source: Source, seed: int, quick: bool) -> Found:
    """GaussianHMM of hmmlearn, Viterbi decoded.

    Columns have unit variance. Grid: 8 or 32 components with or without actions, or actions alone; diagonal
    or full covariances; where actions are vectors, all columns, too, with diagonal ones. Six starts
    (`_starts`), the likeliest kept, each from the means of its labels and, as hmmlearn has it, the covariance
    of all frames; at most 50 steps of expectation maximisation.
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
        for setting in settings(source, quick, MIXED):
            values = _standardised(setting.matrix(source, seed))
            singular = setting.dimensions == ALL
            for covariance in ("full",) if quick else ("diag",) if singular else ("diag", "full"):
                labels = likeliest(values, covariance)
                if labels is not None:
                    yield Found(labels, f"{setting}, {covariance}")

    return chosen_by_truth(source, found())


def autoregressive_hmm(source: Source, seed: int, quick: bool) -> Found:
    """LinearAutoregressiveHMM of dynamax, lag 1, Viterbi decoded.

    Columns, starts and steps as for `gaussian_hmm`, but full covariances, which is all it has. Where actions
    are vectors, which a stage may leave constant, .001 or .1 is added to every variance.
    """
    from segmentation_dynamax import autoregression

    if source.macros == 1:
        return _nothing_to_tell(source)

    def found() -> Iterator[Found]:
        for setting in settings(source, quick, MIXED):
            if setting.dimensions == ALL:  # linear in one another
                continue
            values = _standardised(setting.matrix(source, seed))
            starts = _starts(source, values, seed, quick)
            steps = QUICK_STEPS if quick else STEPS
            for floor in _floors(quick) if source.vectors else (0.0,):
                labels = autoregression(values, source.lengths, starts, _sticky(source), steps, floor)
                if labels is not None:
                    yield Found(labels, f"{setting}, floor {floor:g}" if floor else str(setting))

    return chosen_by_truth(source, found())


def regression_hmm(source: Source, seed: int, quick: bool) -> Found:
    """Every state is a regression of the action on what is seen, dynamax.

    The hidden Markov model whose question is ours: what does each macro-action do at which observation.
    Classes have a CategoricalRegressionHMM of softmax regressions, vectors a LinearRegressionHMM of linear
    ones, to whose variances .001 or .1 is added. Grid: 8 or 32 components; starts and steps as for
    `gaussian_hmm`.
    """
    from segmentation_dynamax import linear_regression, regression

    if source.macros == 1:
        return _nothing_to_tell(source)

    def found() -> Iterator[Found]:
        for dimensions in QUICK_DIMENSIONS if quick else DIMENSIONS:
            values = _standardised(Setting(dimensions, 0.0).matrix(source, seed))
            given = source.lengths, _starts(source, values, seed, quick), _sticky(source)
            steps = QUICK_STEPS if quick else STEPS
            for floor in _floors(quick) if source.vectors else (0.0,):
                if source.vectors:
                    labels = linear_regression(values, varying(source), *given, steps, floor)
                else:
                    labels = regression(values, source.actions, *given, steps)
                if labels is not None:
                    how = f"{dimensions} components"
                    yield Found(labels, f"{how}, floor {floor:g}" if floor else how)

    return chosen_by_truth(source, found())


def kernel_changes(source: Source, seed: int, quick: bool) -> Found:
    """KernelCPD of ruptures (rbf, median heuristic), told the true number of changes of every trajectory.

    Segments are named by k-means of their means (`named`). Grid: 8 or 32 components, where actions are
    vectors all columns, too; actions none, half or nine tenths of the variance, or alone.
    """
    from ruptures import KernelCPD

    def found() -> Iterator[Found]:
        for setting in settings(source, quick):
            values = setting.matrix(source, seed)
            ends: list[int] = []
            for frames, changes in zip(source.trajectories, source.changes, strict=True):
                cuts = [len(values[frames])]
                if changes and np.ptp(values[frames], axis=0).any():
                    cuts = KernelCPD(kernel="rbf", min_size=1).fit(values[frames]).predict(n_bkps=changes)
                ends += [frames.start + end for end in cuts]
            sizes = np.diff([0, *ends])
            yield from named(source, np.repeat(np.arange(len(sizes)), sizes), seed, [setting], str(setting))

    return chosen_by_truth(source, found())


def clustered_windows(source: Source, seed: int, quick: bool) -> Found:
    """k-means of sliding means, centred, shortened at the ends of a trajectory.

    Grid: windows of 1, 3, 5, 9, 17, 33, 65 or 129 frames; columns as for `kernel_changes`.
    """

    def found() -> Iterator[Found]:
        for setting in settings(source, quick):
            values = setting.matrix(source, seed)
            for window in QUICK_WINDOWS if quick else WINDOWS:
                if window <= source.lengths.max():
                    means = sliding_means(values, source.trajectories, window)
                    labels = clustered(means, source.macros, seed)
                    yield Found(labels, f"{setting}, window {window}")

    return chosen_by_truth(source, found())


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
    "TW-FINCH": temporal_clusters,
    "AWE": waypoints,
    "gripper": gripper_changes,
    "slow": slow_moments,
    "gripper or slow": gripper_or_slow,
    "uniform cuts": uniform,
    "random cuts": random,
}


def _nothing_to_tell(source: Source) -> Found:
    """The labels where there is one macro-action, of which dynamax makes no model."""
    return Found(np.zeros_like(source.truth), "one macro-action")


def _floors(quick: bool) -> tuple[float, ...]:
    return QUICK_FLOORS if quick else FLOORS


def _starts(source: Source, values: np.ndarray, seed: int, quick: bool) -> list[np.ndarray]:
    """Labels to start expectation maximisation from, every macro-label among them.

    Half are the true number of segments in every trajectory, cut at random and numbered in turn, so that
    all trajectories begin with the same one; half are clusters of frames.
    """
    rng, starts = np.random.default_rng(seed), []
    for number in range(QUICK_RESTARTS if quick else RESTARTS):
        if number % 2:
            labels = clustered(values, source.macros, seed + number)
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
    """Unit variance in every column; one that is constant stays so."""
    return (values - values.mean(0)) / np.maximum(values.std(0), 1e-12)
