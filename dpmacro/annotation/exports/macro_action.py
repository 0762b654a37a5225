"""The columns that every annotated dataset has, and the file that names the stages."""

import json
from pathlib import Path
from typing import Any

import numpy as np

from dpmacro.annotation.exports.base import Export, Labelled, Make

__all__ = ["STAGES_FILE", "MacroAction"]

STAGES_FILE = "meta/dpmacro_stages.json"


class MacroAction(Export):
    """`macro_action` int64, `confidence` float32, `idle` bool, `corrected` bool, a number a frame each.

    `meta/dpmacro_stages.json` holds the names of the stages 0..K-1 and the formats of the dataset.
    """

    name = "macro_action"
    columns = ("macro_action", "confidence", "idle", "corrected")
    files = (STAGES_FILE,)

    def __init__(self, labelled: Labelled, formats: tuple[str, ...]):
        super().__init__(labelled)
        self.formats = formats

    def numbers(self) -> dict[str, Any]:
        """The columns of frames."""
        stages = self.stages
        values = stages.labels, stages.confidence.astype(np.float32), stages.idle, stages.corrected
        return dict(zip(self.columns, values, strict=True))

    def make(self) -> dict[str, Make]:
        """The file of names."""

        def write(path: Path) -> None:
            content = {"stages": list(self.stages.names), "formats": list(self.formats)}
            path.write_text(json.dumps(content, indent=4, ensure_ascii=False) + "\n", encoding="utf-8")

        return {STAGES_FILE: write}
