"""A world and a planner in it: what fits and what does not, and one run step by step."""

import warnings
from collections.abc import Generator, Mapping
from contextlib import nullcontext
from typing import Any

import gymnasium as gym
import numpy as np

from dpmacro.evaluation.loops import VisitedStates
from dpmacro.evaluation.motion import Motion
from dpmacro.worlds import DIAGNOSES, diagnosis_of, entry_of, stepping
from dpmacro.worlds.actions import ActionMap
from dpmacro.worlds.base import NO_MACRO, NO_PHASE, GaveUp, Moment, Planner, WorldError
from dpmacro.worlds.making import blamed, make_world
from dpmacro.worlds.observations import ObservationMap
from dpmacro.worlds.success import SuccessRule

__all__ = ["DIAGNOSIS", "Stage", "config_of", "inputs_of"]

DIAGNOSIS = "the diagnosis of the world"  # what is blamed where that raises


class Stage:
    """A world and a planner in it, for one run after another.

    A policy is shown its inputs by LeRobot's keys, an expert what the world shows.

    Attributes:
        env: the world.
        planner: what acts.
        sees: where the policy's inputs are; None for an expert.
        does: how actions are handed to the world.
        rule: what tells success.
        success_by: what told whether the last run succeeded, in words.
        period: of the last run, as `dpmacro.worlds.base.Episode` has it.

    Args:
        planner: what acts.
        world: {"id": of the world, **its options}, as `dpmacro.worlds.making` reads it.
        render_mode: None or "rgb_array".

    Raises ValueError where there is no such world, or the planner does not fit what it shows and takes.
    """

    def __init__(self, planner: Planner, world: Mapping[str, Any], render_mode: str | None = None) -> None:
        self.planner, self.world = planner, world["id"]
        config = config_of(planner)
        self.env = make_world(world, render_mode)
        classes = dims = self.sees = None
        if config is not None:
            names = len(config.action_names)
            classes, dims = (None, names) if config.vector else (names, None)
        with blamed(self.world, "asked for its spaces"):
            takes, shows = self.env.action_space, self.env.observation_space
        for name, space in (("action_space", takes), ("observation_space", shows)):
            if not isinstance(space, gym.Space):
                raise WorldError(
                    f"the world {self.world} has a {type(space).__name__} as {name}, and no space of "
                    "gymnasium: correct the world"
                )
        self.does = ActionMap.fit(self.world, takes, classes, dims)
        if config is not None:
            place = self.world, shows
            self.sees = ObservationMap.fit(*place, inputs_of(config), world.get("observations"))
        self._diagnosis = diagnosis_of(self.world)
        # What an info says beside success means what is thought only where someone has told about the world.
        self._known = entry_of(DIAGNOSES, self.world) is not None
        threshold = None if self.env.spec is None else self.env.spec.reward_threshold
        self.rule = SuccessRule(self.world, world.get("success"), threshold)
        self.success_by, self.period = "", 0

    def close(self) -> None:
        """Let go of the world."""
        try:
            stepping.close(self.env, self.world)
        except WorldError as error:  # the runs are done
            warnings.warn(f"{error}; no run depends on it", stacklevel=1)

    def moments(self, seed: int, every: int = 1) -> Generator[Moment]:
        """The steps of the run of this seed; where the world renders, every `every`-th has a view.

        Raises WorldError where the world raises anything, or shows or is given what it should not.
        """
        when = f"at the start of the run of seed {seed}"
        observation, info = stepping.begin(self.env, self.world, seed, when)
        shown = self.shown(observation, when)
        with nullcontext() if self.sees else blamed(self.world, when, stepping.EXPERT):
            self.planner.reset(self.env)
        step, visited, total = 0, VisitedStates(), 0.0
        # A world that someone has told about tells itself what happens at the end.
        motion = None if self._known else Motion()
        if self._known:
            visited.visit(info, self.planner)
        chosen = self._chosen(shown, info, when)
        if chosen is None:
            raise WorldError(f"the expert of the world {self.world} knows no action {when}: give other seeds")
        while chosen is not None:
            when = f"at step {step} of the run of seed {seed}"
            view = None
            if self.env.render_mode is not None and step % every == 0:
                view = stepping.render(self.env, self.world, when)
            phase = int(info.get("phase", NO_PHASE)) if self._known else NO_PHASE
            position = info.get("position") if self._known else None
            macro = int(getattr(self.planner, "macro", NO_MACRO))
            action, clipped = self.does.of(chosen, when)
            observation, reward, terminated, truncated, info = stepping.take(
                self.env, self.world, action, when
            )
            shown = self.shown(observation, when)
            if motion is not None:
                motion.see(_arrays(shown))
            loop = visited.visit(info, self.planner) if self._known and not terminated else 0
            ended = terminated or truncated or loop
            step, total = step + 1, total + reward
            success, outcome = self.rule.shown(info), ""
            chosen = None if ended else self._chosen(shown, info, f"at step {step} of the run of seed {seed}")
            if chosen is None:
                success, self.success_by = self.rule.judge(info, reward, total, terminated)
                end = {**info, "is_success": success, "terminated": terminated}
                with blamed(self.world, when, DIAGNOSIS):
                    outcome = self._diagnosis.outcome(end)
                self.period = 0 if motion is None else motion.period()
            done = action - self.does.start if np.ndim(action) == 0 else action
            yield Moment(phase, done, macro, reward, outcome, view, position, loop, clipped, success)

    def shown(self, observation: Any, when: str) -> Any:
        """What the planner is shown of an observation; WorldError, which says `when`, for an unfit one."""
        return observation if self.sees is None else self.sees.of(observation, when)

    def _chosen(self, shown: Any, info: dict[str, Any], when: str) -> Any:
        """The planner's action; None where an expert knows none, which ends the run."""
        if self.sees is not None:
            return self.planner.act(shown, info)
        try:
            return stepping.act(self.planner, self.world, shown, info, when)
        except GaveUp:
            return None


def config_of(planner: Planner) -> Any:
    """The `PolicyConfig` of the policy that a planner runs; None for an expert."""
    running = getattr(planner, "planner", planner)  # one that recovers from loops has another within
    return getattr(getattr(running, "policy", None), "config", None)


def inputs_of(config: Any) -> dict[str, tuple[int, ...]]:
    """What a policy wants to be shown, by LeRobot's keys: shapes, of pictures before they are shrunk."""
    return {
        key: (*one.stored_shape, 3) if one.stored_shape else tuple(one.shape)
        for key, one in config.inputs.items()
    }


def _arrays(shown: Any) -> dict[str, np.ndarray]:
    """What an expert was shown, as far as it is arrays; a policy's inputs as they are."""
    if not isinstance(shown, Mapping):
        shown = {"": shown}
    arrays = {key: np.asarray(value) for key, value in shown.items() if not isinstance(value, Mapping)}
    return {key: value for key, value in arrays.items() if value.dtype.kind in "biuf"}
