"""The libraries that a researcher could boost one-split trees with instead, round by round.

Every function trains on a saved matrix and returns

    seconds            of each boosting round, binning not among them
    binning            seconds from the uint8 matrix to what the rounds work on
    rounds             how many boosting rounds the accuracies are after
    training_accuracy  share of training frames whose class is right
    accuracy           of held-out frames, likewise
    gib                peak memory up to the end of the last round, in GiB
"""

import contextlib
import io
import re
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from matrices import Matrix
from measure import peak_gib

__all__ = ["ada_boost", "catboost", "hist_gradient_boosting", "lightgbm", "xgboost"]

SHRINKAGE = 0.1
PATIENCE = 60.0  # seconds of rounds, after which LEAST of them will do
LEAST = 6
SLOW = 20.0  # seconds of AdaBoost's first round, after which it will do
CHUNK = 2_000  # frames predicted at a time


def lightgbm(
    matrix: str, rounds: int, threads: int, layout: str = "col", patience: float | None = PATIENCE
) -> dict[str, Any]:
    """LightGBM, `layout` "col" or "row" wise histograms; every round where `patience` is None."""
    import lightgbm

    data = Matrix.load(matrix)
    params = {
        "objective": "multiclass",
        "num_class": data.n_classes,
        "num_leaves": 2,
        "learning_rate": SHRINKAGE,
        "min_data_in_leaf": 1,
        "min_sum_hessian_in_leaf": 0,
        "min_data_in_bin": 1,
        "feature_pre_filter": False,
        "max_bin": 255,
        "num_threads": threads,
        f"force_{layout}_wise": True,
        "verbosity": -1,
    }
    clock = time.perf_counter()
    dataset = lightgbm.Dataset(data.features, data.actions, params=params).construct()
    booster = lightgbm.Booster(params, dataset)
    binning = time.perf_counter() - clock
    seconds = _rounds(lambda number: booster.update(), rounds, patience)
    return _result(seconds, binning, data, lambda frames: np.argmax(booster.predict(frames), 1))


def xgboost(matrix: str, rounds: int, threads: int, trees: str = "one_output_per_tree") -> dict[str, Any]:
    """XGBoost's hist with trees of depth 1, one a class, or with `trees` "multi_output_tree" one for all."""
    import xgboost

    data = Matrix.load(matrix)
    params = {
        "objective": "multi:softprob",
        "num_class": data.n_classes,
        "tree_method": "hist",
        "max_depth": 1,
        "max_bin": 256,
        "eta": SHRINKAGE,
        "min_child_weight": 0,
        "multi_strategy": trees,
        "nthread": threads,
    }
    clock = time.perf_counter()
    dataset = xgboost.QuantileDMatrix(data.features, data.actions, max_bin=256, nthread=threads)
    booster = xgboost.Booster(params, [dataset])
    binning = time.perf_counter() - clock
    seconds = _rounds(lambda number: booster.update(dataset, number), rounds, PATIENCE)
    return _result(seconds, binning, data, lambda frames: booster.predict(xgboost.DMatrix(frames)).argmax(1))


def catboost(matrix: str, rounds: int, threads: int) -> dict[str, Any]:
    """CatBoost with symmetric trees of depth 1, which vote for all classes; its pool is quantised first."""
    import catboost

    data = Matrix.load(matrix)
    options = {
        "depth": 1,
        "learning_rate": SHRINKAGE,
        "thread_count": threads,
        "loss_function": "MultiClass",
        "bootstrap_type": "No",
        "random_strength": 0,
        "allow_writing_files": False,
        "logging_level": "Silent",
    }
    clock = time.perf_counter()
    pool = catboost.Pool(np.asarray(data.features, np.float32), np.array(data.actions), thread_count=threads)
    pool.quantize(border_count=254)
    binning = time.perf_counter() - clock
    ends: list[float] = []

    class Stamps:
        def after_iteration(self, info: Any) -> bool:
            ends.append(time.perf_counter())
            waited = len(ends) >= LEAST and ends[-1] - ends[0] > PATIENCE
            return not waited

    classifier = catboost.CatBoostClassifier(iterations=rounds, **options)
    started = time.perf_counter()
    classifier.fit(pool, callbacks=[Stamps()])
    seconds = np.diff([started, *ends]).tolist()
    return _result(seconds, binning, data, lambda frames: classifier.predict(frames)[:, 0])


def hist_gradient_boosting(matrix: str, rounds: int, threads: int) -> dict[str, Any]:
    """scikit-learn's HistGradientBoostingClassifier; its threads are OMP_NUM_THREADS.

    The seconds of a round are those that it prints, to the millisecond.
    """
    from sklearn.ensemble import HistGradientBoostingClassifier

    data = Matrix.load(matrix)
    classifier = HistGradientBoostingClassifier(
        max_leaf_nodes=2,
        min_samples_leaf=1,
        max_iter=rounds,
        learning_rate=SHRINKAGE,
        early_stopping=False,
        verbose=2,
    )
    printed = io.StringIO()
    clock = time.perf_counter()
    with contextlib.redirect_stdout(printed):
        classifier.fit(data.features, data.actions)
    total = time.perf_counter() - clock
    seconds = [float(value) for value in re.findall(r"\[\d+/\d+\].* in ([\d.]+)s", printed.getvalue())]
    assert len(seconds) == rounds, printed.getvalue()
    return _result(seconds, total - sum(seconds), data, classifier.predict)


def ada_boost(matrix: str, rounds: int, threads: int) -> dict[str, Any]:
    """scikit-learn's AdaBoostClassifier with depth-1 trees, on one core: it has no more to offer.

    Frames come as float32, which its trees would otherwise convert in every round.
    """
    from sklearn.ensemble import AdaBoostClassifier
    from sklearn.tree import DecisionTreeClassifier

    data = Matrix.load(matrix)
    clock = time.perf_counter()
    features = np.asarray(data.features, np.float32)
    binning = time.perf_counter() - clock
    classifier = AdaBoostClassifier(DecisionTreeClassifier(max_depth=1), n_estimators=1)
    seconds = [_timed(lambda: classifier.fit(features, data.actions))]
    starts: list[float] = []

    class StampedTree(DecisionTreeClassifier):
        def fit(self, X: Any, y: Any, sample_weight: Any = None) -> "StampedTree":
            starts.append(time.perf_counter())
            return super().fit(X, y, sample_weight)

    if seconds[0] < SLOW:
        classifier = AdaBoostClassifier(StampedTree(max_depth=1), n_estimators=rounds)
        classifier.fit(features, data.actions)
        seconds = np.diff([*starts, time.perf_counter()]).tolist()
    return _result(seconds, binning, data, classifier.predict)


def _rounds(step: Callable[[int], Any], rounds: int, patience: float | None) -> list[float]:
    """Seconds of every round; fewer rounds, `LEAST` at least, where they outlast the patience."""
    seconds: list[float] = []
    while len(seconds) < rounds:
        seconds.append(_timed(lambda: step(len(seconds))))
        if patience is not None and len(seconds) >= LEAST and sum(seconds) > patience:
            break
    return seconds


def _timed(step: Callable[[], Any]) -> float:
    clock = time.perf_counter()
    step()
    return time.perf_counter() - clock


def _result(
    seconds: list[float],
    binning: float,
    data: Matrix,
    predict: Callable[[np.ndarray], np.ndarray],
) -> dict[str, Any]:
    def accuracy(frames: np.ndarray, truth: np.ndarray) -> float:
        right = [
            (predict(frames[first : first + CHUNK]) == truth[first : first + CHUNK]).sum()
            for first in range(0, len(frames), CHUNK)
        ]
        return float(sum(right) / len(truth))

    return {
        "gib": peak_gib(),
        "seconds": seconds,
        "binning": binning,
        "rounds": len(seconds),
        "training_accuracy": accuracy(data.features, data.actions),
        "accuracy": accuracy(data.held_features, data.held_actions),
    }
