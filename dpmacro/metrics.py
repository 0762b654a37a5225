"""Labels against truth, and success rates with their uncertainty: plain functions on numpy arrays."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from math import sqrt
from statistics import NormalDist

import numpy as np
from jaxtyping import Int

MATCHABLE = 12
"""Distinct values on the smaller side that `match_labels` still matches exactly in moments."""


@dataclass(frozen=True)
class Matching:
    """Macro-labels named after true classes, one to one.

    Attributes:
        accuracy: share in 0..1 of all frames whose label is matched to their true class.
        truth_of: true class of every matched label; a label beyond the number of classes has none.
    """

    accuracy: float
    truth_of: dict[int, int]


@dataclass(frozen=True)
class BoundaryOffsets:
    """How far found change points lie from true ones, in frames.

    Attributes:
        offsets: |found - true| of every trajectory in which both have exactly one, in their order.
        trajectories: how many trajectories there were.
    """

    offsets: Int[np.ndarray, " compared"]
    trajectories: int

    @property
    def median(self) -> float:
        """Median offset in frames, NaN where nothing could be compared."""
        return float(np.median(self.offsets)) if self.offsets.size else float("nan")


@dataclass(frozen=True)
class SuccessSummary:
    """Outcomes of runs.

    Attributes:
        successes, runs: counts.
        interval: 95% Wilson interval of the success rate, in 0..1.
        endings: (outcome, phase, macro-action) at the end of a failed run and how often, most frequent first.
    """

    successes: int
    runs: int
    interval: tuple[float, float]
    endings: dict[tuple[str, int, int], int]

    @property
    def rate(self) -> float:
        """Successes per run, in 0..1."""
        return self.successes / self.runs


def wilson_interval(successes: int, runs: int, confidence: float = 0.95) -> tuple[float, float]:
    """Interval of a success rate, in 0..1, that keeps its meaning at 0 and at 100% (Wilson 1927).

        (p + z^2/2n -+ z sqrt(p (1 - p) / n + z^2 / 4n^2)) / (1 + z^2/n),  p = successes / n,  n = runs.

    Raises:
        ValueError: no runs, successes outside 0..runs, or a confidence outside (0, 1).
    """
    if runs < 1 or not 0 <= successes <= runs:
        raise ValueError(f"an interval needs runs >= 1 and 0 <= successes <= runs, got {successes} of {runs}")
    if not 0 < confidence < 1:
        raise ValueError(f"confidence is {confidence}, it must lie between 0 and 1, as 0.95 does")
    z = NormalDist().inv_cdf((1 + confidence) / 2)
    rate = successes / runs
    centre = rate + z**2 / (2 * runs)
    margin = z * sqrt(rate * (1 - rate) / runs + z**2 / (4 * runs**2))
    scale = 1 + z**2 / runs
    # At 0 and at 100% rounding could leave the rate itself a hair outside.
    return max(0.0, min(rate, (centre - margin) / scale)), min(1.0, max(rate, (centre + margin) / scale))


def match_labels(labels: Int[np.ndarray, " frames"], truth: Int[np.ndarray, " _frames"]) -> Matching:
    """The one-to-one matching of labels to true classes under which most frames agree.

    Either side may have more values than the other; what is left over counts as wrong. Exact, by
    dynamic programming over the subsets of the smaller side.

    Raises:
        ValueError: no frames, or more than `MATCHABLE` values on both sides.
    """
    _check_same_frames(labels, truth)
    names, rows = np.unique(labels, return_inverse=True)
    classes, columns = np.unique(truth, return_inverse=True)
    counts = np.zeros((len(names), len(classes)), np.int64)
    np.add.at(counts, (rows, columns), 1)
    if min(counts.shape) > MATCHABLE:
        raise ValueError(
            f"{len(names)} labels against {len(classes)} true classes: one side may have {MATCHABLE} at most"
        )
    if len(names) >= len(classes):
        pairs = _best_assignment(counts)
    else:
        pairs = [(row, column) for column, row in _best_assignment(counts.T)]
    agreeing = sum(int(counts[pair]) for pair in pairs)
    return Matching(agreeing / len(labels), {int(names[row]): int(classes[column]) for row, column in pairs})


def frame_accuracy(labels: Int[np.ndarray, " frames"], truth: Int[np.ndarray, " _frames"]) -> float:
    """Share in 0..1 of frames that agree under the best one-to-one matching, see `match_labels`."""
    return match_labels(labels, truth).accuracy


def transitions(
    labels: Int[np.ndarray, " frames"], lengths: Int[np.ndarray, " trajectories"]
) -> list[Int[np.ndarray, " changes"]]:
    """Change points of every trajectory: positions t in 1..length-1 whose label differs from t-1's.

    Raises:
        ValueError: an empty trajectory, or lengths that do not add up to the number of labels.
    """
    if len(lengths) == 0 or lengths.min() < 1 or lengths.sum() != len(labels):
        raise ValueError(
            f"lengths {lengths.tolist()} must be positive and add up to the {len(labels)} labels given"
        )
    trajectories = np.split(labels, np.cumsum(lengths)[:-1])
    return [np.flatnonzero(np.diff(trajectory)) + 1 for trajectory in trajectories]


def boundary_offsets(
    labels: Int[np.ndarray, " frames"],
    truth: Int[np.ndarray, " _frames"],
    lengths: Int[np.ndarray, " trajectories"],
) -> BoundaryOffsets:
    """Distance of found from true change points where both have exactly one; see `transitions`."""
    _check_same_frames(labels, truth)
    both = zip(transitions(labels, lengths), transitions(truth, lengths), strict=True)
    offsets = [abs(int(found[0]) - int(true[0])) for found, true in both if len(found) == len(true) == 1]
    return BoundaryOffsets(np.array(offsets, np.int64), len(lengths))


def success_summary(
    outcomes: Sequence[str], last_phases: Sequence[int], last_macros: Sequence[int]
) -> SuccessSummary:
    """Counts of outcomes, the failed ones by the phase and macro-action they ended in.

    Args:
        outcomes: "success" or the name of a failure, one per run.
        last_phases, last_macros: of the last step of each run; macro-action -1 where there is none.

    Raises:
        ValueError: no runs, or sequences of different lengths.
    """
    if not len(outcomes) == len(last_phases) == len(last_macros):
        raise ValueError(
            f"{len(outcomes)} outcomes, {len(last_phases)} phases and {len(last_macros)} macro-actions: "
            "every run needs one of each"
        )
    endings = Counter(zip(outcomes, last_phases, last_macros, strict=True))
    successes = sum(outcome == "success" for outcome in outcomes)
    failures = {ending: count for ending, count in endings.most_common() if ending[0] != "success"}
    return SuccessSummary(successes, len(outcomes), wilson_interval(successes, len(outcomes)), failures)


def _check_same_frames(labels: np.ndarray, truth: np.ndarray) -> None:
    if len(labels) == 0 or len(labels) != len(truth):
        raise ValueError(f"{len(labels)} labels against {len(truth)} true ones: one of each per frame")


def _best_assignment(gains: Int[np.ndarray, "rows columns"]) -> list[tuple[int, int]]:
    """Pairs (row, column) of largest total gain, no row or column twice; columns must be few."""
    rows, columns = gains.shape

    @cache
    def best(row: int, taken: int) -> tuple[int, tuple[tuple[int, int], ...]]:
        if row == rows:
            return 0, ()
        choices = [best(row + 1, taken)]
        for column in range(columns):
            if not taken >> column & 1:
                gain, pairs = best(row + 1, taken | 1 << column)
                choices.append((gain + int(gains[row, column]), ((row, column), *pairs)))
        return max(choices, key=lambda choice: choice[0])

    return list(best(0, 0)[1])
