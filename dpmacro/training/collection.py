"""Runs of a planner in which every frame is labelled with the teacher's action (DAgger).

Ross, Gordon, Bagnell 2011: a planner trained on a teacher's runs alone never saw the states that its own
mistakes lead to. Here the planner acts, and the teacher labels. Where the planner repeats a loop for ever,
the teacher acts until the next reward, so that a run has every part of the task in it and no part thousands
of times. Loops are noticed where the world tells its state and actions are classes; other runs end by
themselves.
"""

import functools
import json
from collections.abc import Generator, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import gymnasium as gym
import numpy as np
from jaxtyping import Bool

from dpmacro.evaluation.loops import VisitedStates
from dpmacro.evaluation.recording import Run, run_of, true_labels
from dpmacro.evaluation.rollouts import PlannerSource, one_thread
from dpmacro.evaluation.stage import Stage
from dpmacro.policy.planner import MacroPlanner
from dpmacro.policy.policy import MacroPolicy
from dpmacro.utils.processes import spread, stopped
from dpmacro.worlds import expert_of, recording_of, stepping
from dpmacro.worlds.base import Expert, GaveUp
from dpmacro.worlds.making import blamed, import_package
from dpmacro.worlds.observations import ObservationMap

__all__ = ["Visit", "gather", "visit"]

NEAR = 0.1  # share of a number's range within which two vectors agree in it


@dataclass(frozen=True)
class Visit:
    """A run, and who acted in it.

    Attributes:
        run: what was seen, what the teacher would do, and how the run ended. Pictures are as large as the
            world shows them.
        taught: whether the teacher drove.
        agreed: whether the planner did, or would have done, what the teacher would do. Classes agree where
            they are equal. Vectors agree where no number of the planner's is further from the teacher's than
            a tenth of the action space's range in that dimension, both clipped into it; numbers without
            bounds do not count.
    """

    run: Run
    taught: Bool[np.ndarray, " frames"]
    agreed: Bool[np.ndarray, " frames"]


def gather(
    source: PlannerSource,
    world: Mapping[str, Any],
    inputs: Mapping[str, tuple[int, ...]],
    seeds: Iterable[int],
    workers: int,
) -> Generator[Visit | None, None, None]:
    """One run for every seed, in their order, the same for any number of workers.

    Args:
        source: the policy that drives; its recovery stays off, so that circles are noticed.
        world: {"id": of a world that has a teacher, **its options}.
        inputs: what is kept of observations, at least what the policy sees: shapes by LeRobot's keys, of
            pictures before they are shrunk.
        seeds: one a run.
        workers: processes, 1 or more.

    Yields None for a run in which the teacher gave up on the first frame. Raises WorldError where the world
    raises anything, or does not fit what the policy sees and does.
    """
    yield from spread(functools.partial(visit, source, world, inputs), seeds, workers)


def visit(
    source: PlannerSource, world: Mapping[str, Any], inputs: Mapping[str, tuple[int, ...]], seed: int
) -> Visit | None:
    """One run, in this process; arguments and errors are those of `gather`."""
    with one_thread():
        return _visit(*_stage(source, json.dumps(world), tuple(inputs.items())), seed)


def _visit(
    stage: Stage, planner: MacroPlanner, teacher: Expert, sees: ObservationMap, seed: int
) -> Visit | None:
    env, told = stage.env, recording_of(stage.world)
    when = f"at the start of the run of seed {seed}"
    observation, info = stepping.begin(env, stage.world, seed, when)
    planner.reset(env)
    with blamed(stage.world, when, stepping.EXPERT):
        teacher.reset(env)
    shown, truth, taught, rewards, agreed = [], [], [], [], []
    actions: list[Any] = []
    teaching, ended, terminated, visited = False, False, False, VisitedStates()
    visited.visit(info, planner)
    while not ended and not stopped():
        seen = sees.of(observation, when)
        try:
            wanted = stepping.act(teacher, stage.world, observation, info, when)
        except GaveUp:
            break
        chosen = planner.act(seen, info)
        if teaching and not planner.policy.config.vector:
            planner.took(wanted)
        shown.append(seen)
        truth.append(true_labels(told, teacher, info))
        when = f"at step {len(actions)} of the run of seed {seed}"
        asked, offered = (stage.does.of(action, when)[0] for action in (wanted, chosen))
        actions.append(wanted)
        agreed.append(_agree(env.action_space, asked, offered))
        taught.append(teaching)
        observation, reward, terminated, truncated, info = stepping.take(
            env, stage.world, asked if teaching else offered, when
        )
        rewards.append(reward)
        ended = terminated or truncated
        if reward > 0 and teaching:
            teaching, visited = False, VisitedStates()
        if visited.visit(info, teacher if teaching else planner):
            ended = ended or teaching  # the teacher turns in circles, too
            teaching, visited = True, VisitedStates()
    if not actions:
        return None
    success = stage.rule.judge(info, rewards[-1], sum(rewards), terminated)[0]
    task = str(getattr(teacher, "task", told.task))
    run = run_of(shown, actions, truth, rewards, task, success=success)
    return Visit(run, np.array(taught), np.array(agreed))


def _agree(space: gym.Space, one: Any, other: Any) -> bool:
    """Whether two actions, as the world takes them, are alike in the sense of `Visit.agreed`."""
    if not isinstance(space, gym.spaces.Box):
        return bool(one == other)
    span = space.high.astype(np.float64) - space.low.astype(np.float64)
    apart = np.abs(one.astype(np.float64) - other.astype(np.float64))
    return bool((apart <= NEAR * span).all())


@functools.cache
def _stage(
    source: PlannerSource, world: str, inputs: tuple[tuple[str, tuple[int, ...]], ...]
) -> tuple[Stage, MacroPlanner, Expert, ObservationMap]:
    """One world, given as JSON, and planner a process, for one run after another."""
    made = json.loads(world)
    import_package(made)
    assert source.path is not None, "the teacher has nothing to learn from itself"
    planner = MacroPlanner(MacroPolicy.load(source.path))
    stage, name = Stage(planner, made), made["id"]
    sees = ObservationMap.fit(name, stage.env.observation_space, dict(inputs), made.get("observations"))
    return stage, planner, expert_of(name), sees
