"""The options of train.py: one dataclass, a sentence per field, each checking itself."""

import math
from dataclasses import dataclass, field, fields, replace
from pathlib import Path

import torch

from dpmacro.boosting.losses.vectors import LOSSES
from dpmacro.discovery.settings import ORDERS, RECIPES
from dpmacro.features.kinds import FEATURES
from dpmacro.policy.config import MOST_MACROS, MOST_PIXELS
from dpmacro.segmentation.arguments import MOST_TRANSITIONS
from dpmacro.training.dagger_options import SEEDS, DaggerOptions
from dpmacro.utils.checks import as_count

__all__ = [
    "LEARNERS",
    "PLANNERS",
    "ConvNetOptions",
    "DatasetOptions",
    "PlannerOptions",
    "TrainOptions",
]

PLANNERS = ("dpboost", "baseline")
LEARNERS = ("stumps", "convnet")
MACROS = 2  # unless a number is given, or names of macro-actions
RELATIVE = ("auto", "true", "false")

# What the counts may be: beyond these, memory or a lifetime would not do.
COUNTS = {
    "macros": (1, MOST_MACROS),
    "max_macros": (2, MOST_MACROS),
    "max_transitions": (0, MOST_TRANSITIONS),
    "rounds": (1, 1_000_000),
    "restarts": (1, 100_000),
    "rectangles": (1, 1_000_000),
    "drawn": (0, 2**31),
    "reuse": (1, 1_000_000),
    "switch_window": (1, 1_000_000),
    "switch_rounds": (1, 1_000_000),
    "switch_drawn": (0, 2**31),
}


@dataclass(frozen=True)
class DatasetOptions:
    """The demonstrations to learn from."""

    root: Path | None = None
    """Folder of the LeRobot dataset that holds the demonstrations."""
    episodes: list[int] | None = None
    """Episodes of the dataset to learn from, like '[0,1,2]'; by default all."""
    inputs: list[str] | None = None
    """Features that the policy sees, like '[observation.state]'; by default all cameras and state vectors."""
    camera: str | None = None
    """Name of the one image feature to learn from, a short form of inputs."""
    action: list[str] | None = None
    """Feature that holds the action, or several with a number each, like '[joint_1, joint_2]'."""
    action_relative: str = "auto"
    """Whether action vectors are learned less the state, true or false; auto asks the data."""
    task: str | None = None
    """Task whose episodes are read, by its words or its number; by default those of all tasks."""
    image_size: tuple[int, int] | None = None
    """Width and height that images are shrunk to, like '[128,96]'; large ones by default to about 64x48."""
    truth: str | None = None
    """Column of true macro-labels, for metrics only; by default the one recorded, and none for no truth."""
    labels: Path | None = None
    """File of corrections, JSON or CSV, whose episodes keep their labels while the others are cut anew."""
    symmetric: bool | None = None
    """Whether the world and its mirror image are alike; by default as meta/dpmacro.json says, else false."""

    def __post_init__(self) -> None:
        # A file of options or the command line may give a truth value, which comes here as True.
        object.__setattr__(self, "action_relative", self.action_relative.lower())
        if self.action_relative not in RELATIVE:
            raise ValueError(
                f"dataset.action_relative is {self.action_relative!r}: choose one of {', '.join(RELATIVE)}"
            )
        if self.image_size is not None and min(self.image_size) < 1:
            raise ValueError(f"dataset.image_size is {list(self.image_size)}: give a width and a height")
        if self.image_size is not None and math.prod(self.image_size) > MOST_PIXELS:
            raise ValueError(
                f"dataset.image_size is {list(self.image_size)}: give {MOST_PIXELS} pixels at most"
            )


@dataclass(frozen=True)
class ConvNetOptions:
    """Small convolutional networks as weak learners."""

    rounds: int = 8
    """Boosting rounds of a classifier whose weak learners are networks."""
    shrinkage: float = 0.5
    """Factor on the votes of every network, above 0 and up to 1; less needs more rounds."""
    epochs: int = 1
    """Passes over the training frames when a network is trained."""

    def __post_init__(self) -> None:
        for name in ("rounds", "epochs"):
            as_count(f"planner.convnet.{name}", getattr(self, name), 1, 10_000)
        if not 0 < self.shrinkage <= 1:
            raise ValueError(
                f"planner.convnet.shrinkage is {self.shrinkage}: give a number above 0 and up to 1"
            )


@dataclass(frozen=True)
class PlannerOptions:
    """The model and how it is trained."""

    recipe: str = "dpmacro"
    """dpmacro, or paper for the method of the DPBoost paper without this package's additions."""
    type: str = "dpboost"
    """dpboost, or baseline for a single macro-action without switch functions, like macros=1."""
    macros: int | str | None = None
    """Number of macro-actions Q, by default 2 or as many as labels name; auto tries 1 to max_macros."""
    max_macros: int = 4
    """Largest number of macro-actions that macros=auto tries."""
    order: str = "free"
    """Order of macro-actions, free, chain for 0, 1, ..., Q - 1 in each demonstration, or auto by the data."""
    loss: str = "huber"
    """Loss of action vectors, huber or squared; discrete actions have the exponential loss."""
    max_transitions: int | None = None
    """Most changes of macro-action in a demonstration, S; by default Q - 1 (auto tries 2Q - 2 of classes)."""
    learner: str = "stumps"
    """Weak learners of the macro-actions' action classifiers, either stumps or convnet."""
    rounds: int = 300
    """Boosting rounds of the action classifiers where their weak learners are stumps."""
    shrinkage: float = 0.1
    """Factor on the votes of every stump of an action classifier, above 0 and up to 1."""
    switch_weight: float = 1.0
    """Weight of the switch functions' loss beside the actions' loss in the segmentation; 0 leaves it out."""
    restarts: int = 32
    """Initial segmentations that the search for macro-actions starts from."""
    features: str = "rectangles"
    """Feature columns, either rectangles (sums over random ones) or pixels (one by one, as in the paper)."""
    rectangles: int = 4096
    """Number of random rectangles, where the features are rectangles."""
    drawn: int = 0
    """Random columns searched for the best stump in a round; 0 searches all, exactly but more slowly."""
    reuse: int = 5
    """Rounds that one search of all columns serves, whose best columns the others search; 1 is exact."""
    memory_limit: float = 6.0
    """GiB of memory that training may take; where columns exceed it, rounds search random ones."""
    early_stopping: bool = False
    """Whether loss on left-out demonstrations decides how many boosting rounds are kept."""
    convnet: ConvNetOptions = field(default_factory=ConvNetOptions)
    """Options of the networks, where a learner is convnet."""
    switch_learner: str = "stumps"
    """Weak learners of the switch functions, either stumps or convnet."""
    switch_window: int = 3
    """Frames from each change on that are positive examples of its switch function, J in the paper."""
    switch_rounds: int = 400
    """Boosting rounds of the switch functions where their weak learners are stumps."""
    switch_drawn: int = 32
    """Random columns searched for each stump of a switch function; 0 searches all."""
    switch_shrinkage: float = 0.2
    """Factor on the votes of every stump of a switch function, above 0 and up to 1."""
    recovery: bool = False
    """Whether runs of the saved policy break out of loops by replaying actions of the demonstrations."""

    def __post_init__(self) -> None:
        if self.recipe not in RECIPES:
            raise ValueError(f"planner.recipe is {self.recipe!r}: choose one of {', '.join(RECIPES)}")
        if self.recipe == "paper":
            _take_from_paper(self)
        if self.type not in PLANNERS:
            raise ValueError(f"planner.type is {self.type!r}: choose one of {', '.join(PLANNERS)}")
        for name, known in (("loss", LOSSES), ("order", (*ORDERS, "auto"))):
            if getattr(self, name) not in known:
                raise ValueError(
                    f"planner.{name} is {getattr(self, name)!r}: choose one of {', '.join(known)}"
                )
        if self.order == "chain" and self.max_transitions is not None:
            raise ValueError(
                f"planner.max_transitions is {self.max_transitions} and planner.order chain, which has one "
                "less than macros: leave max_transitions out"
            )
        for name in ("learner", "switch_learner"):
            if getattr(self, name) not in LEARNERS:
                raise ValueError(
                    f"planner.{name} is {getattr(self, name)!r}: choose one of {', '.join(LEARNERS)}"
                )
        if not self.memory_limit > 0:
            raise ValueError(f"planner.memory_limit is {self.memory_limit}: give a number of GiB above 0")
        if self.features not in FEATURES:
            raise ValueError(f"planner.features is {self.features!r}: choose one of {', '.join(FEATURES)}")
        if isinstance(self.macros, str) and self.macros != "auto":
            raise ValueError(f"planner.macros is {self.macros!r}: give a number, or auto")
        for name, (least, most) in COUNTS.items():
            if getattr(self, name) not in (None, "auto"):
                as_count(f"planner.{name}", getattr(self, name), least, most)
        if not 0 <= self.switch_weight < float("inf"):
            raise ValueError(f"planner.switch_weight is {self.switch_weight}: give 0 or more")
        for name in ("shrinkage", "switch_shrinkage"):
            if not 0 < getattr(self, name) <= 1:
                raise ValueError(
                    f"planner.{name} is {getattr(self, name)}: give a number above 0 and up to 1"
                )


# What the paper's recipe fixes; of each option only this value or the default may be given with it.
PAPER = {
    "learner": "stumps",
    "switch_learner": "stumps",
    "features": "pixels",
    "shrinkage": 1.0,
    "switch_shrinkage": 1.0,
    "switch_weight": 0.0,
    "switch_drawn": 512,
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
class TrainOptions:
    """Options of train.py."""

    dataset: DatasetOptions = field(default_factory=DatasetOptions)
    planner: PlannerOptions = field(default_factory=PlannerOptions)
    dagger: DaggerOptions = field(default_factory=DaggerOptions)
    output_dir: Path | None = None
    """Folder that the run is written to; by default outputs/train/<date>/<time>_<job_name>."""
    job_name: str | None = None
    """Name of the run in its default folder; by default the value of planner.type."""
    seed: int = 0
    """Seed of everything random in training."""
    device: str = "cpu"
    """PyTorch device that training runs on, like cpu or cuda."""
    save_freq: int = 100
    """Boosting rounds after which a run is saved to go on from there, beside ends of stages; 0 for never."""
    resume: bool = False
    """Whether to go on with a run that was stopped, whose train_config.json is given by --config_path."""

    def __post_init__(self) -> None:
        as_count("save_freq", self.save_freq, 0, 2**31)
        if self.dataset.root is None:
            raise ValueError("no demonstrations: give --dataset.root=<folder of a LeRobot dataset>")
        if self.dataset.labels is not None:
            self._check_labels()
        elif self.planner.macros is None:
            object.__setattr__(self, "planner", replace(self.planner, macros=MACROS))
        as_count("seed", self.seed, 0, SEEDS - 1)
        try:
            torch.zeros(1, device=self.device).item()  # the device meta holds no values
        except (RuntimeError, AssertionError) as error:
            raise ValueError(f"device {self.device!r} is not available here: give --device=cpu") from error

    def _check_labels(self) -> None:
        """Raise ValueError for an option that has no use for a file of labels."""
        others = {
            "planner.type=baseline": self.planner.type == "baseline",
            "planner.macros=auto": self.planner.macros == "auto",
            f"dagger.iterations={self.dagger.iterations}": self.dagger.iterations > 0,
        }
        for other in (name for name, there in others.items() if there):
            raise ValueError(f"dataset.labels is {self.dataset.labels} beside {other}: leave one of them out")
