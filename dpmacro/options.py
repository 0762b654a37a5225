"""The options of train.py: one dataclass, a sentence per field, each checking itself."""

from dataclasses import dataclass, field
from pathlib import Path

import torch

from dpmacro.features import FEATURES

__all__ = ["PLANNERS", "DatasetOptions", "PlannerOptions", "TrainOptions"]

PLANNERS = ("dpboost", "baseline")


@dataclass(frozen=True)
class DatasetOptions:
    """Which demonstrations."""

    root: Path | None = None
    """Folder of a LeRobot dataset."""
    episodes: list[int] | None = None
    """Episodes to use; all by default."""
    camera: str | None = None
    """Image feature to learn from, where the dataset has several."""


@dataclass(frozen=True)
class PlannerOptions:
    """What is trained, and how."""

    type: str = "dpboost"
    """dpboost, or baseline for a single classifier."""
    macros: int = 2
    """Macro-actions Q; the baseline has 1."""
    max_transitions: int | None = None
    """Bound S on transitions in every demonstration; by default Q - 1."""
    rounds: int = 300
    """Boosting rounds of the strong classifiers."""
    shrinkage: float = 0.1
    """Factor on every weak hypothesis, above 0 and up to 1."""
    restarts: int = 32
    """Initial segmentations."""
    features: str = "rectangles"
    """rectangles, or pixels for the paper's."""
    rectangles: int = 4096
    """How many rectangles are drawn."""
    switch_window: int = 3
    """J, the frames from a change on that are its positive examples."""
    switch_rounds: int = 60
    """Boosting rounds of the switch functions."""
    switch_shrinkage: float = 0.2
    """Factor on every weak hypothesis of a switch function."""

    def __post_init__(self) -> None:
        if self.type not in PLANNERS:
            raise ValueError(f"planner.type is {self.type!r}: choose one of {', '.join(PLANNERS)}")
        if self.features not in FEATURES:
            raise ValueError(f"planner.features is {self.features!r}: choose one of {', '.join(FEATURES)}")
        for name in ("macros", "rounds", "restarts", "rectangles", "switch_window", "switch_rounds"):
            if getattr(self, name) < 1:
                raise ValueError(f"planner.{name} is {getattr(self, name)}: give 1 or more")
        for name in ("shrinkage", "switch_shrinkage"):
            if not 0 < getattr(self, name) <= 1:
                raise ValueError(
                    f"planner.{name} is {getattr(self, name)}: give a number above 0 and up to 1"
                )
        if self.max_transitions is not None and self.max_transitions < 0:
            raise ValueError(f"planner.max_transitions is {self.max_transitions}: give 0 or more")


@dataclass(frozen=True)
class TrainOptions:
    """Options of train.py."""

    dataset: DatasetOptions = field(default_factory=DatasetOptions)
    planner: PlannerOptions = field(default_factory=PlannerOptions)
    output_dir: Path | None = None
    """Folder of the run; by default outputs/train/<date>/<time>_<job_name>."""
    job_name: str | None = None
    """Name of the run; by default the planner's type."""
    seed: int = 0
    """Seed of every draw."""
    device: str = "cpu"
    """Where tensors live: cpu, cuda, cuda:1, ..."""

    def __post_init__(self) -> None:
        if self.dataset.root is None:
            raise ValueError("no demonstrations: give --dataset.root=<folder of a LeRobot dataset>")
        if self.seed < 0:
            raise ValueError(f"seed is {self.seed}: give 0 or more")
        try:
            torch.empty(0, device=self.device)
        except (RuntimeError, AssertionError) as error:
            raise ValueError(f"device {self.device!r} is not to be had here: give --device=cpu") from error
