"""The report on a segmentation: pictures as PNG and in TensorBoard, its numbers as JSON, one HTML page."""

import json
from collections.abc import Iterator
from itertools import groupby
from pathlib import Path

from torch.utils.tensorboard import SummaryWriter

from dpmacro import figures
from dpmacro.annotation import html as page
from dpmacro.annotation.pictures import Picture, chosen_pixels
from dpmacro.annotation.summary import SCORES, Findings
from dpmacro.utils.files import replacing

__all__ = ["PAGE", "SHOWN", "SUMMARY", "score_text", "write_report"]

SHOWN = 30  # demonstrations with a picture of their own at most
UNSURE = 10  # demonstrations in the table of those least sure
PAGE, SUMMARY = "segmentation.html", "segmentation.json"


def write_report(findings: Findings, made: Iterator[Picture], folder: Path) -> None:
    """Write figures/*.png, tensorboard/, segmentation.json and segmentation.html into `folder`.

    `made` are the pictures, shown in their order.
    """
    shown: list[tuple[str, str]] = []
    with SummaryWriter(str(folder / "tensorboard")) as writer:
        for method, scores in findings.scores.items():
            group = "segmentation" if method == "policy" else f"segmentation/{method.replace(' ', '_')}"
            for name, value in scores.items():
                writer.add_scalar(f"{group}/{name}", value, 0)
        for picture in made:
            png = figures.to_png(picture.figure)
            with replacing(folder / "figures" / f"{picture.name}.png") as path:
                path.write_bytes(png)
            image = figures.to_image(picture.figure)
            writer.add_image(f"figures/{picture.name}", image, 0, dataformats="HWC")
            shown.append((picture.heading, page.picture(png, picture.alt, picture.caption)))
    with replacing(folder / SUMMARY) as path:
        path.write_text(json.dumps(findings.summary(), indent=2) + "\n")
    title = f"Segmentation of {findings.demonstrations.root.resolve().name}"
    with replacing(folder / PAGE) as path:
        path.write_text(page.page(title, _parts(findings, shown)), encoding="utf-8")


def score_text(findings: Findings) -> str:
    """The scores as lines of text in columns."""
    rows = [["", *findings.scores], *_score_rows(findings)]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = ([name.ljust(widths[0]), *map(str.rjust, cells, widths[1:])] for name, *cells in rows)
    return "\n".join("   ".join(line) for line in lines)


def _score_rows(findings: Findings) -> list[list[str]]:
    """What each score is, and its value for every method."""
    return [
        [text, *(_score(name, scores[name]) for scores in findings.scores.values())]
        for name, text in SCORES.items()
    ]


def _parts(findings: Findings, shown: list[tuple[str, str]]) -> Iterator[str]:
    """The page from top to bottom."""
    config, lengths = findings.policy.config, findings.lengths
    bound = len(findings.cost_by_bound) - 1
    yield page.facts(
        {
            **findings.sources,
            "demonstrations": f"{len(lengths)}, {int(lengths.sum()):,} frames",
            "macro-actions": f"{config.macros}, with at most {bound} transitions in a demonstration",
            "features": config.features,
        }
    )
    yield page.section("Scores", _scores(findings))
    yield page.section("Macro-actions", [_macros(findings)])
    yield page.section("Where to look first", [_least_sure(findings)])
    for heading, group in groupby(shown, key=lambda part: part[0]):
        parts = [html for _, html in group]
        if heading == "Demonstrations" and len(parts) < len(lengths):
            parts.insert(0, page.paragraph(f"The first {len(parts)} of {len(lengths)}."))
        yield page.section(heading, parts)
    if chosen_pixels(findings.policy) is None:
        text = "The classifiers are networks. They look at whole images, so there is no map of chosen pixels."
        yield page.section("What the classifiers look at", [page.paragraph(text)])


def _scores(findings: Findings) -> list[str]:
    if not findings.scores:
        return [page.paragraph("The dataset has no column of true labels to compare with.")]
    note = (
        f"Against the column {findings.demonstrations.truth_name}; 1 is best. Labels are matched to classes "
        f"one to one over the whole dataset, change points within {findings.tolerance} frames. Uniform and "
        "random cuts know the true classes and their order; those of random cuts are the mean of many draws."
    )
    return [page.table(["", *findings.scores], _score_rows(findings), note)]


def _macros(findings: Findings) -> str:
    rows = []
    for macro in findings.macros:
        action, share = max(macro["actions"].items(), key=lambda item: item[1])
        usual = f"{action}, {share:.0%}" if macro["segments"] else "none"
        shown = f"{macro['share']:.1%}", str(macro["segments"]), f"{macro['frames_per_segment']:.0f}"
        rows.append([str(macro["macro"]), *shown, f"{macro['confidence']:.2f}", usual])
    head = ["macro-action", "share of frames", "segments", "frames a segment", "confidence", "usual action"]
    return page.table(head, rows, "Confidence is the mean over frames, 0 to 1.")


def _least_sure(findings: Findings) -> str:
    order = sorted(range(len(findings.episodes)), key=lambda place: findings.confidence[place])[:UNSURE]
    head = ["demonstration", "frames", "segments", "confidence"]
    rows = [
        [
            str(findings.episodes[place]),
            str(findings.lengths[place]),
            str(len(findings.segments[place])),
            f"{findings.confidence[place]:.2f}",
        ]
        for place in order
    ]
    if findings.agreement is not None:
        head.append("frames that agree")
        for row, place in zip(rows, order, strict=True):
            row.append(f"{findings.agreement[place]:.1%}")
    return page.table(head, rows, f"The {len(rows)} demonstrations with the least mean confidence.")


def _score(name: str, value: float) -> str:
    return f"{value:.0f}" if name.endswith("segments") else f"{value:.3f}"
