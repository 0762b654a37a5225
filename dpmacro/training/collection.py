"""Runs of a planner in which every frame is labelled with the teacher's action (DAgger).

Ross, Gordon, Bagnell 2011: a planner trained on a teacher's runs alone never saw the states that its own
mistakes lead to. Here the planner acts, and the teacher labels. Where the planner repeats a loop for ever,
the teacher acts until the next reward, so that a run has every part of the task in it and no part thousands
of times.
"""

import functools
import json
from collections.abc import Generator, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float32, Int64, UInt8

from dpmacro.evaluation.loops import VisitedStates
from dpmacro.evaluation.recording import true_labels
from dpmacro.evaluation.rollouts import PlannerSource, one_thread
from dpmacro.evaluation.stage import Stage
from dpmacro.policy.planner import MacroPlanner
from dpmacro.policy.policy import MacroPolicy
from dpmacro.utils.processes import spread, stopped
from dpmacro.worlds import expert_of, recording_of
from dpmacro.worlds.base import Expert, GaveUp

__all__ = ["Visit", "gather", "visit"]


@dataclass(frozen=True)
class Visit:
    """What was seen on one run; frame t holds the observation before step t.

    Attributes:
        images: what the planner sees.
        actions: what the teacher would do.
        truth: numbers of true labels, by the columns that the world's `Recording` has.
        taught: whether the teacher drove.
        rewards: what step t earned.
        success: whether the run ended well.
        agreed: whether the planner did, or would have done, what the teacher would do.
    """

    images: UInt8[np.ndarray, "frames height width 3"]
    actions: Int64[np.ndarray, " frames"]
    truth: dict[str, Int64[np.ndarray, " frames"]]
    taught: Bool[np.ndarray, " frames"]
    rewards: Float32[np.ndarray, " frames"]
    success: bool
    agreed: Bool[np.ndarray, " frames"]


def gather(
    source: PlannerSource, world: Mapping[str, Any], seeds: Iterable[int], workers: int
) -> Generator[Visit, None, None]:
    """One run for every seed, in their order, the same for any number of workers.

    Args:
        source: the policy that drives; its recovery stays off, so that circles are noticed.
        world: {"id": of a world that has a teacher, shows one camera and takes classes, **its options}.
        seeds: one a run.
        workers: processes, 1 or more.
    """
    yield from spread(functools.partial(visit, source, world), seeds, workers)


def visit(source: PlannerSource, world: Mapping[str, Any], seed: int) -> Visit:
    """One run, in this process."""
    with one_thread():
        return _visit(*_stage(source, json.dumps(world)), seed)


def _visit(stage: Stage, planner: MacroPlanner, teacher: Expert, seed: int) -> Visit:
    env, told, [camera] = stage.env, recording_of(stage.world), planner.policy.config.cameras
    observation, info = env.reset(seed=seed)
    planner.reset(env)
    teacher.reset(env)
    images, truth, taught, rewards, agreed = [], [], [], [], []
    actions: list[int] = []
    teaching, ended, visited = False, False, VisitedStates()
    visited.visit(info, planner)
    while not ended and not stopped():
        when = f"at step {len(actions)} of the run of seed {seed}"
        shown = stage.shown(observation, when)
        try:
            wanted = teacher.act(observation, info)
        except GaveUp:
            break
        chosen = planner.act(shown, info)
        if teaching:
            planner.took(wanted)
        images.append(shown[camera])
        truth.append(true_labels(told, teacher, info))
        actions.append(wanted)
        agreed.append(wanted == chosen)
        taught.append(teaching)
        done, _ = stage.does.of(wanted if teaching else chosen, when)
        observation, reward, terminated, truncated, info = env.step(done)
        rewards.append(reward)
        ended = bool(terminated or truncated)
        if reward > 0 and teaching:
            teaching, visited = False, VisitedStates()
        if visited.visit(info, teacher if teaching else planner):
            ended = ended or teaching  # the teacher turns in circles, too
            teaching, visited = True, VisitedStates()
    return Visit(
        images=np.stack(images),
        actions=np.array(actions, np.int64),
        truth={name: np.array([one[name] for one in truth], np.int64) for name in told.truth},
        taught=np.array(taught),
        rewards=np.array(rewards, np.float32),
        success=stage.rule.judge(info, rewards[-1], sum(rewards), bool(terminated))[0],
        agreed=np.array(agreed),
    )


@functools.cache
def _stage(source: PlannerSource, world: str) -> tuple[Stage, MacroPlanner, Expert]:
    """One world, given as JSON, and planner a process, for one run after another."""
    made = json.loads(world)
    assert source.path is not None, "the teacher has nothing to learn from itself"
    planner = MacroPlanner(MacroPolicy.load(source.path))
    return Stage(planner, made), planner, expert_of(made["id"])
