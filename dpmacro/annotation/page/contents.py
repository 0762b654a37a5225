"""The page's data as JSON: run lengths for labels, bytes in base64 for numbers, no markup."""

import json
from base64 import b64encode
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int, Shaped, UInt8

from dpmacro.annotation.dimensions import explained, standardised
from dpmacro.annotation.page.shown import Curves, Shown
from dpmacro.annotation.page.sprites import Sheet
from dpmacro.annotation.stages import Stages
from dpmacro.figures.style import GREYS, PALETTE

__all__ = ["FORMAT", "as_script", "contents"]

FORMAT = "dpmacro corrections 1"  # of the file that the page saves
CURVE_BYTES = 3_000_000  # of all curves at most: of longer ones every second, third, ... frame is kept
DIMENSIONS = 64  # curves at most
SURE, LEVEL = 255, 254  # the byte of confidence 1; the highest byte of a curve, whose 255 says "not finite"
REGULAR = 5e-4  # seconds that a timestamp may be off frame / fps where none are written down


def contents(
    stages: Stages, dataset: str, shown: Shown, sheets: Sequence[Sequence[Sequence[Sheet]]] = ()
) -> dict[str, Any]:
    """All that the page's script reads.

    Args:
        stages, shown: as checked by `dpmacro.annotation.page.shown.check`.
        dataset: its name.
        sheets: for every camera and demonstration its pictures.
    """
    curves = list(_curves(shown.curves, stages.labels))
    step = curves[0][0] if curves else 1
    ends = np.cumsum(stages.lengths).tolist()
    demonstrations = []
    for place, (episode, end) in enumerate(zip(stages.episodes, ends, strict=True)):
        frames = slice(end - int(stages.lengths[place]), end)
        demonstrations.append(
            {
                "episode": int(episode),
                "frames": frames.stop - frames.start,
                "segments": _runs(stages.labels[frames]),
                "truth": None if shown.truth is None else _runs(shown.truth.labels[frames]),
                "confidence": _base64(np.rint(stages.confidence[frames] * SURE).astype(np.uint8)),
                "idle": _stretches(stages.idle[frames]),
                "corrected": _stretches(stages.corrected[frames]),
                "seconds": _seconds(stages.timestamps[frames], stages.fps),
                "curves": [_base64(values[frames][::step]) for _, _, values in curves],
                "sheets": [[vars(sheet) for sheet in camera[place]] for camera in sheets],
            }
        )
    return {
        "format": FORMAT,
        "dataset": dataset,
        "fps": stages.fps,
        "names": list(stages.names),
        "reasons": list(shown.reasons),
        "corrections": shown.corrections and {**shown.corrections, "format": FORMAT, "dataset": dataset},
        "colours": PALETTE,
        "greys": GREYS,
        "truth": shown.truth and {"column": shown.truth.column, "names": list(shown.truth.names)},
        "cameras": list(shown.cameras),
        "curves": [axis for _, axis, _ in curves],
        "curve_step": step,
        "demonstrations": demonstrations,
    }


def as_script(data: dict[str, Any]) -> str:
    """JSON that may stand in a script element: ASCII, and no text in it is markup."""
    text = json.dumps(data, separators=(",", ":"), allow_nan=False)
    for letter in "<>&":
        text = text.replace(letter, f"\\u{ord(letter):04x}")
    return text


def _runs(labels: Int[np.ndarray, " frames"]) -> list[list[int]]:
    """First frame and label of every run of equal labels."""
    starts = [0, *(np.flatnonzero(np.diff(labels)) + 1).tolist()]
    return [[start, int(labels[start])] for start in starts]


def _stretches(marked: Bool[np.ndarray, " frames"]) -> list[list[int]]:
    """First frame and end (excluded) of every run of marked frames."""
    edges = np.flatnonzero(np.diff(marked.astype(np.int8), prepend=0, append=0))
    return edges.reshape(-1, 2).tolist()


def _seconds(timestamps: Float[np.ndarray, " frames"], fps: float) -> str | None:
    """Float32 in base64; None where they are frame / fps."""
    regular = np.arange(len(timestamps)) / fps
    if (np.abs(timestamps - regular) < REGULAR).all():
        return None
    return _base64(timestamps.astype("<f4"))


def _curves(
    shown: Sequence[Curves], labels: Int[np.ndarray, " frames"]
) -> Iterator[tuple[int, dict[str, Any], UInt8[np.ndarray, " frames"]]]:
    """Of every curve the frames between two that are kept, what it is, and its values as bytes.

    What it is: its name, its range, and the share of its variance that the stages explain.
    """
    columns = [(name, curves.values[:, dim]) for curves in shown for dim, name in enumerate(curves.names)]
    columns = columns[:DIMENSIONS]
    step = max(1, -(-len(columns) * len(labels) // CURVE_BYTES))
    for name, values in columns:
        finite = np.isfinite(values)
        known = values[finite].astype(np.float64)
        low, high = (float(known.min()), float(known.max())) if len(known) else (0.0, 0.0)
        levels = np.full(len(values), LEVEL + 1, np.uint8)
        levels[finite] = np.rint((known - low) / ((high - low) or 1.0) * LEVEL).astype(np.uint8)
        telling = (
            explained(standardised(known[:, None].astype(np.float32)), labels[finite])
            if len(known)
            else [0.0]
        )
        yield step, {"name": name, "low": low, "high": high, "explained": float(telling[0])}, levels


def _base64(values: Shaped[np.ndarray, "..."]) -> str:
    return b64encode(np.ascontiguousarray(values).tobytes()).decode()
