"""The options of train.py: one dataclass, a sentence per field, each checking itself."""

from dataclasses import dataclass, field, fields
from pathlib import Path

import torch

from dpmacro.discovery.settings import RECIPES
from dpmacro.features.kinds import FEATURES

__all__ = [
    "LEARNERS",
    "PLANNERS",
    "ConvNetOptions",
    "DaggerOptions",
    "DatasetOptions",
    "PlannerOptions",
    "TrainOptions",
]

PLANNERS = ("dpboost", "baseline")
SEEDS = 2**63  # those that generators take
LEARNERS = ("stumps", "convnet")


@dataclass(frozen=True)
class DatasetOptions:
    """Which demonstrations."""

    root: Path | None = None
    """Folder of a LeRobot dataset."""
    episodes: list[int] | None = None
    """Episodes to use; all by default."""
    camera: str | None = None
    """Image feature to learn from, where the dataset has several."""
    image_size: tuple[int, int] | None = None
    """Width and height to shrink images to, like '[128,96]'; by default they stay as they are stored."""
    truth: str | None = None
    """Integer column with the true macro-labels, for metrics only; "none" or by default the recorded one."""
    symmetric: bool | None = None
    """Whether the world and its mirror image are alike; by default as meta/dpmacro.json says, else false."""

    def __post_init__(self) -> None:
        if self.image_size is not None and min(self.image_size) < 1:
            raise ValueError(f"dataset.image_size is {list(self.image_size)}: give a width and a height")


@dataclass(frozen=True)
class ConvNetOptions:
    """Tiny convolutional networks as weak learners."""

    rounds: int = 8
    """Boosting rounds of the networks."""
    shrinkage: float = 0.5
    """Factor on every network, above 0 and up to 1."""
    epochs: int = 1
    """Passes over the frames in every round."""

    def __post_init__(self) -> None:
        for name in ("rounds", "epochs"):
            if getattr(self, name) < 1:
                raise ValueError(f"planner.convnet.{name} is {getattr(self, name)}: give 1 or more")
        if not 0 < self.shrinkage <= 1:
            raise ValueError(
                f"planner.convnet.shrinkage is {self.shrinkage}: give a number above 0 and up to 1"
            )


@dataclass(frozen=True)
class PlannerOptions:
    """What is trained, and how."""

    recipe: str = "dpmacro"
    """dpmacro, or paper for the method of the paper alone (docs/options.md)."""
    type: str = "dpboost"
    """dpboost, or baseline for a single classifier."""
    macros: int | str = 2
    """Macro-actions Q, or auto to try 1 to max_macros of them; the baseline has 1."""
    max_macros: int = 4
    """The most macro-actions that auto tries."""
    max_transitions: int | None = None
    """Bound S on transitions in a demonstration; by default Q - 1, and with auto macros twice that, too."""
    learner: str = "stumps"
    """Weak learners of the strong classifiers, stumps or convnet."""
    rounds: int = 300
    """Boosting rounds of the strong classifiers; those of networks are convnet.rounds."""
    shrinkage: float = 0.1
    """Factor on every weak hypothesis, above 0 and up to 1."""
    switch_weight: float = 1.0
    """What recognising the changes counts beside the actions when demonstrations are cut; 0 for nothing."""
    restarts: int = 32
    """Initial segmentations."""
    features: str = "rectangles"
    """rectangles, or pixels for the paper's."""
    rectangles: int = 4096
    """How many rectangles are drawn."""
    drawn: int = 0
    """Random columns that a round of stumps searches instead of all, faster and not exact; 0 for all."""
    reuse: int = 1
    """Rounds that a search serves; those after it search its best columns alone, or its draw, faster."""
    memory_limit: float = 6.0
    """GiB that training may take; where sorted columns do not fit, a round searches some of them."""
    early_stopping: bool = False
    """Whether left-out trajectories decide how many of the rounds are kept."""
    convnet: ConvNetOptions = field(default_factory=ConvNetOptions)
    """Networks, where a learner is convnet."""
    switch_learner: str = "stumps"
    """Weak learners of the switch functions, likewise."""
    switch_window: int = 3
    """J, the frames from a change on that are its positive examples."""
    switch_rounds: int = 400
    """Boosting rounds of the switch functions."""
    switch_drawn: int = 32
    """Random columns that a round of stumps searches for them."""
    switch_shrinkage: float = 0.2
    """Factor on every weak hypothesis of a switch function."""
    recovery: bool = False
    """Whether runs of the saved policy break out of loops by replaying actions of the demonstrations."""

    def __post_init__(self) -> None:
        if self.recipe not in RECIPES:
            raise ValueError(f"planner.recipe is {self.recipe!r}: choose one of {', '.join(RECIPES)}")
        if self.recipe == "paper":
            _take_from_paper(self)
        if self.type not in PLANNERS:
            raise ValueError(f"planner.type is {self.type!r}: choose one of {', '.join(PLANNERS)}")
        for name in ("learner", "switch_learner"):
            if getattr(self, name) not in LEARNERS:
                raise ValueError(
                    f"planner.{name} is {getattr(self, name)!r}: choose one of {', '.join(LEARNERS)}"
                )
        for name in ("drawn", "switch_drawn"):
            if getattr(self, name) < 0:
                raise ValueError(f"planner.{name} is {getattr(self, name)}: give 0 or more")
        if not self.memory_limit > 0:
            raise ValueError(f"planner.memory_limit is {self.memory_limit}: give a number of GiB above 0")
        if self.features not in FEATURES:
            raise ValueError(f"planner.features is {self.features!r}: choose one of {', '.join(FEATURES)}")
        if isinstance(self.macros, str) and self.macros != "auto":
            raise ValueError(f"planner.macros is {self.macros!r}: give a number, or auto")
        if isinstance(self.macros, int) and self.macros < 1:
            raise ValueError(f"planner.macros is {self.macros}: give 1 or more, or auto")
        if self.max_macros < 2:
            raise ValueError(f"planner.max_macros is {self.max_macros}: give 2 or more")
        if not 0 <= self.switch_weight < float("inf"):
            raise ValueError(f"planner.switch_weight is {self.switch_weight}: give 0 or more")
        counts = (
            "rounds",
            "restarts",
            "rectangles",
            "reuse",
            "switch_window",
            "switch_rounds",
        )
        for name in counts:
            if getattr(self, name) < 1:
                raise ValueError(f"planner.{name} is {getattr(self, name)}: give 1 or more")
        for name in ("shrinkage", "switch_shrinkage"):
            if not 0 < getattr(self, name) <= 1:
                raise ValueError(
                    f"planner.{name} is {getattr(self, name)}: give a number above 0 and up to 1"
                )
        if self.max_transitions is not None and self.max_transitions < 0:
            raise ValueError(f"planner.max_transitions is {self.max_transitions}: give 0 or more")


# What the paper's recipe fixes; of each option only this value or the default may be given with it.
PAPER = {
    "learner": "stumps",
    "switch_learner": "stumps",
    "features": "pixels",
    "shrinkage": 1.0,
    "switch_shrinkage": 1.0,
    "switch_weight": 0.0,
    "switch_drawn": 0,
    "early_stopping": False,
    "recovery": False,
}


def _take_from_paper(options: PlannerOptions) -> None:
    defaults = {field.name: field.default for field in fields(PlannerOptions)}
    for name, value in PAPER.items():
        if getattr(options, name) not in (value, defaults[name]):
            raise ValueError(
                f"planner.{name} is {getattr(options, name)!r}, and planner.recipe=paper has {value!r}: give "
                "one of the two"
            )
        object.__setattr__(options, name, value)


@dataclass(frozen=True)
class DaggerOptions:
    """Demonstrations of what the planner itself runs into, with the actions of the world's teacher."""

    iterations: int = 0
    """How often to gather them and train again."""
    episodes: int = 20
    """Runs to gather in every iteration."""
    seed: int = 20000
    """Seed of the first of those runs; the others follow it."""
    validation_episodes: int = 50
    """Runs whose successes say which iteration to keep."""
    validation_seed: int = 5000
    """Seed of the first of those; the others follow it."""
    workers: int = 2
    """Processes that share the runs; the results do not depend on it."""

    def __post_init__(self) -> None:
        least = {"iterations": 0, "seed": 0, "validation_seed": 0}
        for name, value in vars(self).items():
            if value < least.get(name, 1):
                raise ValueError(f"dagger.{name} is {value}: give {least.get(name, 1)} or more")
        gathered = range(self.seed, self.seed + self.iterations * self.episodes)
        validating = range(self.validation_seed, self.validation_seed + self.validation_episodes)
        if max(gathered.start, validating.start) < min(gathered.stop, validating.stop):
            raise ValueError(
                f"dagger.seed is {self.seed} and dagger.validation_seed {self.validation_seed}: some worlds "
                "would serve both, move one of them"
            )


@dataclass(frozen=True)
class TrainOptions:
    """Options of train.py."""

    dataset: DatasetOptions = field(default_factory=DatasetOptions)
    planner: PlannerOptions = field(default_factory=PlannerOptions)
    dagger: DaggerOptions = field(default_factory=DaggerOptions)
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
        if not 0 <= self.seed < SEEDS:
            raise ValueError(f"seed is {self.seed}: give 0 or more, and less than {SEEDS}")
        try:
            torch.empty(0, device=self.device)
        except (RuntimeError, AssertionError) as error:
            raise ValueError(f"device {self.device!r} is not to be had here: give --device=cpu") from error
