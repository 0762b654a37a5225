"""What every world and whatever runs in one agree on: planners, runs, and the names of how runs end."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import gymnasium as gym
import numpy as np
from jaxtyping import Float, Float32, Int8, UInt8

__all__ = [
    "NO_MACRO",
    "OUT_OF_TIME",
    "SUCCESS",
    "Diagnosis",
    "Episode",
    "Expert",
    "Moment",
    "Planner",
    "Recording",
    "SuccessOrFailure",
]

SUCCESS = "success"
OUT_OF_TIME = "out_of_time"
NO_MACRO = -1


@runtime_checkable
class Planner(Protocol):
    """What chooses the actions in one running environment.

    A planner that has macro-actions tells its current one in an attribute `macro`, 0..Q-1.

    A planner may tell its `memory`, a hashable value. Its next action and its next memory must depend on
    nothing but this value and the world's present and previous state. The runs of such a planner can be ended
    as soon as they repeat themselves. A planner without `memory`, or with None, such as one that draws random
    numbers, always runs to the end.
    """

    def reset(self, env: gym.Env) -> None:
        """Begin an episode of `env`, which was just reset."""

    def act(self, observation: dict[str, Any], info: dict[str, Any]) -> Any:
        """Return the action to take, an int or a vector of numbers."""


@runtime_checkable
class Expert(Planner, Protocol):
    """A world's teacher: a planner that may read the world's true state in `reset` and `act`."""


@dataclass(frozen=True)
class Recording:
    """What recordings of a world say beside what was seen and done.

    Attributes:
        task: in words.
        truth: columns of true labels, each with the names of its labels 0, 1, ...; the name of a column is
            that of the number in the world's info.
        symmetric: whether the world and its mirror image are alike.
    """

    task: str
    truth: Mapping[str, tuple[str, ...]]
    symmetric: bool = False


@runtime_checkable
class Diagnosis(Protocol):
    """A world's names for how runs end and why they fail.

    Attributes:
        outcomes: every outcome there is, `SUCCESS` first.
    """

    outcomes: tuple[str, ...]

    def outcome(self, info: Mapping[str, Any]) -> str:
        """Return the one of `outcomes` that a run has which ends with this info."""

    def causes(self, episodes: Sequence["Episode"]) -> list[str]:
        """Return why every episode failed; "" for a success or where nothing is known."""

    def events(self, episodes: Sequence["Episode"]) -> dict[str, list[Any]]:
        """Return what else the world tells of runs: a name and one value, or None, for every episode."""


class SuccessOrFailure:
    """The diagnosis of a world that has none of its own: a run succeeds or its time runs out."""

    outcomes: tuple[str, ...] = (SUCCESS, OUT_OF_TIME)

    def outcome(self, info: Mapping[str, Any]) -> str:
        """Return `SUCCESS` where the info's `is_success` holds, `OUT_OF_TIME` elsewhere."""
        return SUCCESS if info["is_success"] else OUT_OF_TIME

    def causes(self, episodes: Sequence["Episode"]) -> list[str]:
        """Return "" for every episode."""
        return [""] * len(episodes)

    def events(self, episodes: Sequence["Episode"]) -> dict[str, list[Any]]:
        """Return nothing."""
        return {}


@dataclass(frozen=True)
class Moment:
    """One step of a run.

    Attributes:
        phase: the part of the task that the world was in, 0 where it does not tell.
        action: what the planner chose.
        macro: the planner's macro-action; `NO_MACRO` where it has none.
        reward: what the action earned.
        outcome: how the run ended, on its last step; "" before.
        view: the picture for people of the frame that the planner saw; None unless rendered.
        position: where the frame was seen from, metres; None where the world does not tell.
        loop: on the step that closes a loop, which is the last, the loop's number of steps; 0 otherwise.
    """

    phase: int
    action: int
    macro: int
    reward: float
    outcome: str
    view: UInt8[np.ndarray, "height width 3"] | None
    position: Float[np.ndarray, "2"] | None = None
    loop: int = 0


@dataclass(frozen=True)
class Episode:
    """One run of a planner; step t holds what the planner saw and chose at frame t.

    Attributes:
        seed: of the world.
        outcome: how the run ended, one of the `outcomes` of the world's diagnosis.
        actions: what the planner chose, 0..M-1.
        phases: the part of the task that the world was in, 0 where it does not tell.
        macros: the planner's macro-action, 0..Q-1; `NO_MACRO` where it has none.
        rewards: what every action earned.
        loop: number of last steps that repeat what was before, and would do so for ever; 0 where the run was
            never in the same situation twice.
        positions: where every frame was seen from, metres; None where the world does not tell.
    """

    seed: int
    outcome: str
    actions: UInt8[np.ndarray, " steps"]
    phases: Int8[np.ndarray, " steps"]
    macros: Int8[np.ndarray, " steps"]
    rewards: Float32[np.ndarray, " steps"]
    loop: int = 0
    positions: Float32[np.ndarray, "steps 2"] | None = None

    @property
    def success(self) -> bool:
        """Whether the world counts the run as a success."""
        return self.outcome == SUCCESS

    @property
    def steps(self) -> int:
        """Number of actions taken, up to where a loop was closed."""
        return len(self.actions)

    @property
    def reward(self) -> float:
        """Sum of rewards."""
        return float(self.rewards.sum())

    @property
    def first_change(self) -> int | None:
        """First step whose macro-action differs from that of the step before; None where it never changes."""
        changes = np.flatnonzero(np.diff(self.macros))
        return int(changes[0]) + 1 if len(changes) else None
