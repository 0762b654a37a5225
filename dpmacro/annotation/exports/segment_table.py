"""Segments as a table for people: spreadsheets open it, and scripts read it in a line."""

import csv
from pathlib import Path

import numpy as np

from dpmacro.annotation.exports.base import Export, Make

__all__ = ["SegmentTable"]

FILE = "labels.csv"
HEAD = ("episode", "start_frame", "end_frame", "start_s", "end_s", "label", "confidence", "source")


class SegmentTable(Export):
    """`labels.csv`: a line for every segment.

    Frames count from the episode's first, the end is excluded; seconds are the frames' own, the end of the
    last segment one frame after the last. The confidence is the frames' mean. The source is `person` where a
    person said the label of every frame, `dpmacro` elsewhere.
    """

    name = "csv"
    files = (FILE,)

    def make(self) -> dict[str, Make]:
        """The table."""

        def write(path: Path) -> None:
            with path.open("w", newline="", encoding="utf-8") as file:
                writer = csv.writer(file)
                writer.writerow(HEAD)
                for episode, part, segments in zip(
                    self.stages.episodes, self.stages.trajectories, self.labelled.segments, strict=True
                ):
                    for label, start, end in segments:
                        writer.writerow(self._row(episode, part, label, start, end))

        return {FILE: write}

    def _row(self, episode: int, part: slice, label: int, start: int, end: int) -> list[object]:
        stages, frames = self.stages, slice(part.start + start, part.start + end)
        seconds = stages.timestamps[part].astype(np.float64)
        after = seconds[end] if end < len(seconds) else seconds[-1] + 1 / stages.fps
        by_person = bool(stages.corrected[frames].all())
        return [
            episode,
            start,
            end,
            _short(seconds[start]),
            _short(after),
            self.labelled.name(label),
            round(float(stages.confidence[frames].mean(dtype=np.float64)), 4),
            "person" if by_person else "dpmacro",
        ]


def _short(seconds: float) -> str:
    """As many digits as tell the time from others in float32, in which LeRobot stores it."""
    return str(np.float32(seconds))
