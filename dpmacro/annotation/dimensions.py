"""Numbers of vectors of action: how far off they are, and which of them tell macro-actions apart."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Float32, Int

from dpmacro.data.demonstrations import Demonstrations
from dpmacro.data.vectors import EPSILON
from dpmacro.figures import Line

__all__ = ["action_lines", "explained", "grippers", "standardised"]

SHOWN = 8  # dimensions drawn at most
OF_GRIPPERS = ("grip", "finger", "claw", "suction", "vacuum")
HANDS = 2  # where more dimensions than these have two positions, that is how all are moved
AT_ENDS, ONE_END = 0.8, 0.1  # share of frames near the two ends of a gripper's range, and at each at least
NEAR = 0.15  # of the range


def standardised(
    actions: Float32[np.ndarray, "frames dims"],
) -> Float32[np.ndarray, "frames dims"]:
    """Every dimension in its standard deviations off its mean; 0 where it is constant but for rounding."""
    values = actions.astype(np.float64)
    mean, spread = values.mean(0), values.std(0)
    varies = spread > EPSILON * np.abs(values).max(0)
    return np.where(varies, (values - mean) / np.where(varies, spread, 1), 0).astype(np.float32)


def explained(
    values: Float32[np.ndarray, "frames dims"], labels: Int[np.ndarray, " frames"]
) -> Float[np.ndarray, " dims"]:
    """Share, 0 to 1, of each dimension's variance that is one between macro-actions (eta squared).

    `values` are standardised.
    """
    between = np.zeros(values.shape[1])
    for macro in np.unique(labels).tolist():
        held = labels == macro
        between += held.mean() * values[held].mean(0, dtype=np.float64) ** 2
    return between


def grippers(values: Float32[np.ndarray, "frames dims"], names: Sequence[str]) -> list[int]:
    """The dimensions that vary and are grippers by their names or, where none is, that have two positions.

    Those are near one end of their range or near the other, at each for a while and seldom between. Where
    more than `HANDS` have two positions none is a gripper.
    """
    varies = [dim for dim in range(values.shape[1]) if np.ptp(values[:, dim]) > 0]
    named = [dim for dim in varies if any(word in names[dim].lower() for word in OF_GRIPPERS)]
    two = [] if named else [dim for dim in varies if _has_two_positions(values[:, dim])]
    return named or (two if len(two) <= HANDS else [])


def action_lines(demonstrations: Demonstrations, labels: Int[np.ndarray, " frames"]) -> list[Line]:
    """The dimensions to draw along time: grippers, tall, then those that tell macro-actions apart best.

    At most `SHOWN`, none that is constant; both kinds in their own order. Of more grippers than half of
    that the best are drawn. Raises ValueError where actions are no vectors.
    """
    if not demonstrations.vector:
        raise ValueError(f"the actions of {demonstrations.root} are classes: they have no dimensions")
    values, names = standardised(demonstrations.actions), demonstrations.action_names
    order = np.argsort(-explained(values, labels), kind="stable").tolist()
    found = grippers(values, names)
    first = [dim for dim in order if dim in found][: SHOWN // 2]
    others = [dim for dim in order if dim not in first and np.ptp(values[:, dim]) > 0]
    chosen = [*sorted(first), *sorted(others[: SHOWN - len(first)])]
    return [Line(_row_name(names[dim]), values[:, dim], dim in found) for dim in chosen]


def _has_two_positions(values: Float32[np.ndarray, " frames"]) -> bool:
    low, high = np.quantile(values, (0.01, 0.99))
    place = (values - low) / max(high - low, np.finfo(np.float32).tiny)
    ends = [float((place < NEAR).mean()), float((place > 1 - NEAR).mean())]
    return sum(ends) >= AT_ENDS and min(ends) >= ONE_END


def _row_name(name: str) -> str:
    """A number says that it is of an action; a name stands as it is."""
    return f"action {name}" if name.isdecimal() else name
