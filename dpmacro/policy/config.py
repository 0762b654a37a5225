"""What a policy is, beside its numbers: its config.json."""

import json
import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from dpmacro.data.images import ImageTransform
from dpmacro.features.kinds import FEATURES

__all__ = ["PolicyConfig", "read_config"]


@dataclass(frozen=True)
class PolicyConfig:
    """What a policy is, beside its numbers."""

    type: str  # dpboost | baseline
    macros: int  # Q
    starts: tuple[int, ...]  # macro-actions that runs start in; of several the first frame tells which
    action_names: tuple[str, ...]
    image_shape: tuple[int, int]  # height, width
    features: str  # kind of feature set
    switches: tuple[tuple[int, int], ...] = ()  # (from, to) of every switch function
    thresholds: tuple[float, ...] = ()  # a switch function fires above its own
    cues: tuple[tuple[int, ...], ...] = ()  # and right after one of these actions; none stands for any
    recovery: bool = False  # whether its planner recovers from loops (dpmacro/policy/recovery.py)
    max_transitions: int | None = None  # S of the segmentation it was trained on; None for Q - 1
    switch_weight: float = 0.0  # of the switch functions' costs in that segmentation
    change_log_odds: tuple[tuple[float, ...], ...] = ()  # [from][to] in that segmentation; with a weight only
    stored_shape: tuple[int, int] | None = None  # of images before they were shrunk; None where they were not
    world: dict[str, Any] = field(default_factory=dict)  # {"id": ..., **options} of the demonstrations

    @property
    def image_transform(self) -> ImageTransform:
        """What is done to images: only those of the demonstrations' stored size, shrunk as they were."""
        height, width = self.stored_shape or self.image_shape
        return ImageTransform(self.image_shape[::-1], stored=(width, height))

    def __post_init__(self) -> None:
        macros = [*self.starts, *(macro for pair in self.switches for macro in pair)]
        sound = {
            "macros": isinstance(self.macros, int) and self.macros >= 1,
            "starts and switches": len(self.starts) > 0
            and all(isinstance(q, int) and 0 <= q < self.macros for q in macros),
            "recovery": isinstance(self.recovery, bool),
            "thresholds": len(self.thresholds) == len(self.switches)
            and all(map(math.isfinite, self.thresholds)),
            "cues": len(self.cues) in (0, len(self.switches))
            and all(0 <= action < len(self.action_names) for own in self.cues for action in own),
            "image_shape and stored_shape": all(
                len(shape) == 2 and all(isinstance(size, int) and size > 0 for size in shape)
                for shape in (self.image_shape, self.stored_shape or self.image_shape)
            ),
            "features": self.features in FEATURES,
            "max_transitions": self.max_transitions is None or self.max_transitions >= 0,
            "change_log_odds": not self.switch_weight
            or [len(row) for row in self.change_log_odds] == [self.macros] * self.macros,
            "world": isinstance(self.world, dict),
        }
        for name, holds in sound.items():
            if not holds:
                raise ValueError(f"{name} of the policy cannot be: {self}")


def read_config(path: Path) -> PolicyConfig:
    """The config that a policy was saved with. Raises ValueError naming the file where it is none."""
    try:
        values = json.loads(path.read_text())
        stored = values.get("stored_shape")
        return PolicyConfig(
            **{
                **values,
                "action_names": tuple(values["action_names"]),
                "image_shape": tuple(values["image_shape"]),
                "stored_shape": stored and tuple(stored),
                "starts": tuple(values["starts"]),
                "switches": tuple(tuple(pair) for pair in values["switches"]),
                "thresholds": tuple(values["thresholds"]),
                "cues": tuple(tuple(own) for own in values.get("cues", ())),
                "change_log_odds": tuple(tuple(row) for row in values.get("change_log_odds", ())),
            }
        )
    except (ValueError, KeyError, TypeError) as error:
        raise ValueError(
            f"{path} is no policy of dpmacro ({error}): give a folder that train.py wrote"
        ) from error
