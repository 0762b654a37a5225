"""Subtasks' ends as MimicGen reads them, in an HDF5 file."""

import io
from pathlib import Path

import h5py
import numpy as np

from dpmacro.annotation.exports.base import Export, Make
from dpmacro.annotation.exports.ordered import order_of, unordered

__all__ = ["MimicGen"]

FILE = "mimicgen.hdf5"


class MimicGen(Export):
    """`mimicgen.hdf5`: `data/demo_<episode>/datagen_info/subtask_term_signals/<stage>`, an integer a frame.

    The signal of a stage is 0 before the stage's last frame and 1 from it on. The last stage has none:
    it ends with the demonstration.
    """

    name = "mimicgen"
    files = (FILE,)

    def refusal(self) -> str | None:
        """MimicGen looks for the first change from 0 to 1 of every signal, in every demonstration."""
        reason = unordered(self.labelled)
        if reason is not None:
            return reason
        order = order_of(self.labelled)
        if len(order) < 2:
            return "there is one stage only, and the last has no signal: leave it out, or find more stages"
        wrong = [name for name in map(self.labelled.name, order) if "/" in name or name in (".", "..")]
        if wrong:
            return f"a stage is called {wrong[0]!r}, which no HDF5 path can be: give it a name without '/'"
        for episode, segments in zip(self.stages.episodes, self.labelled.segments, strict=True):
            if segments[0][2] < 2:
                return (
                    f"the first stage of episode {episode} has one frame, so that its signal never changes: "
                    "move its end, or leave out the episode"
                )
        return None

    def make(self) -> dict[str, Make]:
        """The file of signals."""

        def write(path: Path) -> None:
            lengths = self.stages.lengths.tolist()
            content = io.BytesIO()  # h5py cannot give up a file on a full disk
            with h5py.File(content, "w") as file:
                parts = zip(self.stages.episodes, lengths, self.labelled.segments, strict=True)
                for episode, length, segments in parts:
                    demonstration = file.create_group(f"data/demo_{episode}")
                    demonstration.attrs["num_samples"] = length
                    signals = demonstration.create_group("datagen_info/subtask_term_signals")
                    for label, _, end in segments[:-1]:
                        ended = (np.arange(length) >= end - 1).astype(np.int64)
                        signals.create_dataset(self.labelled.name(label), data=ended, compression="gzip")
            path.write_bytes(content.getbuffer())

        return {FILE: write}
