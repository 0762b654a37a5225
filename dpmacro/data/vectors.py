"""Vectors of action <-> what is learned of them: without constant numbers, beside the state, standardised."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float32, Int64
from torch import Tensor

from dpmacro.utils.checks import as_count, as_entries, as_flag, as_number, as_text, shown

__all__ = ["ActionTransform"]

EPSILON = 1e-6  # spread and differences below this share of a number's size are rounding
RARE = 1e-3  # share of frames, all in few trajectories, that a constant number may differ in
FEW = 0.05  # share of the trajectories
MOST = 1e30  # of a mean or a scale in a file: float32 holds what comes of it
NEAR = 0.5  # spread of action - state over the state's, below which actions are targets for the state


@dataclass(frozen=True)
class ActionTransform:
    """What strong learners learn of actions of D numbers, and the way back.

    Attributes:
        mean: of every number, less the state where `relative`; what a number is that is not kept.
        scale: standard deviation likewise, above 0.
        kept: the numbers that are learned, ascending, at least one.
        relative: whether what is learned is the action less the state.
        fixed: numbers whose action is constant, whatever the state; they and those that keep a constant
            distance from the state are not kept.
        names: of all numbers.
        nearness: median over the kept numbers of the spread of action - state over the state's; None where
            the two cannot be compared.
    """

    mean: tuple[float, ...]
    scale: tuple[float, ...]
    kept: tuple[int, ...]
    relative: bool = False
    fixed: tuple[int, ...] = ()
    names: tuple[str, ...] = ()
    nearness: float | None = None

    @classmethod
    def fit(
        cls,
        actions: Float32[np.ndarray, "frames dims"],
        lengths: Int64[np.ndarray, " trajectories"],
        state: Float32[np.ndarray, "frames size"] | None = None,
        relative: bool | None = None,
        names: Sequence[str] = (),
    ) -> "ActionTransform":
        """The transform of these actions.

        A number is constant where its values differ by no more than rounding, or all but RARE of the frames
        have its median and what differs is in FEW of the trajectories. Actions are taken for targets, and
        learned less the state, where the state has as many numbers and the median of
        std(action - state) / std(state) is below NEAR; action and state then correlate by .86 or more.

        Args:
            actions: finite.
            lengths: frames of the trajectories.
            state: what holds the numbers that actions may be targets for; None where there is none.
            relative: whether actions are learned less the state; None for what the data says.
            names: of the numbers; their places by default.

        Raises ValueError where all numbers are constant, and for `relative` without a state of as many.
        """
        dims = actions.shape[1]
        names = tuple(names) if len(names) == dims else tuple(map(str, range(dims)))
        values = actions.astype(np.float64)
        fixed = _constant(values, lengths)
        beside = state.astype(np.float64) if state is not None and state.shape[1] == dims else None
        if relative and beside is None:
            has = "no state" if state is None else f"a state of {state.shape[1]} numbers"
            raise ValueError(
                f"action_relative is true, but beside actions of {dims} numbers there is {has}: "
                "give false or auto"
            )
        differences = values if beside is None else values - beside
        nearness = None if beside is None else _nearness(differences, beside, fixed)
        if relative is None:
            relative = nearness is not None and nearness < NEAR
        targets = np.where(fixed, values, differences) if relative else values
        constant = fixed | _constant(targets, lengths)
        if constant.all():
            raise ValueError(
                f"all {dims} numbers of the action are constant ({', '.join(names)}): nothing to learn"
            )
        mean = np.where(constant, np.median(targets, axis=0), targets.mean(axis=0))
        size = np.maximum(np.abs(targets).max(axis=0), np.finfo(np.float32).tiny)
        scale = np.maximum(targets.std(axis=0), EPSILON * size)
        return cls(
            tuple(mean.tolist()),
            tuple(scale.tolist()),
            tuple(np.flatnonzero(~constant).tolist()),
            bool(relative),
            tuple(np.flatnonzero(fixed).tolist()),
            names,
            nearness,
        )

    def targets(
        self,
        actions: Float32[np.ndarray, "frames dims"],
        state: Float32[np.ndarray, "frames size"] | None = None,
    ) -> Float32[np.ndarray, "frames kept"]:
        """What is learned: the kept numbers, less the state where `relative`, standardised."""
        kept = list(self.kept)
        values = actions[:, kept].astype(np.float64)
        if self.relative:
            values -= self._stated(state)[:, kept]
        return ((values - np.array(self.mean)[kept]) / np.array(self.scale)[kept]).astype(np.float32)

    def restore(
        self, scores: Float32[Tensor, "batch kept"], state: Float32[Tensor, "batch size"] | None = None
    ) -> Float32[Tensor, "batch dims"]:
        """The actions that the scores, of the kind of `targets`, stand for; the state is that of acting."""
        mean, scale = (scores.new_tensor(values) for values in (self.mean, self.scale))
        actions = mean.repeat(len(scores), 1)
        kept = list(self.kept)
        actions[:, kept] += scores * scale[kept]
        if self.relative:
            free = [dim for dim in range(len(self.mean)) if dim not in self.fixed]
            actions[:, free] += self._stated(state)[:, free].to(actions)
        return actions

    def report(self) -> list[str]:
        """What people should know of the choices made, a sentence each."""
        lines = []
        nearness = (
            "" if self.nearness is None else f" (action - state spreads {self.nearness:.2g} of the state)"
        )
        if self.relative:
            lines.append(f"actions are targets for the state: learned is action - state{nearness}")
        elif nearness:
            lines.append(f"actions are learned as they are, not less the state{nearness}")
        out = [dim for dim in range(len(self.mean)) if dim not in self.kept]
        fixed = [f"{self.names[dim]} ({self.mean[dim]:.4g})" for dim in out if dim in self.fixed]
        follow = [self.names[dim] for dim in out if dim not in self.fixed]
        if fixed:
            lines.append(f"constant and left out of the actions: {', '.join(fixed)}")
        if follow:
            lines.append(f"always as far from the state, and left out of the actions: {', '.join(follow)}")
        return lines

    def to_dict(self) -> dict[str, Any]:
        """Numbers, lists and text alone, for JSON."""
        lists = {name: list(getattr(self, name)) for name in ("mean", "scale", "kept", "fixed", "names")}
        return {**lists, "relative": self.relative, "nearness": self.nearness}

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> "ActionTransform":
        """What `to_dict` gave. Raises ValueError for anything else."""
        try:
            known = {name: values[name] for name in ("mean", "scale", "kept", "fixed", "names", "relative")}
            return cls._checked(**known, nearness=values.get("nearness"))
        except KeyError as error:
            raise ValueError(f"no transform of actions, it has no {error}: train the policy again") from error
        except ValueError as error:
            raise ValueError(f"no transform of actions, {error}; train the policy again") from error

    @classmethod
    def _checked(
        cls, mean: Any, scale: Any, kept: Any, fixed: Any, names: Any, relative: Any, nearness: Any
    ) -> "ActionTransform":
        """The transform of what a file holds. Raises ValueError that names the part that cannot be."""
        dims = len(as_entries("mean", mean))
        for place, (own, spread) in enumerate(zip(mean, as_entries("scale", scale, dims), strict=True)):
            as_number(f"mean[{place}]", own, least=-MOST, most=MOST)
            as_number(f"scale[{place}]", spread, above=0.0, most=MOST)
        for name, places in (("kept", kept), ("fixed", fixed)):
            for place, own in enumerate(as_entries(name, places)):
                as_count(f"{name}[{place}]", own, 0, dims - 1)
            if any(first >= second for first, second in itertools.pairwise(places)):
                raise ValueError(f"{name} is {shown(places)}: give each number once, ascending")
        if not kept or {*kept} & {*fixed}:
            raise ValueError(f"kept is {shown(kept)}: give one number at least, and none that is fixed")
        for place, own in enumerate(as_entries("names", names, dims)):
            as_text(f"names[{place}]", own)
        if nearness is not None:
            as_number("nearness", nearness, least=0.0)
        as_flag("relative", relative)
        return cls(tuple(mean), tuple(scale), tuple(kept), relative, tuple(fixed), tuple(names), nearness)

    def _stated(self, state: Any) -> Any:
        if state is None or state.shape[1] != len(self.mean):
            has = "none" if state is None else f"one of {state.shape[1]} numbers"
            raise ValueError(
                f"actions are learned less a state of {len(self.mean)} numbers, got {has}: give that"
            )
        return state


def _constant(values: np.ndarray, lengths: np.ndarray) -> Bool[np.ndarray, " dims"]:
    """Which numbers have one value but for rounding and rare outliers."""
    size = np.abs(values).max(axis=0)
    differs = np.abs(values - np.median(values, axis=0)) > EPSILON * size
    of_trajectory = np.repeat(np.arange(len(lengths)), lengths)
    few = max(1.0, FEW * len(lengths))
    rare = [len(np.unique(of_trajectory[one])) <= few and one.sum() <= RARE * len(one) for one in differs.T]
    return np.array(rare, bool)


def _nearness(differences: np.ndarray, state: np.ndarray, fixed: np.ndarray) -> float | None:
    """Median of std(action - state) / std(state) over what moves; None where nothing does."""
    moves = ~fixed & (state.std(axis=0) > EPSILON * np.abs(state).max(axis=0))
    if not moves.any():
        return None
    return float(np.median(differences.std(axis=0)[moves] / state.std(axis=0)[moves]))
