"""What every world and whatever runs in one agree on: planners, runs, and the names of how runs end."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol, runtime_checkable

import gymnasium as gym
import numpy as np
from jaxtyping import Float, Float32, Int8, Int64, UInt8

__all__ = [
    "ENDED",
    "NO_MACRO",
    "NO_PHASE",
    "OUT_OF_TIME",
    "SUCCESS",
    "Diagnosis",
    "Episode",
    "Expert",
    "GaveUp",
    "GenericDiagnosis",
    "Moment",
    "Planner",
    "Recording",
    "WorldError",
]

SUCCESS = "success"
OUT_OF_TIME = "out_of_time"
ENDED = "ended"
NO_MACRO = -1
NO_PHASE = -1


class WorldError(ValueError):
    """What a world is, shows, takes or does is not what runs in it need; one line, with a remedy."""


class GaveUp(Exception):  # noqa: N818  an answer rather than an error
    """An expert knows no action for the situation that it is in: the run has failed."""


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
    """A world's teacher: a planner that may read the world's true state in `reset` and `act`.

    It is given what the world itself shows, under the world's own names. After `act` it may tell, in
    attributes of these names, the true labels of the frame that `Recording.truth` lists, and in `task` what
    the episode is about. Where it knows no action, `act` raises `GaveUp`.
    """


@dataclass(frozen=True)
class Recording:
    """What recordings of a world say beside what was seen and done.

    Attributes:
        task: in words; an expert's attribute `task` says more, where it has one.
        truth: columns of true labels, each with the names of its labels 0, 1, ...; the number of a frame is
            the attribute of this name that the expert has after `act`, else what the info names so.
        actions: names of the classes, or of the numbers of a vector.
        fps: steps a second.
        symmetric: whether the world and its mirror image are alike.
        observations: the world's own names of what is recorded, by LeRobot's keys; None for all that it
            shows, under LeRobot's usual keys.
        noisy: factor on the noise that a recording may add to each number of an action; () where none may.
        states: names of the numbers of vectors that are seen, by LeRobot's keys, as far as they have any.
    """

    task: str
    truth: Mapping[str, tuple[str, ...]]
    actions: tuple[str, ...]
    fps: int
    symmetric: bool = False
    observations: Mapping[str, str] | None = None
    noisy: tuple[float, ...] = ()
    states: Mapping[str, tuple[str, ...]] = field(default_factory=dict)


@runtime_checkable
class Diagnosis(Protocol):
    """A world's names for how runs end and why they fail.

    Attributes:
        outcomes: every outcome there is, `SUCCESS` first.
    """

    outcomes: tuple[str, ...]

    def outcome(self, info: Mapping[str, Any]) -> str:
        """Return the one of `outcomes` that a run has which ends with this info.

        Beside what the world tells, the info holds `is_success`, whatever tells success in this world, and
        `terminated`, whether the world itself ended the run.
        """

    def causes(self, episodes: Sequence["Episode"]) -> list[str]:
        """Return why every episode failed; "" for a success or where nothing is known."""

    def events(self, episodes: Sequence["Episode"]) -> dict[str, list[Any]]:
        """Return what else the world tells of runs: a name and one value, or None, for every episode."""


class GenericDiagnosis:
    """The diagnosis of a world that has none of its own.

    A run succeeds, or the world ends it, or its time runs out. A failed run has the first of these causes
    that applies:

    - success_lost: the world was successful at some step and not at the end.
    - cycle: the end repeats the same few observations, or the run was in the same situation twice.
    - no_motion: what is observed stays the same in the last steps.
    - ended: the world ended the run.
    - out_of_time: none of these.
    """

    outcomes: tuple[str, ...] = (SUCCESS, OUT_OF_TIME, ENDED)

    def outcome(self, info: Mapping[str, Any]) -> str:
        """Return which of `outcomes` a run has that ends with this info."""
        if info["is_success"]:
            return SUCCESS
        return ENDED if info["terminated"] else OUT_OF_TIME

    def causes(self, episodes: Sequence["Episode"]) -> list[str]:
        """Return why every episode failed, one of those above; "" for a success."""
        return [self._cause(episode) for episode in episodes]

    def events(self, episodes: Sequence["Episode"]) -> dict[str, list[Any]]:
        """Return nothing."""
        return {}

    @staticmethod
    def _cause(episode: "Episode") -> str:
        if episode.success:
            return ""
        if episode.first_success is not None:
            return "success_lost"
        if episode.loop or episode.period > 1:
            return "cycle"
        return "no_motion" if episode.period else episode.outcome


@dataclass(frozen=True)
class Moment:
    """One step of a run.

    Attributes:
        phase: the part of the task that the world was in, `NO_PHASE` where it does not tell.
        action: what was done in the world, a class or a vector.
        macro: the planner's macro-action; `NO_MACRO` where it has none.
        reward: what the action earned.
        outcome: how the run ended, on its last step; "" before.
        view: the picture for people of the frame that the planner saw; None unless rendered.
        position: where the frame was seen from, metres; None where the world does not tell.
        loop: on the step that closes a loop, which is the last, the loop's number of steps; 0 otherwise.
        clipped: whether the planner's vector had to be clipped into what the world takes.
        success: whether the world was successful after the step; where rewards tell, on the last step only.
    """

    phase: int
    action: Any
    macro: int
    reward: float
    outcome: str
    view: UInt8[np.ndarray, "height width 3"] | None
    position: Float[np.ndarray, "2"] | None = None
    loop: int = 0
    clipped: bool = False
    success: bool = False


@dataclass(frozen=True)
class Episode:
    """One run of a planner; step t holds what the planner saw and chose at frame t.

    Attributes:
        seed: of the world.
        outcome: how the run ended, one of the `outcomes` of the world's diagnosis.
        actions: what was done in the world: classes 0..M-1, or vectors.
        phases: the part of the task that the world was in, `NO_PHASE` where it does not tell.
        macros: the planner's macro-action, 0..Q-1; `NO_MACRO` where it has none.
        rewards: what every action earned.
        loop: number of last steps that repeat what was before, and would do so for ever; 0 where the run was
            never in the same situation twice.
        positions: where every frame was seen from, metres; None where the world does not tell.
        period: number of steps after which the observations at the end repeat themselves, 1 where nothing
            moves; 0 where they do not, the run was short, or the world has a diagnosis of its own.
        clipped: number of steps whose vector had to be clipped into what the world takes.
        first_success: first step after which the world was successful; None where there is none.
        success_by: what told whether the run succeeded, in words.
    """

    seed: int
    outcome: str
    actions: UInt8[np.ndarray, " steps"] | Int64[np.ndarray, " steps"] | Float32[np.ndarray, "steps dims"]
    phases: Int8[np.ndarray, " steps"]
    macros: Int8[np.ndarray, " steps"]
    rewards: Float32[np.ndarray, " steps"]
    loop: int = 0
    positions: Float32[np.ndarray, "steps 2"] | None = None
    period: int = 0
    clipped: int = 0
    first_success: int | None = None
    success_by: str = ""

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
