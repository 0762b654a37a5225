"""What the page shows beside the stages: true labels, numbers along time, pictures, and a report."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field

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
    """

    truth: Truth | None = None
    curves: tuple[Curves, ...] = ()
    cameras: Mapping[str, Images] = field(default_factory=dict)
    reasons: tuple[str, ...] = ()
    facts: Mapping[str, str] = field(default_factory=dict)
    report: str = ""


def check(stages: Stages, shown: Shown) -> None:
    """Raise ValueError, one line, where parts do not fit together or hold what cannot be shown."""
    frames, n_stages = int(stages.lengths.sum()), len(stages.names)
    if not len(stages.lengths) or (stages.lengths < 1).any():
        raise ValueError(f"lengths {stages.lengths.tolist()}: give demonstrations of one frame at least")
    if len(stages.episodes) != len(stages.lengths):
        raise ValueError(f"{len(stages.episodes)} episodes of {len(stages.lengths)} lengths: give one each")
    if not n_stages or len(set(stages.names)) < n_stages or not all(map(str.strip, stages.names)):
        raise ValueError(f"stages {list(stages.names)}: give names that are distinct and not empty")
    if shown.reasons and len(shown.reasons) != n_stages:
        raise ValueError(f"{len(shown.reasons)} reasons of {n_stages} stages: give one each, or none")
    if not (np.isfinite(stages.fps) and stages.fps > 0):
        raise ValueError(f"fps={stages.fps}: give a positive number")
    of_frames = ("labels", "confidence", "idle", "corrected", "timestamps")
    rows = {name: getattr(stages, name) for name in of_frames}
    labels = [("labels", stages.labels, n_stages)]
    if shown.truth is not None:
        rows["truth"] = shown.truth.labels
        labels.append(("truth", shown.truth.labels, len(shown.truth.names)))
    for curves in shown.curves:
        rows[f"curve {', '.join(curves.names[:3])}"] = curves.values
        if curves.values.shape[1] != len(curves.names):
            raise ValueError(
                f"curves of {curves.values.shape[1]} numbers with {len(curves.names)} names: give one each"
            )
    for name, values in rows.items():
        if len(values) != frames:
            raise ValueError(f"{name} of {len(values)} frames: the demonstrations have {frames}")
    for name, values, count in labels:
        if values.min() < 0 or values.max() >= count:
            raise ValueError(f"{name} from {values.min()} to {values.max()}: give 0 to {count - 1}")
    sure = stages.confidence
    if not ((sure >= 0) & (sure <= 1)).all():
        raise ValueError(f"confidence from {sure.min()} to {sure.max()}: give 0 to 1")
    if not np.isfinite(stages.timestamps).all():
        raise ValueError("timestamps that are not finite: give seconds")
