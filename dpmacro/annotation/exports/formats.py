"""The formats by name, and which of them the installed LeRobot reads."""

import re
from collections.abc import Sequence
from importlib import metadata

from dpmacro.annotation.exports.base import Export, Labelled
from dpmacro.annotation.exports.language import Language
from dpmacro.annotation.exports.mimicgen import MimicGen
from dpmacro.annotation.exports.rabc import Rabc
from dpmacro.annotation.exports.sarm import Sarm
from dpmacro.annotation.exports.segment_table import SegmentTable
from dpmacro.annotation.exports.subtask_index import SubtaskIndex

__all__ = ["FORMATS", "choose", "default_formats"]

FORMATS: dict[str, type[Export]] = {
    export.name: export for export in (SubtaskIndex, Language, Sarm, Rabc, MimicGen, SegmentTable)
}
LANGUAGE_SINCE = (0, 6)  # LeRobot's version; those before read subtask_index


def default_formats() -> tuple[str, ...]:
    """What the installed LeRobot reads, and a table for people."""
    version = tuple(int(part) for part in re.findall(r"\d+", metadata.version("lerobot"))[:2])
    return ("language" if version >= LANGUAGE_SINCE else "subtask_index"), "csv"


def choose(
    formats: Sequence[str], inherited: Sequence[str], labelled: Labelled, skip: bool
) -> tuple[list[Export], list[str]]:
    """The formats that are written, and lines on those that are not.

    Args:
        formats: those asked for.
        inherited: those that the dataset has from an annotation before: written anew if they can be, since
            they would contradict the new labels.
        labelled: the dataset.
        skip: whether a format that cannot be written is left out with a line, rather than an error.

    Raises ValueError for a name that no format has and, unless `skip`, a format that cannot be written.
    """
    unknown = [name for name in formats if name not in FORMATS]
    if unknown:
        raise ValueError(f"formats hold {unknown[0]!r}: choose from {', '.join(FORMATS)}")
    chosen: list[Export] = []
    lines: list[str] = []
    for name in dict.fromkeys([*formats, *inherited]):
        export = FORMATS[name](labelled)
        reason = export.refusal()
        if reason is None:
            chosen.append(export)
            lines += export.notes()
        elif skip or name not in formats:
            lines.append(f"{name}: not written, {reason}")
        else:
            raise ValueError(f"{name}: cannot be written, {reason}")
    return chosen, lines
