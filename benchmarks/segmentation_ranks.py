"""What the table comes to: mean ranks over all cases, and how far dpmacro is from the best peer."""

from collections import defaultdict
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from scipy.stats import rankdata

__all__ = ["RANKED", "distances", "ranks"]

RANKED = ("accuracy", "edit", "f1_10", "f1_25", "f1_50", "boundary_f1")
OURS = "dpmacro"
TOLD = ("uniform cuts", "random cuts")  # who have the true labels in their true order

Case = tuple[str, str]


def ranks(rows: Iterable[Mapping[str, Any]], headings: Mapping[str, str]) -> list[str]:
    """A line for every method: its mean rank on every metric over the cases that it has an answer for.

    In a case methods are ranked by their means over seeds, 1 the best, equals sharing the mean of their
    ranks. Best mean over metrics first. Nothing where there are no rows.
    """
    found: dict[str, dict[str, list[float]]] = defaultdict(lambda: defaultdict(list))
    for case in _means(rows, RANKED).values():
        for metric, values in case.items():
            for method, rank in zip(values, rankdata([-value for value in values.values()]), strict=True):
                found[method][metric].append(float(rank))
    if not found:
        return []
    means = {method: [np.mean(of[metric]) for metric in RANKED] for method, of in found.items()}
    heads = [headings[metric] for metric in RANKED]
    lines = ["", "mean rank", "  ".join([f"{'method':<15}", " n", *heads, "all"])]
    for method in sorted(means, key=lambda method: np.mean(means[method])):
        cells = [f"{mean:{len(head)}.1f}" for mean, head in zip(means[method], heads, strict=True)]
        cases = len(found[method][RANKED[0]])
        lines.append("  ".join([f"{method:<15}", f"{cases:2}", *cells, f"{np.mean(means[method]):3.1f}"]))
    return lines


def distances(rows: Iterable[Mapping[str, Any]]) -> list[str]:
    """A line for every case that dpmacro has an answer for: its F1@50 less that of the best peer.

    Once of all peers, and once of those that are not told the true labels. Nothing where there is no case.
    """
    lines = []
    for (source, name), case in _means(rows, ("f1_50",)).items():
        values = dict(case["f1_50"])
        ours = values.pop(OURS, None)
        if ours is None or not values:
            continue
        cells = [f"{f'{source} {name}':<28}", f"{ours:7.3f}"]
        for peers in (values, {method: value for method, value in values.items() if method not in TOLD}):
            if peers:
                best = max(peers, key=lambda method: peers[method])
                cells.append(f"{ours - peers[best]:+.3f} {best:<15}")
        lines.append("  ".join(cells).rstrip())
    if lines:
        head = f"{'F1@50':<28}  dpmacro  to the best peer        to the best that is not told the labels"
        lines = ["", head, *lines]
    return lines


def _means(
    rows: Iterable[Mapping[str, Any]], metrics: Iterable[str]
) -> dict[Case, dict[str, dict[str, float]]]:
    """Case -> metric -> method -> mean over seeds."""
    values: dict[Case, dict[str, dict[str, list[float]]]] = {}
    for row in rows:
        if row["metric"] in metrics:
            case = values.setdefault((row["source"], row["case"]), {})
            case.setdefault(row["metric"], {}).setdefault(row["method"], []).append(row["value"])
    return {
        case: {
            metric: {method: float(np.mean(of)) for method, of in methods.items()}
            for metric, methods in found.items()
        }
        for case, found in values.items()
    }
