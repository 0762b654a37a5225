"""The runs of an evaluation, as text and as eval_info.json."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from dpmacro.evaluation.stage import DIAGNOSIS
from dpmacro.evaluation.summary import eval_info, run_notes, run_text
from dpmacro.metrics.success import SuccessSummary, success_summary
from dpmacro.utils.files import replacing
from dpmacro.worlds import diagnosis_of
from dpmacro.worlds.base import Episode
from dpmacro.worlds.making import blamed

__all__ = ["Result"]


@dataclass(frozen=True)
class Result:
    """The runs of an evaluation and how long they took."""

    world: str
    episodes: list[Episode]
    seconds: float

    @cached_property
    def summary(self) -> SuccessSummary:
        """Counts of how they ended."""
        return success_summary(
            [episode.outcome for episode in self.episodes],
            [int(episode.phases[-1]) for episode in self.episodes],
            [int(episode.macros[-1]) for episode in self.episodes],
        )

    @cached_property
    def causes(self) -> list[str]:
        """Why each failed."""
        with blamed(self.world, "after the runs", DIAGNOSIS):
            return diagnosis_of(self.world).causes(self.episodes)

    def text(self) -> str:
        """For people."""
        loops = sum(episode.loop > 0 for episode in self.episodes)
        return "\n".join(
            [run_text(self.summary, self.seconds, self.causes, loops), *run_notes(self.episodes)]
        )

    def info(self, ran: dict[str, Any], videos: Sequence[str] = ()) -> dict[str, Any]:
        """What the file holds, `ran` in our section."""
        with blamed(self.world, "after the runs", DIAGNOSIS):
            events = diagnosis_of(self.world).events(self.episodes)
        about = self.summary, self.causes, events, self.seconds
        info = eval_info(self.world, self.episodes, *about, videos)
        info["dpmacro"] |= ran
        return info

    def write(self, place: Path, ran: dict[str, Any], videos: Sequence[str] = ()) -> None:
        """Write the file."""
        with replacing(place) as path:
            path.write_text(json.dumps(self.info(ran, videos), indent=2) + "\n")
