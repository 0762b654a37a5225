"""Progress of every frame, which weighs samples where LeRobot trains with `--sample_weighting.type=rabc`."""

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from dpmacro.annotation.exports.base import Export, Make
from dpmacro.annotation.exports.ordered import unordered
from dpmacro.annotation.exports.sarm import HEADS, progress

__all__ = ["Rabc"]

PROGRESS = "sarm_progress.parquet"
NUMBERS = ("index", "episode_index", "frame_index")


class Rabc(Export):
    """`sarm_progress.parquet`: frames' numbers, and `progress_sparse` and `progress_dense` float32, 0..1."""

    name = "rabc"
    files = (PROGRESS,)

    def refusal(self) -> str | None:
        """Progress would go backwards where a stage comes back; without numbers no frame is found."""
        missing = [name for name in NUMBERS if name not in self.labelled.store.features]
        if missing:
            return f"the dataset has no column {', '.join(missing)}: record it with LeRobot"
        return unordered(self.labelled)

    def make(self) -> dict[str, Make]:
        """The table, in the order of `index`."""

        def write(path: Path) -> None:
            store = self.labelled.store
            found = store.columns(list(NUMBERS), store.episodes)
            order = np.argsort(found["index"], kind="stable")
            columns = {name: found[name].astype(np.int64)[order] for name in NUMBERS}
            done = progress(self.labelled).astype(np.float32)[order]
            pq.write_table(pa.table({**columns, **{f"progress_{head}": done for head in HEADS}}), path)

        return {PROGRESS: write}
