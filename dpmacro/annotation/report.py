"""The report on a segmentation: pictures as PNG and in TensorBoard, its numbers as JSON, the page."""

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Int64, UInt8

from dpmacro import figures
from dpmacro.annotation import html
from dpmacro.annotation.page.shown import Curves, Images, Shown, Truth
from dpmacro.annotation.page.write import write_page
from dpmacro.annotation.pictures import Picture, importances
from dpmacro.annotation.stages import Stages
from dpmacro.annotation.summary import SCORES, Summary
from dpmacro.features.base import input_name
from dpmacro.policy.config import InputConfig
from dpmacro.utils.events import Events
from dpmacro.utils.files import replacing

__all__ = ["NUMBERS", "PAGE", "SHOWN", "score_text", "shown_beside", "stages_of", "write_report"]

SHOWN = 30  # demonstrations with a picture of their own at most
LISTED = 12  # names of actions at most
STRIPS = ("All demonstrations", "Demonstrations")  # headings of pictures that the page's strips replace
PAGE, NUMBERS = "segmentation.html", "segmentation.json"


def write_report(
    summary: Summary,
    made: Iterator[Picture],
    folder: Path,
    stages: Stages | None = None,
    frames: int | None = None,
    cameras: Mapping[str, Images] | None = None,
    reasons: tuple[str, ...] = (),
    corrections: Mapping[str, Any] | None = None,
) -> None:
    """Write figures/*.png, tensorboard/, segmentation.json and segmentation.html into `folder`.

    Args:
        summary: what the numbers are taken from.
        made: the pictures, in their order; each is drawn, written and dropped before the next. Those that
            the page's strips show better (`STRIPS`) are not on the page.
        folder: made where it does not exist.
        stages: what the page shows and a person corrects, as it was found; `stages_of(summary)` by default.
        frames: pictures of a demonstration and camera on the page at most; 0 for none.
        cameras: where the page's pictures come from; the summary's images by default.
        reasons: why the stages have their names.
        corrections: what a person corrected of the stages earlier, see `Shown`.
    """
    report: list[tuple[str, str]] = []
    with Events(folder / "tensorboard") as writer:
        for method, scores in summary.scores.items():
            group = "segmentation" if method == "policy" else f"segmentation/{method.replace(' ', '_')}"
            for name, value in scores.items():
                writer.add_scalar(f"{group}/{name}", value, 0)
        for picture in made:
            with figures.surviving(picture.name):
                png = figures.to_png(picture.figure)
                with replacing(folder / "figures" / f"{picture.name}.png") as path:
                    path.write_bytes(png)
                image = figures.to_image(picture.figure)
                writer.add_image(f"figures/{picture.name}", image, 0, dataformats="HWC")
                if picture.heading not in STRIPS:
                    report.append((picture.heading, html.picture(png, picture.alt, picture.caption)))
    shown = shown_beside(summary, "".join(_parts(summary, report)), cameras, reasons)
    shown = replace(shown, corrections=corrections)
    name = summary.demonstrations.root.resolve().name
    write_page(folder / PAGE, stages or stages_of(summary), name, shown, frames)
    with replacing(folder / NUMBERS) as path:  # last: it says that the report is complete
        path.write_text(json.dumps(summary.as_json(), indent=2) + "\n")


def stages_of(summary: Summary) -> Stages:
    """The macro-actions of a segmentation as stages named by their numbers, none idle, none corrected."""
    lengths, fps, n_frames = summary.lengths, float(summary.demonstrations.fps), len(summary.labels)
    within = np.arange(n_frames) - np.repeat(np.cumsum(lengths) - lengths, lengths)
    return Stages(
        labels=summary.labels,
        confidence=summary.frame_confidence,
        idle=np.zeros(n_frames, bool),
        corrected=np.zeros(n_frames, bool),
        names=tuple(f"macro-action {macro}" for macro in range(summary.policy.config.macros)),
        lengths=lengths,
        episodes=summary.episodes,
        timestamps=within / fps,
        fps=fps,
    )


def shown_beside(
    summary: Summary,
    report: str,
    cameras: Mapping[str, Images] | None = None,
    reasons: tuple[str, ...] = (),
) -> Shown:
    """What the page shows beside the stages: truth, the numbers of actions and states, images, the report."""
    demonstrations = summary.demonstrations
    truth, curves = None, []
    if demonstrations.truth is not None:
        known = demonstrations.truth_classes
        names = (*known, *map(str, range(len(known), int(demonstrations.truth.max()) + 1)))
        truth = Truth(demonstrations.truth, names, demonstrations.truth_name or "truth")
    if demonstrations.vector:
        curves.append(Curves(demonstrations.actions, demonstrations.action_names))
    for key, names in demonstrations.state_names.items():
        named = tuple(f"{input_name(key)} {name}" for name in names)
        curves.append(Curves(demonstrations.observations[key], named))
    if cameras is None:
        cameras = {input_name(key): partial(_images, summary, key) for key in demonstrations.cameras}
    return Shown(truth, tuple(curves), cameras, reasons, _facts(summary), report)


def _images(
    summary: Summary, camera: str, frames: Int64[np.ndarray, " chosen"]
) -> Iterator[UInt8[np.ndarray, "height width 3"]]:
    return (summary.demonstrations.observations[camera][frame] for frame in frames)


def score_text(summary: Summary) -> str:
    """The scores as lines of text in columns."""
    rows = [["", *summary.scores], *_score_rows(summary)]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = ([name.ljust(widths[0]), *map(str.rjust, cells, widths[1:])] for name, *cells in rows)
    return "\n".join("   ".join(line) for line in lines)


def _score_rows(summary: Summary) -> list[list[str]]:
    """What each score is, and its value for every method."""
    return [
        [text, *(_score(name, scores[name]) for scores in summary.scores.values())]
        for name, text in SCORES.items()
    ]


def _parts(summary: Summary, report: list[tuple[str, str]]) -> Iterator[str]:
    """The report from top to bottom."""
    yield html.section("Scores", _scores(summary))
    yield html.section("Macro-actions", [_macros(summary)])
    for heading, group in groupby(report, key=lambda headed: headed[0]):
        yield html.section(heading, [part for _, part in group])
    if importances(summary.policy) is None:
        text = "The classifiers are networks. They look at whole images, so there is no map of chosen pixels."
        yield html.section("What the classifiers look at", [html.paragraph(text)])


def _facts(summary: Summary) -> dict[str, str]:
    """What was segmented, and by what."""
    config, lengths = summary.policy.config, summary.lengths
    chain = config.order == "chain"
    bound, names = config.macros - 1 if chain else len(summary.cost_by_bound) - 1, config.action_names
    order = "chain: each once, one after the other" if chain else "free"
    facts = {
        **summary.sources,
        "demonstrations": f"{len(lengths)}, {int(lengths.sum()):,} frames",
        "macro-actions": f"{config.macros}, with at most {bound} transitions in a demonstration",
        "order": order,
        "inputs": ", ".join(config.inputs),
        "cameras": ", ".join(map(_camera, config.cameras, (config.inputs[key] for key in config.cameras))),
        "actions": f"{len(names)} {'numbers' if config.vector else 'classes'}: {_listed(names)}",
    }
    return {name: value for name, value in facts.items() if value}


def _camera(key: str, one: InputConfig) -> str:
    """A camera with the size of its images, "front 64x48, shrunk from 640x480"."""
    height, width, _ = one.shape
    stored = one.stored_shape
    return f"{input_name(key)} {width}x{height}" + (
        f", shrunk from {stored[1]}x{stored[0]}" if stored else ""
    )


def _listed(names: Sequence[str]) -> str:
    more = f" and {len(names) - LISTED} more" if len(names) > LISTED else ""
    return ", ".join(names[:LISTED]) + more


def _scores(summary: Summary) -> list[str]:
    if not summary.scores:
        return [html.paragraph("The dataset has no column of true labels to compare with.")]
    note = (
        f"Against the column {summary.demonstrations.truth_name}; 1 is best. Labels are matched to classes "
        f"one to one over the whole dataset, change points within {summary.tolerance} frames. Uniform and "
        "random cuts know the true classes and their order; those of random cuts are the mean of many draws."
    )
    return [html.table(["", *summary.scores], _score_rows(summary), note)]


def _macros(summary: Summary) -> str:
    rows = []
    for macro in summary.macros:
        shown = f"{macro['share']:.1%}", str(macro["segments"]), f"{macro['frames_per_segment']:.0f}"
        rows.append([str(macro["macro"]), *shown, f"{macro['confidence']:.2f}", _usual(macro)])
    head = ["macro-action", "share of frames", "segments", "frames a segment", "confidence"]
    note = "Confidence is the mean over frames, 0 to 1."
    if not summary.demonstrations.vector:
        return html.table([*head, "usual action"], rows, note)
    note += (
        " What tells most is the number of the action whose mean over the macro-action's frames is farthest "
        "from its mean over all frames, in standard deviations (sd) of all frames."
    )
    return html.table([*head, "what tells most"], rows, note)


def _usual(macro: dict[str, Any]) -> str:
    """What the actions of a macro-action have of their own."""
    if not macro["segments"]:
        return "none"
    if "actions" in macro:
        action, share = max(macro["actions"].items(), key=lambda item: item[1])
        return f"{action}, {share:.0%}"
    most = max(macro["dimensions"], key=lambda dimension: abs(dimension["deviations"]))
    way = "high" if most["deviations"] > 0 else "low"
    return f"{most['name']} {way}, {most['deviations']:+.1f} sd"


def _score(name: str, value: float) -> str:
    return f"{value:.0f}" if name.endswith("segments") else f"{value:.3f}"
