"""How switch functions learn."""

from dataclasses import dataclass

__all__ = ["SWITCH_FOLDS", "SwitchSettings"]

SWITCH_FOLDS = 5  # of trajectories; one function for each leaves it out, one more sees all


@dataclass(frozen=True)
class SwitchSettings:
    """How switch functions learn; a value out of range raises ValueError.

    Attributes:
        rounds: boosting rounds, 1 or more.
        window: J >= 1, the positive frames from a change on. Later ones show what the next macro-action
            does, which a policy that waits for the change never sees.
        shrinkage: factor in (0, 1] on every weak hypothesis.
        folds: parts, 2 or more, that trajectories are dealt into; a function that never saw it scores each.
        early_stopping: whether every switch function keeps the rounds with the least loss on left-out parts.
        focused: whether frames after other actions than the cues are no examples. Where some changes are
            a frame or two late all frames are better ones: the true change is then taken for a frame before.
        whole_past: whether all frames of the trajectory before the change are negatives, as in the paper,
            instead of the frames of all segments of macro-action q.
        calibrated: whether left-out scores choose the thresholds; else they are 0.
        cues: whether a function may fire only after the actions that come before its changes.
        aligned: whether changes are moved to where left-out functions fire before the final fit.
        tolerance: frames by which a function may fire early or late and still recognises its change, 0 or
            more.
    """

    rounds: int = 400
    window: int = 3
    shrinkage: float = 0.2
    folds: int = SWITCH_FOLDS
    early_stopping: bool = False
    focused: bool = True
    whole_past: bool = False
    calibrated: bool = True
    cues: bool = True
    aligned: bool = True
    tolerance: int = 0

    def __post_init__(self) -> None:
        if self.window < 1 or self.rounds < 1:
            raise ValueError(f"window is {self.window} and rounds {self.rounds}: both must be 1 or more")
        if not 0 < self.shrinkage <= 1:
            raise ValueError(f"shrinkage is {self.shrinkage}: give a number above 0 and up to 1")
        if self.tolerance < 0:
            raise ValueError(f"tolerance is {self.tolerance}: give 0 or more")
        if self.folds < 2:
            raise ValueError(f"folds is {self.folds}: give 2 or more, so that something can be left out")
