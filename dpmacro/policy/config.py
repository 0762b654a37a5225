"""What a policy is, beside its numbers."""

import math
from collections.abc import Mapping
from dataclasses import MISSING, dataclass, field, fields
from functools import cached_property
from typing import Any, no_type_check

from dpmacro.boosting.losses.vectors import LOSSES
from dpmacro.data.images import ImageTransform
from dpmacro.data.vectors import ActionTransform
from dpmacro.segmentation.arguments import MOST_TRANSITIONS, ORDERS
from dpmacro.utils.checks import as_choice, as_count, as_entries, as_flag, as_number, as_text, shown

__all__ = ["CLASSES", "InputConfig", "PolicyConfig", "parsed_config"]

CLASSES = "exponential"  # the loss of classes
TYPES = ("dpboost", "baseline")
LISTS = (
    "action_names",
    "starts",
    "thresholds",
    "tasks",
    "switches",
    "cues",
    "change_log_odds",
)
WORLD_TEXTS = ("id", "import")  # of a world, in text where they are there

# A file is a stranger's: with these a frame takes 300 MiB at most, whatever the file says.
MOST_MACROS = 1000
MOST_OUTPUTS = 2**17
MOST_PIXELS = 2**21  # of a camera, 1920 x 1080 say
MOST_NUMBERS = 2**25  # of everything seen in a frame
LONGEST_SIDE = 2**16  # of stored images, in pixels
LARGEST = 1e30  # of a number that scores are compared with


@no_type_check
@dataclass(frozen=True)
class InputConfig:
    """One thing that a policy sees."""

    shape: tuple[int, ...]  # of a frame: height, width, 3 of a camera; size of a vector; () of the task
    stored_shape: tuple[int, int] | None = None  # of images before they were shrunk; None where they were not

    @property
    def is_camera(self) -> bool:
        """Whether it is images."""
        return len(self.shape) == 3


@no_type_check  # by what looks at shapes: values come from files, and are looked at here
@dataclass(frozen=True)
class PolicyConfig:
    """What a policy is, beside its numbers."""

    type: str  # dpboost | baseline
    macros: int  # Q
    starts: tuple[int, ...]  # macro-actions that runs start in; of several the first frame tells which
    inputs: Mapping[str, InputConfig]  # what it sees, keyed as LeRobot keys it
    encoder: Mapping[str, Any]  # what its columns are, as `Encoder.spec` says
    action_names: tuple[str, ...]  # of classes, or of the numbers of a vector
    outputs: int  # scores of a macro-action: classes, or numbers that vary
    loss: str = CLASSES  # that the classifiers minimise: exponential of classes, huber or squared of vectors
    action_transform: Mapping[str, Any] | None = None  # from scores to vectors; None for classes
    action_state: str = ""  # the input that relative actions are added to; "" for none
    switches: tuple[tuple[int, int], ...] = ()  # (from, to) of every switch function
    thresholds: tuple[float | None, ...] = ()  # a switch function fires above its own, never where None
    cues: tuple[tuple[int, ...], ...] = ()  # and right after one of these actions; none stands for any
    recovery: bool = False  # whether its planner recovers from loops (dpmacro/policy/recovery.py)
    order: str = "free"  # of macro-actions in a segmentation, "free" or "chain"
    max_transitions: int | None = None  # S of the segmentation it was trained on; None for Q - 1
    switch_weight: float = 0.0  # of the switch functions' costs in that segmentation
    change_log_odds: tuple[tuple[float, ...], ...] = ()  # [from][to] in that segmentation; with a weight only
    tasks: tuple[str, ...] = ()  # in words, by task_index
    world: dict[str, Any] = field(default_factory=dict)  # {"id": ..., **options} of the demonstrations

    @property
    def cameras(self) -> tuple[str, ...]:
        """The inputs that are images."""
        return tuple(key for key, one in self.inputs.items() if one.is_camera)

    @cached_property
    def image_transform(self) -> ImageTransform:
        """What is done to images: only those of the demonstrations' stored sizes, shrunk as they were."""
        shapes = {key: (self.inputs[key].shape, self.inputs[key].stored_shape) for key in self.cameras}
        sizes = {key: (shape[1], shape[0]) for key, (shape, _) in shapes.items()}
        stored = {key: ((own or shape)[1], (own or shape)[0]) for key, (shape, own) in shapes.items()}
        return ImageTransform(sizes, stored=stored)

    @property
    def vector(self) -> bool:
        """Whether actions are vectors rather than classes."""
        return self.action_transform is not None

    @cached_property
    def actions(self) -> ActionTransform | None:
        """From scores to vectors; None for classes."""
        return (
            None if self.action_transform is None else ActionTransform.from_dict(dict(self.action_transform))
        )

    def __post_init__(self) -> None:
        """Raise ValueError that names the field, its value and what to give, for the first that cannot be."""
        as_choice("type", self.type, TYPES)
        as_count("macros", self.macros, 1, MOST_MACROS)
        as_choice("order", self.order, ORDERS)
        as_flag("recovery", self.recovery)
        as_number("switch_weight", self.switch_weight, least=0.0)
        if self.max_transitions is not None:
            as_count("max_transitions", self.max_transitions, 0, MOST_TRANSITIONS)
        as_entries("encoder", self.encoder, kind=Mapping)
        for name in ("action_names", "tasks"):
            for place, own in enumerate(as_entries(name, getattr(self, name))):
                as_text(f"{name}[{place}]", own)
        _check_inputs(self.inputs)
        self._check_switches()
        self._check_actions()
        for key in as_entries("world", self.world, kind=dict):
            as_text("a name in world", key)
        for key in WORLD_TEXTS:
            as_text(f"world.{key}", self.world.get(key, ""))

    def _check_switches(self) -> None:
        for place, start in enumerate(as_entries("starts", self.starts)):
            as_count(f"starts[{place}]", start, 0, self.macros - 1)
        if not 0 < len(set(self.starts)) == len(self.starts):
            raise ValueError(f"starts is {shown(self.starts)}: give one macro-action or more, each once")
        for place, pair in enumerate(as_entries("switches", self.switches)):
            for macro in as_entries(f"switches[{place}]", pair, 2):
                as_count(f"a macro-action in switches[{place}]", macro, 0, self.macros - 1)
        count = len(self.switches)
        for place, own in enumerate(as_entries("thresholds", self.thresholds, count)):
            if own is not None:
                as_number(f"thresholds[{place}]", own, least=-LARGEST, most=LARGEST)
        for place, cues in enumerate(as_entries("cues", self.cues, count if self.cues else None)):
            for action in as_entries(f"cues[{place}]", cues):
                as_count(f"an action in cues[{place}]", action, 0, len(self.action_names) - 1)
        rows = as_entries(
            "change_log_odds", self.change_log_odds, self.macros if self.switch_weight else None
        )
        for place, row in enumerate(rows):
            for own in as_entries(f"change_log_odds[{place}]", row, self.macros):
                as_number(f"a number in change_log_odds[{place}]", own, least=-LARGEST, most=LARGEST)

    def _check_actions(self) -> None:
        if self.vector:
            as_entries("action_transform", self.action_transform, kind=Mapping)
        transform = self.actions
        as_choice("loss", self.loss, LOSSES if self.vector else (CLASSES,))
        as_text("action_state", self.action_state)
        least, most = (1, len(self.action_names)) if transform is None else (len(transform.kept),) * 2
        as_count("outputs", self.outputs, least, min(most, MOST_OUTPUTS))
        if transform is None:
            return
        size = len(as_entries("action_names", self.action_names, len(transform.mean)))
        if self.recovery:
            raise ValueError("recovery is True beside vectors of actions: give False")
        state = self.inputs.get(self.action_state)
        if transform.relative and (state is None or state.shape != (size,)):
            raise ValueError(
                f"action_state is {shown(self.action_state)}: give the input of {size} numbers that relative "
                "actions are added to"
            )


def _check_inputs(inputs: Any) -> None:
    """Raise ValueError for inputs that are no inputs, or whose frames take too much memory."""
    total = 0
    for key, one in as_entries("inputs", inputs, kind=Mapping).items():
        name = f"the shape of inputs[{shown(key)}]"
        as_text("a name in inputs", key)
        for size in as_entries(name, one.shape):
            as_count(f"a number in {name}", size, 1, MOST_NUMBERS)
        if len(one.shape) not in (0, 1, 3) or (one.is_camera and one.shape[2] != 3):
            raise ValueError(f"{name} is {shown(one.shape)}: give [height, width, 3], [numbers] or []")
        if one.is_camera and math.prod(one.shape[:2]) > MOST_PIXELS:
            raise ValueError(f"{name} is {shown(one.shape)}: give {MOST_PIXELS} pixels at most")
        total += math.prod(one.shape)
        if one.stored_shape is not None:
            name = f"the stored_shape of inputs[{shown(key)}]"
            for least, size in zip(one.shape, as_entries(name, one.stored_shape, 2), strict=False):
                as_count(f"a side in {name}", size, least, LONGEST_SIDE)
    if not 0 < total <= MOST_NUMBERS:
        raise ValueError(f"inputs have {total} numbers a frame: give 1 to {MOST_NUMBERS}")


@no_type_check
def parsed_config(values: Mapping[str, Any]) -> PolicyConfig:
    """The config of these values, those of `dataclasses.asdict` after JSON made lists of the tuples.

    Raises ValueError where they make no config.
    """
    as_entries("a policy's config", values, kind=Mapping)
    known = {one.name: one for one in fields(PolicyConfig)}
    unknown = [name for name in values if name not in known]
    if unknown:
        raise ValueError(f"{shown(unknown[0])} is no field of a policy: leave it out")
    needed = [name for name, one in known.items() if one.default is one.default_factory is MISSING]
    missing = [name for name in needed if name not in values]
    if missing:
        raise ValueError(f"it has no {missing[0]}: give {', '.join(needed)}")
    made = {name: _tuples(value) if name in LISTS else value for name, value in values.items()}
    made["inputs"] = {
        key: _parsed_input(f"inputs[{shown(key)}]", one)
        for key, one in as_entries("inputs", values["inputs"], kind=Mapping).items()
    }
    return PolicyConfig(**made)


@no_type_check
def _parsed_input(name: str, values: Any) -> InputConfig:
    as_entries(name, values, kind=Mapping)
    if set(values) != {"shape", "stored_shape"}:
        raise ValueError(f"{name} has {shown(list(values))}: give shape and stored_shape")
    return InputConfig(_tuples(values["shape"]), _tuples(values["stored_shape"]))


def _tuples(value: Any) -> Any:
    """Tuples in place of lists, and of those within them."""
    return tuple(_tuples(own) for own in value) if isinstance(value, list | tuple) else value
