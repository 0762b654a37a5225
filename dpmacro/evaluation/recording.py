"""Runs of a world's expert, frame by frame, as they are recorded."""

import functools
import itertools
import json
from collections.abc import Generator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float32, Int64, UInt8

from dpmacro.utils.processes import spread, stopped
from dpmacro.worlds import expert_of, recording_of, stepping
from dpmacro.worlds.actions import ActionMap
from dpmacro.worlds.base import GaveUp, Recording, WorldError
from dpmacro.worlds.making import blamed, import_package, make_world
from dpmacro.worlds.observations import ObservationMap
from dpmacro.worlds.success import SuccessRule

__all__ = ["Run", "check_expert", "expert_runs", "run_expert", "run_of", "true_labels"]


@dataclass(frozen=True)
class Run:
    """A run with an expert's actions; frame t holds the observation before action t.

    Attributes:
        observations: by LeRobot's keys; pictures uint8 [frames, height, width, 3], vectors float32
            [frames, size].
        actions: what the expert chose, classes or vectors; something else may have been done, as in runs with
            noise.
        truth: numbers of true labels, by column.
        rewards: what every action earned.
        task: in words.
        views: pictures for people; None unless asked for.
        success: whether the run ended well.
    """

    observations: dict[str, np.ndarray]
    actions: Int64[np.ndarray, " frames"] | Float32[np.ndarray, "frames dims"]
    truth: dict[str, Int64[np.ndarray, " frames"]]
    rewards: Float32[np.ndarray, " frames"]
    task: str
    views: UInt8[np.ndarray, "frames view_height view_width 3"] | None = None
    success: bool = True


def run_of(
    shown: Sequence[Mapping[str, np.ndarray]],
    actions: Sequence[Any],
    truth: Sequence[Mapping[str, int]],
    rewards: Sequence[float],
    task: str,
    views: Sequence[np.ndarray] = (),
    success: bool = True,
) -> Run:
    """The run whose frames, at least one, were kept in lists; what the parts are is said in `Run`."""
    return Run(
        observations={key: np.stack([one[key] for one in shown]) for key in shown[0]},
        actions=np.array(actions, np.float32 if np.ndim(actions[0]) else np.int64),
        truth={name: np.array([one[name] for one in truth], np.int64) for name in truth[0]},
        rewards=np.array(rewards, np.float32),
        task=task,
        views=np.stack(views) if len(views) else None,
        success=success,
    )


def expert_runs(
    world: Mapping[str, Any], seed: int, workers: int, noise: float = 0.0, view: bool = False
) -> Generator[Run | None, None, None]:
    """The runs of seed, seed + 1, ... without end, by as many processes; None for each that failed.

    Arguments and errors are those of `run_expert`.
    """
    return spread(
        functools.partial(_run_in_worker, json.dumps(dict(world)), noise, view),
        itertools.count(seed),
        workers,
    )


def run_expert(world: Mapping[str, Any], seed: int, noise: float = 0.0, view: bool = False) -> Run | None:
    """The expert's run of a seed, in this process; None where it fails.

    Args:
        world: {"id": of a world that has an expert, **its options}, as `dpmacro.worlds.making` reads it.
        seed: of the world, and of the noise.
        noise: standard deviation of normal noise that is added to the actions done, not to those recorded.
        view: whether pictures for people are kept.

    Raises ValueError where there is no such world, it has no expert, or its actions take no noise.
    """
    return _run_in_worker(json.dumps(dict(world)), noise, view, seed)


def check_expert(world: Mapping[str, Any], noise: float) -> Recording:
    """What recordings of the world say. Raises ValueError where it has no expert, or takes no noise."""
    import_package(world)
    told = recording_of(world["id"])
    if noise and not told.noisy:
        raise ValueError(f"noise is {noise:g}: actions in {world['id']} take none, leave it out")
    return told


def true_labels(told: Recording, expert: Any, info: Mapping[str, Any]) -> dict[str, int]:
    """The true label of a frame in every column, after the expert has acted on it."""
    labels: dict[str, Any] = {name: getattr(expert, name, info.get(name)) for name in told.truth}
    missing = [name for name, label in labels.items() if label is None]
    if missing:
        raise WorldError(
            f"neither the expert nor the info tells {missing[0]!r}, a column of the world's Recording: "
            "correct one of the three"
        )
    return {name: int(label) for name, label in labels.items()}


def _run_in_worker(world: str, noise: float, view: bool, seed: int) -> Run | None:
    return _set(world, noise, view).run(seed)


@functools.cache
def _set(world: str, noise: float, view: bool) -> "_Set":
    """One world, given as JSON, and expert a process, for one run after another."""
    return _Set(json.loads(world), noise, view)


class _Set:
    """A world, its expert, and what is kept of their runs."""

    def __init__(self, world: Mapping[str, Any], noise: float, view: bool) -> None:
        self.world, self.noise, self.view = world["id"], noise, view
        self.told = check_expert(world, noise)
        self.expert = expert_of(self.world)
        self.env = make_world(world, "rgb_array" if view else None)
        names = world.get("observations") or self.told.observations
        self.sees = ObservationMap.fit(self.world, self.env.observation_space, None, names)
        self.does = ActionMap.fit(self.world, self.env.action_space)
        threshold = None if self.env.spec is None else self.env.spec.reward_threshold
        self.rule = SuccessRule(self.world, world.get("success"), threshold)

    def run(self, seed: int) -> Run | None:
        """The run of a seed; None where it fails."""
        rng = np.random.default_rng(seed)
        when = f"at the start of the run of seed {seed}"
        observation, info = stepping.begin(self.env, self.world, seed, when)
        with blamed(self.world, when, stepping.EXPERT):
            self.expert.reset(self.env)
        task = str(getattr(self.expert, "task", self.told.task))
        frames: list[tuple[Any, ...]] = []
        views: list[np.ndarray] = []
        ended = False
        while not ended:
            if stopped():
                return None
            seen = self.sees.of(observation, when)
            if self.view:
                views.append(stepping.render(self.env, self.world, when))
            try:
                action = stepping.act(self.expert, self.world, observation, info, when)
            except GaveUp:
                return None
            labels = true_labels(self.told, self.expert, info)
            when = f"at step {len(frames)} of the run of seed {seed}"
            done, _ = self.does.of(self._disturbed(action, rng), when)
            observation, reward, terminated, truncated, info = stepping.take(self.env, self.world, done, when)
            frames.append((seen, action, labels, reward))
            ended = terminated or truncated
        shown, actions, truth, rewards = zip(*frames, strict=True)
        if not self.rule.judge(info, rewards[-1], sum(rewards), terminated)[0]:
            return None
        return run_of(shown, actions, truth, rewards, task, views)

    def _disturbed(self, action: Any, rng: np.random.Generator) -> Any:
        """The action that is done in place of the one that the expert chose."""
        if not self.told.noisy:
            return action
        if len(self.told.noisy) != len(action):
            raise WorldError(
                f"the recording of {self.world} has noise for {len(self.told.noisy)} numbers, and its "
                f"actions have {len(action)}: correct its Recording"
            )
        drawn = rng.normal(size=len(action)) * np.array(self.told.noisy)
        return (action + self.noise * drawn).astype(np.float32)
