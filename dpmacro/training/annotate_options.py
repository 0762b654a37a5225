"""Options of datasets/annotate.py. Every mistake in them is a ValueError of one line."""

from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

from dpmacro.annotation.exports.formats import FORMATS
from dpmacro.annotation.naming import checked_names
from dpmacro.training.options import DatasetOptions, PlannerOptions

__all__ = ["AnnotateOptions", "PageOptions", "PolicyOptions", "SearchOptions"]

# Options of a training's data, which a policy has had.
POLICYS_OWN = ("inputs", "camera", "action_relative", "image_size", "symmetric", "labels")


@dataclass(frozen=True)
class SearchOptions(PlannerOptions):
    """How the stages are found where no policy is given; train.py's options."""

    macros: int | str | None = "auto"
    """Number of stages Q; auto chooses between 1 and max_macros by left-out data."""
    order: str = "auto"
    """Order of stages, free, chain for the same one in all demonstrations, or auto by the data."""


@dataclass(frozen=True)
class PolicyOptions:
    """What segments the demonstrations."""

    path: Path | None = None
    """Folder `pretrained_model` of a training run; without it the stages are found first."""


@dataclass(frozen=True)
class PageOptions:
    """The page on which people look and correct."""

    frames: int | None = None
    """Images of a demonstration from every camera; by default 100, or 2 a second, as far as 18 MB allow."""

    def __post_init__(self) -> None:
        if self.frames is not None and self.frames < 1:
            raise ValueError(f"page.frames is {self.frames}: give 1 or more")


@dataclass(frozen=True)
class AnnotateOptions:
    """Options of datasets/annotate.py."""

    policy: PolicyOptions = field(default_factory=PolicyOptions)
    dataset: DatasetOptions = field(default_factory=DatasetOptions)
    planner: SearchOptions = field(default_factory=SearchOptions)
    page: PageOptions = field(default_factory=PageOptions)
    output: Path | None = None
    """Folder of a new dataset with the stages; without it nothing but the page is written."""
    formats: list[str] | None = None
    """Formats of the new dataset's stages; by default those that the installed LeRobot reads, and csv."""
    skip: bool = False
    """Whether a format that cannot say what the stages are is left out, rather than an error."""
    names: list[str] | None = None
    """Names of the stages, like '[reach, carry, leave]'; by default made from what the data says."""
    corrections: Path | None = None
    """File of corrections, saved from the page, or the csv of an annotation before, edited."""
    rerun: bool = False
    """Whether recordings for Rerun, the viewer of lerobot-dataset-viz, are written beside the page."""
    tolerance: int = 10
    """Frames by which a found change point may miss a true one and still count."""
    seed: int = 0
    """Seed of everything random."""
    device: str = "cpu"
    """PyTorch device that a training runs on, like cpu or cuda."""
    output_dir: Path | None = None
    """Folder for the page; by default outputs/annotate/<date>/<time>_<dataset>."""

    def __post_init__(self) -> None:
        if self.dataset.root is None:
            raise ValueError("no demonstrations: give --dataset.root=<folder of a LeRobot dataset>")
        for name in ("tolerance", "seed"):
            if getattr(self, name) < 0:
                raise ValueError(f"--{name}={getattr(self, name)}: it must be at least 0")
        for name in self.formats or []:
            if name not in FORMATS:
                raise ValueError(f"formats hold {name!r}: choose from {', '.join(FORMATS)}")
        if self.formats is not None and self.output is None:
            raise ValueError("formats are of a new dataset: give --output=<its folder>")
        if self.output is not None and (self.dataset.episodes is not None or self.dataset.task is not None):
            raise ValueError(
                "a new dataset has labels in all episodes: leave dataset.episodes and dataset.task out, or "
                "give no --output"
            )
        if self.names is not None:
            checked_names(self.names)
        if self.policy.path is not None:
            self._refuse_what_the_policy_decides()

    def _refuse_what_the_policy_decides(self) -> None:
        pairs: list[tuple[str, str, Any, Any]] = [
            ("dataset", name, self.dataset, DatasetOptions()) for name in POLICYS_OWN
        ]
        pairs += [("planner", one.name, self.planner, SearchOptions()) for one in fields(PlannerOptions)]
        for group, name, own, default in pairs:
            if getattr(own, name) != getattr(default, name):
                raise ValueError(
                    f"{group}.{name} is {getattr(own, name)!r}, and a policy is given, which decides that: "
                    "leave one of them out"
                )
