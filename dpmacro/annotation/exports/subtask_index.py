"""Subtasks as LeRobot 0.4 reads them: `LeRobotDataset(...)[i]["subtask"]` is a stage's name."""

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from dpmacro.annotation.exports.base import Export, Make

__all__ = ["SubtaskIndex"]

SUBTASKS = "meta/subtasks.parquet"


class SubtaskIndex(Export):
    """A column `subtask_index` int64, and `meta/subtasks.parquet`: names as the index, from stage 0 on."""

    name = "subtask_index"
    columns = ("subtask_index",)
    files = (SUBTASKS,)

    def numbers(self) -> dict[str, Any]:
        """The column of frames."""
        return {"subtask_index": self.stages.labels}

    def make(self) -> dict[str, Make]:
        """The file of names."""

        def write(path: Path) -> None:
            names = pd.Index(self.stages.names, name="subtask")
            pd.DataFrame({"subtask_index": np.arange(len(names))}, index=names).to_parquet(path)

        return {SUBTASKS: write}
