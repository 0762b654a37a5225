"""What a criterion's choice among candidate segmentations is worth, as rows, tables and a picture."""

from collections import defaultdict
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from scipy.stats import spearmanr
from segmentation_sources import TOLERANCES

from dpmacro.discovery.criteria import CandidateScores, best_candidate
from dpmacro.figures.style import FAINT, PALETTE, WIDTH, bare, legend, set_title

__all__ = ["CRITERIA", "choices", "fit_table", "picture", "rule_ranks", "table"]

CRITERIA = {  # name: the sign that makes less of it better
    "training_loss": 1,
    "hindsight_loss": 1,
    "exponential_loss": 1,
    "refitted_loss": 1,
    "context_loss": 1,
    "unstable": 1,
    "recognised": -1,
    "causal_loss": 1,
    "causal_error": 1,
    "rule": 1,  # the order in which DPBoost would pick them
}
METRICS = {  # heading: metric, how cases are summed up
    "accuracy": ("accuracy", np.nanmean),
    "regret": ("regret", np.nanmean),
    "worst": ("regret", np.nanmax),
    "boundary F1": ("boundary_f1", np.nanmean),
    "F1 regret": ("boundary_f1_regret", np.nanmean),
    "rho": ("spearman", np.nanmean),
}
CHANCE, ORACLE = "any candidate", "best candidate"
NAMED = 42  # letters of a case
CASE = ("group", "source", "case", "data", "seed")

Row = dict[str, Any]


def rule_ranks(scores: Sequence[CandidateScores]) -> list[int]:
    """The place of each in the order in which `best_candidate` picks them, picked ones taken away."""
    left, order = list(range(len(scores))), []
    while left:
        order.append(left.pop(best_candidate([scores[k] for k in left])))
    return [order.index(k) for k in range(len(scores))]


def choices(candidates: Iterable[Row]) -> list[Row]:
    """A row (group, source, case, data, seed, criterion, metric, value) for every case, criterion and metric.

    Beside the criteria stand a candidate drawn at random and the best there is. A criterion that says nothing
    of any candidate of a case has no row there; one that says nothing of some chooses among the others.
    """
    cases: dict[tuple[Any, ...], list[Row]] = defaultdict(list)
    for row in candidates:
        cases[tuple(row[name] for name in CASE)].append(row)
    rows = []
    for key, rows_of in cases.items():
        accuracy = np.array([row["accuracy"] for row in rows_of])
        boundary_f1 = np.array([row["boundary_f1"] for row in rows_of])
        costs = {
            name: np.array([np.nan if row[name] is None else sign * row[name] for row in rows_of], float)
            for name, sign in CRITERIA.items()
        }
        costs |= {CHANCE: np.zeros(len(rows_of)), ORACLE: -accuracy}
        for criterion, cost in costs.items():
            if np.isfinite(cost).any():
                shared = dict(zip(CASE, key, strict=True)) | {"criterion": criterion}
                found = _choice(cost, accuracy, boundary_f1)
                rows += [shared | {"metric": metric, "value": value} for metric, value in found.items()]
    return rows


def table(rows: Iterable[Row]) -> list[str]:
    """For every group of cases a line a criterion."""
    lines = []
    for group, found in _by_group(rows).items():
        source = group.split(",")[0]
        lines += ["", f"{group}: boundaries within {TOLERANCES[source]} frames"]
        lines.append("  ".join([f"{'criterion':<16}", "  n", *METRICS]))
        for criterion, values in found.items():
            cells = [
                _number(values.get(metric, []), summary, len(heading))
                for heading, (metric, summary) in METRICS.items()
            ]
            lines.append("  ".join([f"{criterion:<16}", f"{len(values['accuracy']):3}", *cells]))
    return lines


def fit_table(fits: Iterable[Row]) -> list[str]:
    """For every case the means over seeds with switch functions in the dynamic program and without."""
    metrics = ("accuracy", "precision", "recall", "boundary_f1")
    cases: dict[tuple[str, str], dict[float, list[Row]]] = {}
    for row in fits:
        case = cases.setdefault((row["group"], row["case"]), {})
        case.setdefault(row["switch_weight"], []).append(row)
    lines = ["  ".join([f"{'final segmentation':<{NAMED}}", "switch weight", "  n", *metrics])]
    for (group, name), weights in cases.items():
        for weight in sorted(weights, reverse=True):
            found = weights[weight]
            cells = [_number([row[metric] for row in found], np.nanmean, len(metric)) for metric in metrics]
            lines.append(
                "  ".join([f"{group} {name}"[:42].ljust(42), f"{weight:13g}", f"{len(found):3}", *cells])
            )
    return lines


def picture(rows: Iterable[Row]) -> Figure:
    """Rank correlation with accuracy and regret of every criterion, a dot for every group of cases."""
    groups = _by_group(rows)
    names = [name for name in [*CRITERIA, CHANCE] if any(name in found for found in groups.values())]
    figure = Figure(figsize=(WIDTH, 1.8 + 0.36 * len(names)), layout="constrained")
    panels = {"spearman": "rank correlation with accuracy", "regret": "accuracy lost to the best candidate"}
    for axis, (metric, heading) in zip(figure.subplots(1, 2, sharey=True), panels.items(), strict=True):
        for place, found in enumerate(groups.values()):
            means = [_mean(found.get(name, {}).get(metric, [])) for name in names]
            heights = np.arange(len(names)) + (place - (len(groups) - 1) / 2) * 0.14
            colour = PALETTE[place % len(PALETTE)]
            axis.plot(means, heights, "o", color=colour, markersize=7, clip_on=False)
        bare(axis)
        axis.tick_params(labelleft=True, labelbottom=True)
        axis.grid(axis="x", color=FAINT, linewidth=0.8)
        axis.axvline(0, color=FAINT, linewidth=2)
        axis.set_axisbelow(True)
        axis.set_title(heading, fontsize=11, loc="left")
        axis.set_yticks(range(len(names)), [name.replace("_", " ") for name in names])
        axis.set_ylim(len(names) - 0.5, -0.5)
        for boundary in np.arange(len(names) - 1) + 0.5:
            axis.axhline(boundary, color=FAINT, linewidth=0.5)
    legend(figure, [PALETTE[place % len(PALETTE)] for place in range(len(groups))], list(groups))
    set_title(figure, "Which criterion finds the true segmentation among candidates?")
    return figure


def _choice(cost: np.ndarray, accuracy: np.ndarray, boundary_f1: np.ndarray) -> dict[str, float]:
    """Of the candidates that cost least, ties shared; no rank correlation where either side has no ranks."""
    stated = np.isfinite(cost)
    least = cost == cost[stated].min()
    found = {"accuracy": accuracy[least].mean(), "regret": accuracy.max() - accuracy[least].mean()}
    found["boundary_f1"] = boundary_f1[least].mean()
    found["boundary_f1_regret"] = boundary_f1.max() - found["boundary_f1"]
    if len(set(cost[stated])) > 1 and len(set(accuracy[stated])) > 1 and stated.sum() > 2:
        found["spearman"] = spearmanr(-cost[stated], accuracy[stated]).statistic
    return {name: float(value) for name, value in found.items()}


def _by_group(rows: Iterable[Row]) -> dict[str, dict[str, dict[str, list[float]]]]:
    groups: dict[str, dict[str, dict[str, list[float]]]] = {}
    for row in rows:
        found = groups.setdefault(row["group"], {}).setdefault(row["criterion"], defaultdict(list))
        found[row["metric"]].append(row["value"])
    return groups


def _mean(values: Sequence[float]) -> float:
    return float(np.mean(values)) if len(values) else float("nan")


def _number(values: Sequence[float], summary: Any, width: int) -> str:
    return f"{summary(values):{width}.3f}" if len(values) else " " * (width - 1) + "-"
