"""Runs as MP4, with the macro-action, phase and action of every step written under the picture."""

from collections.abc import Iterable, Iterator, Sequence
from itertools import chain, repeat
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
from jaxtyping import UInt8
from matplotlib.colors import to_rgb

from dpmacro.figures import OUTCOME_COLOURS, macro_colour
from dpmacro.utils.files import replacing
from dpmacro.worlds.base import NO_MACRO, NO_PHASE, Moment

WIDTH = 640
STRIP = 48
NUMBERS = 4  # of a vector that the strip has room for
SECONDS_OF_OUTCOME = 1.5
PAPER, INK = (250, 250, 250), (34, 34, 34)
OTHER_OUTCOME = "#666666"  # the colour of an outcome that the charts know no colour for


def write_run(path: Path, moments: Iterable[Moment], action_names: Sequence[str] = (), fps: int = 30) -> int:
    """Write a run, as `rollouts.replay` yields it; its last frame stays on, with the outcome written over it.

    Returns the number of frames written. H.264 in yuv420p, which every browser plays.

    Raises:
        ValueError: no moments, or none that was rendered.
    """
    return write_video(path, drawn_run(moments, action_names, fps), fps)


def drawn_run(
    moments: Iterable[Moment], action_names: Sequence[str] = (), fps: int = 30
) -> Iterator[UInt8[np.ndarray, "height width 3"]]:
    """The frames of a run: its rendered moments, each with its step written under it, and the outcome."""
    frame = None
    for step, moment in enumerate(moments):
        if moment.view is not None:
            frame = _with_strip(moment.view, moment, step, action_names)
            yield frame
        if moment.outcome and frame is not None:
            yield from repeat(_with_outcome(frame, moment.outcome), int(SECONDS_OF_OUTCOME * fps))


def write_video(path: Path, frames: Iterable[UInt8[np.ndarray, "height width 3"]], fps: int = 30) -> int:
    """Write `frames`, all of one even size, to an MP4 that appears whole or not at all; how many they were.

    Raises:
        ValueError: no frames, or an odd size, which yuv420p cannot hold.
    """
    remaining = iter(frames)
    first = next(remaining, None)
    if first is None:
        raise ValueError(f"no rendered frames to write to {path}")
    height, width = first.shape[:2]
    if height % 2 or width % 2:
        raise ValueError(f"frames are {width} x {height}, both must be even for H.264 in yuv420p")
    written = 0
    with replacing(path) as temporary, av.open(str(temporary), "w", options={"movflags": "faststart"}) as out:
        stream = out.add_stream("libx264", rate=fps, options={"crf": "20", "preset": "veryfast"})
        stream.width, stream.height, stream.pix_fmt = width, height, "yuv420p"
        for frame in chain([first], remaining):
            out.mux(stream.encode(av.VideoFrame.from_ndarray(frame, format="rgb24")))
            written += 1
        out.mux(stream.encode())
    return written


def _with_strip(
    view: UInt8[np.ndarray, "_height _width 3"], moment: Moment, step: int, action_names: Sequence[str]
) -> UInt8[np.ndarray, "height width 3"]:
    height = round(view.shape[0] * WIDTH / view.shape[1] / 2) * 2
    frame = np.full((height + STRIP, WIDTH, 3), PAPER, np.uint8)
    frame[:height] = cv2.resize(view, (WIDTH, height), interpolation=cv2.INTER_LINEAR)
    if moment.macro != NO_MACRO:
        shade = _rgb(macro_colour(moment.macro))
        frame[height:, :180] = shade
        ink = PAPER if np.dot(shade, (0.3, 0.59, 0.11)) < 140 else INK
        _write(frame, f"macro-action {moment.macro}", 14, height + 31, ink)
    text = _action_text(moment.action, action_names)
    if moment.phase == NO_PHASE:
        _write(frame, text, 200, height + 31, INK)
    else:
        _write(frame, f"phase {moment.phase}", 200, height + 31, INK)
        _write(frame, text, 310, height + 31, INK)
    _write(frame, f"step {step}", 530, height + 31, INK)
    return frame


def _action_text(action: Any, names: Sequence[str]) -> str:
    """The name of a class, or the first numbers of a vector."""
    if np.ndim(action):
        shown = action if len(action) <= NUMBERS else action[: NUMBERS - 1]
        # Rounded, small negative numbers would read -0.0.
        numbers = [f"{round(float(number), 1) + 0.0:+.1f}" for number in shown]
        return " ".join([*numbers, "..."] if len(action) > NUMBERS else numbers)
    return names[action].replace("_", " ") if action < len(names) else f"action {action}"


def _with_outcome(
    frame: UInt8[np.ndarray, "height width 3"], outcome: str
) -> UInt8[np.ndarray, "height width 3"]:
    frame = frame.copy()
    text = outcome.replace("_", " ")
    (width, _), _ = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, 1.0, 2)
    top, left = (frame.shape[0] - STRIP) // 2 - 36, (WIDTH - width) // 2 - 24
    frame[top : top + 72, left : left + width + 48] = _rgb(OUTCOME_COLOURS.get(outcome, OTHER_OUTCOME))
    cv2.putText(frame, text, (left + 24, top + 47), cv2.FONT_HERSHEY_SIMPLEX, 1.0, PAPER, 2, cv2.LINE_AA)
    return frame


def _write(
    frame: UInt8[np.ndarray, "height width 3"], text: str, left: int, base: int, ink: tuple[int, int, int]
) -> None:
    cv2.putText(frame, text, (left, base), cv2.FONT_HERSHEY_SIMPLEX, 0.58, ink, 1, cv2.LINE_AA)


def _rgb(colour: str) -> tuple[int, int, int]:
    red, green, blue = (round(255 * part) for part in to_rgb(colour))
    return red, green, blue
