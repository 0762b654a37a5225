"""What a policy is, beside its numbers."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

from dpmacro.boosting.losses.vectors import LOSSES
from dpmacro.data.images import ImageTransform
from dpmacro.data.vectors import ActionTransform

__all__ = ["CLASSES", "InputConfig", "PolicyConfig", "parsed_config"]

CLASSES = "exponential"  # the loss of classes


@dataclass(frozen=True)
class InputConfig:
    """One thing that a policy sees."""

    shape: tuple[int, ...]  # of a frame: height, width, 3 of a camera; size of a vector; () of the task
    stored_shape: tuple[int, int] | None = None  # of images before they were shrunk; None where they were not

    @property
    def is_camera(self) -> bool:
        """Whether it is images."""
        return len(self.shape) == 3


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
        macros = [*self.starts, *(macro for pair in self.switches for macro in pair)]
        transform = self.actions
        sound = {
            "macros": isinstance(self.macros, int) and self.macros >= 1,
            "starts and switches": len(self.starts) > 0
            and all(isinstance(q, int) and 0 <= q < self.macros for q in macros),
            "recovery": isinstance(self.recovery, bool) and not (self.recovery and self.vector),
            "thresholds": len(self.thresholds) == len(self.switches)
            and all(own is None or math.isfinite(own) for own in self.thresholds),
            "cues": len(self.cues) in (0, len(self.switches))
            and all(0 <= action < len(self.action_names) for own in self.cues for action in own),
            "inputs": len(self.inputs) > 0
            and all(
                len(shape) in lengths and all(isinstance(size, int) and size > 0 for size in shape)
                for one in self.inputs.values()
                for shape, lengths in ((one.shape, (0, 1, 3)), (one.stored_shape or (1, 1), (2,)))
            ),
            "loss": self.loss in (LOSSES if self.vector else (CLASSES,)),
            "outputs": isinstance(self.outputs, int)
            and (self.outputs >= 1 if transform is None else self.outputs == len(transform.kept)),
            "action_state": transform is None or not transform.relative or self.action_state in self.inputs,
            "max_transitions": self.max_transitions is None or self.max_transitions >= 0,
            "order": self.order in ("free", "chain"),
            "change_log_odds": not self.switch_weight
            or [len(row) for row in self.change_log_odds] == [self.macros] * self.macros,
            "world": isinstance(self.world, dict),
        }
        for name, holds in sound.items():
            if not holds:
                raise ValueError(f"{name} of the policy cannot be: {self}")


def parsed_config(values: Mapping[str, Any]) -> PolicyConfig:
    """The config of these values, those of `dataclasses.asdict` after JSON made lists of the tuples.

    Raises ValueError where they make no config.
    """
    try:
        inputs = {
            key: InputConfig(tuple(one["shape"]), one["stored_shape"] and tuple(one["stored_shape"]))
            for key, one in values["inputs"].items()
        }
        lists = ("action_names", "starts", "thresholds", "tasks")
        nested = ("switches", "cues", "change_log_odds")
        return PolicyConfig(
            **{
                **values,
                "inputs": inputs,
                **{name: tuple(values[name]) for name in lists if name in values},
                **{name: tuple(tuple(own) for own in values[name]) for name in nested if name in values},
            }
        )
    except (KeyError, TypeError, AttributeError) as error:
        raise ValueError(f"{type(error).__name__}: {error}") from error
