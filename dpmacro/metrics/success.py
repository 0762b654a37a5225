"""How runs ended: success rates with their uncertainty."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass


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


@dataclass(frozen=True)
class Paired:
    """Runs of two planners in the same worlds, world by world.

    Attributes:
        both, only_first, only_second, neither: pairs by who succeeded.
        p: of the exact two-sided McNemar test, in 0..1.
    """

    both: int
    only_first: int
    only_second: int
    neither: int
    p: float

    @property
    def pairs(self) -> int:
        """Their number."""
        return self.both + self.only_first + self.only_second + self.neither

    @property
    def gain(self) -> float:
        """The first's success rate less the second's, -1 to 1."""
        return (self.only_first - self.only_second) / self.pairs


def wilson_interval(successes: int, runs: int, confidence: float = 0.95) -> tuple[float, float]:
    """Interval of a success rate, in 0..1, that keeps its meaning at 0 and at 100% (Wilson 1927).

    Raises:
        ValueError: no runs, successes outside 0..runs, or a confidence outside (0, 1).
    """
    if runs < 1 or not 0 <= successes <= runs:
        raise ValueError(f"an interval needs runs >= 1 and 0 <= successes <= runs, got {successes} of {runs}")
    if not 0 < confidence < 1:
        raise ValueError(f"confidence is {confidence}, it must lie between 0 and 1, as 0.95 does")
    from scipy.stats import binomtest  # late: eval.py's workers import this module and do not need it

    interval = binomtest(successes, runs).proportion_ci(confidence, method="wilson")
    return float(interval.low), float(interval.high)


def mcnemar(first: Sequence[bool], second: Sequence[bool]) -> Paired:
    """Exact test of whether two planners differ, by the worlds in which only one succeeds (McNemar 1947).

    The first planner alone succeeds in b worlds, the second alone in c. If both were equally good, b would be
    binomial among the d = b + c worlds:

        p = P(|B - d/2| >= |b - d/2|),  B ~ Binomial(d, 1/2);  1 if d = 0.

    Args:
        first, second: whether the run in world i succeeded, for the same worlds in the same order.

    Raises ValueError for no pairs, or sequences of different lengths.
    """
    from scipy.stats import binomtest  # late, as above

    if len(first) != len(second) or not len(first):
        raise ValueError(f"{len(first)} and {len(second)} runs: give as many of each, 1 or more")
    counts = Counter((bool(a), bool(b)) for a, b in zip(first, second, strict=True))
    b, c = counts[True, False], counts[False, True]
    p = float(binomtest(b, b + c).pvalue) if b + c else 1.0
    return Paired(counts[True, True], b, c, counts[False, False], p)


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
