"""Runs of a planner in a world, one seed an episode, in parallel processes.

A run that provably goes nowhere ends at once. Where the world's info tells its `state`, and the planner its
`memory`, a run that comes to a state, the state before it and a memory for the second time repeats for ever:
it ends there, with the outcome that it would have had at the world's last step.
"""

import json
import sys
from collections.abc import Generator, Hashable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import gymnasium as gym
import numpy as np
from jaxtyping import Float, Float32, Int8, UInt8

import dpmacro.worlds  # noqa: F401  registers the environments
from dpmacro.utils.processes import spread, stopped

SUCCESS = "success"
OUTCOMES = (SUCCESS, "red_first", "blue_never_reached", "red_never_reached")
NO_MACRO = -1


@runtime_checkable
class Planner(Protocol):
    """What chooses actions in one running environment; `macro`, where it has one, is its macro-action.

    A planner may have `memory`, a hashable: all that its next action and its next memory depend on beside the
    present and the previous state of the world, whose frames it sees. A planner that has none, or None, such
    as one that draws lots, is never cut short.
    """

    def reset(self, env: gym.Env) -> None:
        """Begin an episode of `env`, which was just reset."""

    def act(self, observation: dict[str, Any], info: dict[str, Any]) -> int:
        """The action to take."""


@dataclass(frozen=True)
class PlannerSource:
    """Where a planner comes from, small enough to send to another process.

    Attributes:
        kind: "teacher", or "policy" for a saved `MacroPolicy`.
        path: folder of the saved policy; None for the teacher.
        recovery: whether a policy that turns in circles gets itself out of them (dpmacro/policy/recovery.py).
    """

    kind: str
    path: Path | None = None
    recovery: bool = True

    def __post_init__(self) -> None:
        if self.kind not in ("teacher", "policy"):
            raise ValueError(f"planner {self.kind!r} is unknown, there are 'teacher' and 'policy'")
        if (self.kind == "policy") != (self.path is not None):
            raise ValueError(f"a policy needs a path and a teacher has none, got {self.kind} and {self.path}")

    def planner(self) -> Planner:
        """A new planner. Raises ValueError where the policy cannot be read."""
        if self.path is None:
            from dpmacro.worlds.two_flags.teacher import Teacher

            return Teacher()
        from dpmacro.policy.policy import MacroPolicy

        return MacroPolicy.load(self.path).planner(self.recovery)


@dataclass(frozen=True)
class Moment:
    """One step of a run.

    Attributes:
        phase: of the frame that the planner saw.
        action, macro: what the planner chose; macro-action -1 where it has none.
        reward: what the action earned.
        outcome: one of `OUTCOMES` on the last step, "" before.
        view: the picture for people of the frame the planner saw; None unless rendered.
        position: where the frame was seen from, metres; None where the world does not tell.
        loop: how many steps a loop has that this, the last step, closes; 0 otherwise.
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
    """One run of a planner, `steps` long; step t holds what the planner saw and chose at frame t.

    Attributes:
        outcome: one of `OUTCOMES`.
        loop: so many of the last steps lead back to where they began, and would for ever; 0 where the run
            was never in the same situation twice.
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


def run_episodes(
    source: PlannerSource, world: Mapping[str, Any], seeds: Sequence[int], workers: int = 1
) -> list[Episode]:
    """All of `iter_episodes`."""
    with closing(iter_episodes(source, world, seeds, workers)) as episodes:
        return list(episodes)


def iter_episodes(
    source: PlannerSource, world: Mapping[str, Any], seeds: Sequence[int], workers: int = 1
) -> Generator[Episode, None, None]:
    """One episode for every seed, in the order of `seeds`, the same for any number of workers.

    Args:
        source: the planner; read once per worker.
        world: {"id": of a registered environment, **its options}; built once per worker.
        seeds: one per episode.
        workers: processes; 1 runs in this one. Closing the iterator, or an interrupt, ends them.

    Raises:
        ValueError: workers < 1, or the planner cannot be read. What a worker raises is raised here.
    """
    if workers < 1:
        raise ValueError(f"workers is {workers}, it must be at least 1")
    if workers == 1:
        return _run_here(source, world, seeds)
    task = partial(_run_in_worker, source, json.dumps(dict(world)))
    return spread(task, seeds, min(workers, max(len(seeds), 1)))


def replay(
    source: PlannerSource, world: Mapping[str, Any], seed: int, every: int = 1
) -> Generator[Moment, None, None]:
    """The run of `seed` once more, now with pictures, so that other runs need not pay for them.

    Every `every`-th moment is rendered, from the first on; the others have no view.
    """
    with one_thread(), closing(_Stage(source, world, render_mode="rgb_array")) as stage:
        yield from stage.moments(seed, every)


class _Stage:
    """A world and a planner in it, for one episode after another."""

    def __init__(self, source: PlannerSource, world: Mapping[str, Any], render_mode: str | None = None):
        options = dict(world)
        self.planner = source.planner()
        self.env = gym.make(options.pop("id"), render_mode=render_mode, **options)

    def close(self) -> None:
        self.env.close()

    def moments(self, seed: int, every: int = 1) -> Generator[Moment]:
        observation, info = self.env.reset(seed=seed)
        self.planner.reset(self.env)
        step, ended, past = 0, False, Past()
        past.visit(info, self.planner)
        while not ended:
            rendered = self.env.render_mode is not None and step % every == 0
            view = np.asarray(self.env.render()) if rendered else None
            phase, position = int(info["phase"]), info.get("position")
            action = int(self.planner.act(observation, info))
            macro = int(getattr(self.planner, "macro", NO_MACRO))
            observation, reward, terminated, truncated, info = self.env.step(action)
            loop = 0 if terminated else past.visit(info, self.planner)
            ended = bool(terminated or truncated or loop)
            step += 1
            outcome = outcome_of(info) if ended else ""
            yield Moment(phase, action, macro, float(reward), outcome, view, position, loop)

    def episode(self, seed: int) -> Episode:
        moments = []
        with one_thread():
            for moment in self.moments(seed):
                moments.append(moment)
                if stopped():
                    raise InterruptedError(f"run of seed {seed} stopped after {len(moments)} steps")
        return Episode(
            seed=seed,
            outcome=moments[-1].outcome,
            actions=np.array([moment.action for moment in moments], np.uint8),
            phases=np.array([moment.phase for moment in moments], np.int8),
            macros=np.array([moment.macro for moment in moments], np.int8),
            rewards=np.array([moment.reward for moment in moments], np.float32),
            loop=moments[-1].loop,
            positions=None
            if moments[0].position is None
            else np.array([moment.position for moment in moments], np.float32),
        )


class Past:
    """The situations that a run has been in."""

    def __init__(self) -> None:
        self._times: dict[Hashable, int] = {}
        self._previous: Hashable = None

    def visit(self, info: Mapping[str, Any], planner: Planner) -> int:
        """Steps since the run was in the very same situation; 0 where it never was, or none can tell."""
        memory = getattr(planner, "memory", None)
        if memory is None or "state" not in info:
            return 0
        situation = self._previous, info["state"], memory
        self._previous = info["state"]
        now = len(self._times)
        return now - self._times.setdefault(situation, now)


def outcome_of(info: Mapping[str, Any]) -> str:
    """Which of `OUTCOMES` a run has that ends with this info."""
    if info["is_success"]:
        return SUCCESS
    return info["failure"] or ("red_never_reached" if info["phase"] else "blue_never_reached")


@contextmanager
def one_thread() -> Iterator[None]:
    # A frame at a time gains nothing from threads, and sums must not depend on how many there are.
    # The teacher needs no torch, whose import takes longer than an episode.
    torch = sys.modules.get("torch")
    if torch is None:
        yield
        return
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(threads)


def _run_here(
    source: PlannerSource, world: Mapping[str, Any], seeds: Sequence[int]
) -> Generator[Episode, None, None]:
    with closing(_Stage(source, world)) as stage:
        for seed in seeds:
            yield stage.episode(seed)


@cache
def _stage(source: PlannerSource, world: str) -> _Stage:
    """One world, given as JSON, and planner a process, for one run after another."""
    return _Stage(source, json.loads(world))


def _run_in_worker(source: PlannerSource, world: str, seed: int) -> Episode:
    return _stage(source, world).episode(seed)
