"""What a format is: columns of frames, columns of episodes, and files, made of a dataset and its stages."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pyarrow as pa
from jaxtyping import Bool, Float, Int64

from dpmacro.annotation.stages import Stages
from dpmacro.data.lerobot.reader import StoredDataset

__all__ = ["Export", "Labelled", "Make"]

Make = Callable[[Path], None]  # writes a file to a path


@dataclass(frozen=True)
class Labelled:
    """A dataset and the stages of all its episodes.

    Attributes:
        store: the dataset.
        stages: in the order of `store.episodes`.
        places: of the rows of every data file: which of the frames in `stages` each is.
    """

    store: StoredDataset
    stages: Stages
    places: dict[Path, Int64[np.ndarray, " rows"]]

    @cached_property
    def segments(self) -> list[list[list[int]]]:
        """As `Stages.segments`."""
        return self.stages.segments

    def name(self, label: int) -> str:
        """What a stage is called."""
        return self.stages.names[label]


class Export:
    """A format; subclasses say what it consists of. What they leave out, their format has not.

    Attributes:
        name: by which it is asked for.
        columns: names of the columns that it gives frames.
        episode_columns: names of the columns that it gives episodes.
        files: what it consists of beside them: paths in the dataset.
    """

    name: ClassVar[str] = ""
    columns: ClassVar[tuple[str, ...]] = ()
    episode_columns: ClassVar[tuple[str, ...]] = ()
    files: ClassVar[tuple[str, ...]] = ()

    def __init__(self, labelled: Labelled):
        self.labelled = labelled
        self.stages = labelled.stages

    def refusal(self) -> str | None:
        """Why this format cannot say what the stages are, with a remedy; None where it can."""
        return None

    def notes(self) -> tuple[str, ...]:
        """What a user should know of the dataset once it has this format, a line each."""
        return ()

    def features(self) -> dict[str, dict[str, Any]]:
        """The columns of frames as meta/info.json has them."""
        return {
            name: {"dtype": str(values.dtype), "shape": [1], "names": None}
            for name, values in self.numbers().items()
        }

    def numbers(
        self,
    ) -> dict[str, Int64[np.ndarray, " frames"] | Float[np.ndarray, " frames"] | Bool[np.ndarray, " frames"]]:
        """The columns of frames that hold numbers; their statistics are written as well."""
        return {}

    def of_frames(self, places: Int64[np.ndarray, " rows"], table: pa.Table) -> dict[str, pa.Array]:
        """Its columns for some rows of a data file: which frames they are, and what stands there."""
        return {name: pa.array(values[places]) for name, values in self.numbers().items()}

    def of_episodes(self) -> dict[str, pa.Array]:
        """Its columns of meta/episodes, a value for every episode."""
        return {}

    def make(self) -> dict[str, Make]:
        """By the path of every file in the dataset, a function that writes it."""
        return {}
