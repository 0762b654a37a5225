"""What the page shows beside the stages: true labels, numbers along time, pictures, and a report."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Float, Int, Int64, UInt8

from dpmacro.annotation.stages import Stages

__all__ = ["Curves", "Images", "Shown", "Truth", "check"]

# Frames 0..N-1 of all demonstrations, ascending -> their RGB images of one size, in that order.
Images = Callable[[Int64[np.ndarray, " _"]], Iterable[UInt8[np.ndarray, "_ _ 3"]]]


@dataclass(frozen=True)
class Truth:
    """True labels to compare with.

    Attributes:
        labels: of every frame, 0..C-1.
        names: of the C classes.
        column: the dataset's column that holds them.
    """

    labels: Int[np.ndarray, " frames"]
    names: tuple[str, ...]
    column: str = "truth"


@dataclass(frozen=True)
class Curves:
    """Numbers along time, of an action or a state; what is not finite is left out of the line.

    Attributes:
        values: of every frame, in the dataset's own units.
        names: one for each dimension.
    """

    values: Float[np.ndarray, "frames dims"]
    names: tuple[str, ...]


@dataclass(frozen=True)
class Shown:
    """All of it; each part may be missing.

    Attributes:
        truth: drawn as a thin strip below the stages.
        curves: of the action, the state or both, drawn where a person asks for them.
        cameras: name -> what gives the images of the frames asked for. It is asked once.
        reasons: why each stage has its name, in the order of the stages' names; () for no reasons.
        facts: what was segmented and how, name -> text.
        report: markup of sections that stand below, made by `dpmacro.annotation.html`.
        corrections: what a person corrected of the stages earlier, as `Corrections.of_stages` tells it: the
            page opens with that, and saves it with what is corrected there. None for nothing.
    """

    truth: Truth | None = None
    curves: tuple[Curves, ...] = ()
    cameras: Mapping[str, Images] = field(default_factory=dict)
    reasons: tuple[str, ...] = ()
    facts: Mapping[str, str] = field(default_factory=dict)
    report: str = ""
    corrections: Mapping[str, Any] | None = None


def check(stages: Stages, shown: Shown) -> None:
    """Raise ValueError, one line, where what is shown does not fit the stages."""
    frames, n_stages = len(stages.labels), len(stages.names)
    if shown.reasons and len(shown.reasons) != n_stages:
        raise ValueError(f"{len(shown.reasons)} reasons of {n_stages} stages: give one each, or none")
    rows = {}
    for curves in shown.curves:
        rows[f"curve {', '.join(curves.names[:3])}"] = len(curves.values)
        if curves.values.shape[1] != len(curves.names):
            raise ValueError(
                f"curves of {curves.values.shape[1]} numbers with {len(curves.names)} names: give one each"
            )
    truth = shown.truth
    if truth is not None:
        rows["truth"] = len(truth.labels)
    for name, count in rows.items():
        if count != frames:
            raise ValueError(f"{name} of {count} frames: the demonstrations have {frames}")
    if truth is not None and (truth.labels.min() < 0 or truth.labels.max() >= len(truth.names)):
        raise ValueError(
            f"truth from {truth.labels.min()} to {truth.labels.max()}: give 0 to {len(truth.names) - 1}"
        )
