"""MacroPlanner: a policy that runs in one environment, and the state that a policy keeps between frames."""

from collections.abc import Hashable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Protocol, runtime_checkable

import gymnasium as gym
import numpy as np
import torch
from jaxtyping import Float, Int64
from torch import Tensor

from dpmacro.features.base import Observation, Seen
from dpmacro.features.history import History
from dpmacro.policy.config import PolicyConfig
from dpmacro.policy.observation import observed

__all__ = ["Decides", "MacroPlanner", "PolicyState", "looked_at"]


@dataclass(frozen=True)
class PolicyState:
    """What a policy keeps of every environment of a batch between two frames."""

    macro: Int64[Tensor, " batch"]  # the current macro-action, 0..Q-1; -1 where the first frame is to tell
    action: Int64[Tensor, " batch"]  # the last action, -1 before the first and where actions are vectors
    history: History  # what was seen
    seen: Seen = field(default_factory=dict)  # what the last scores were computed from


@runtime_checkable
class Decides(Protocol):
    """What a planner needs of its policy; `MacroPolicy` says what the parts mean."""

    @property
    def config(self) -> PolicyConfig: ...

    @property
    def device(self) -> torch.device: ...

    def initial_state(self, batch: int) -> PolicyState: ...

    def decide(
        self, observation: Observation, state: PolicyState
    ) -> tuple[Float[Tensor, "batch outputs"], PolicyState]: ...

    def restored(self, scores: Float[Tensor, "batch outputs"], observation: Observation) -> Tensor: ...


class MacroPlanner:
    """A policy in one running environment, as `dpmacro.worlds.base.Planner`.

    It uses the policy's inputs and nothing else. Images must have the size that the demonstrations were
    stored with, and are shrunk as the demonstrations were.
    """

    def __init__(self, policy: Decides) -> None:
        self.policy = policy
        self._state = policy.initial_state(1)
        self._seen = b""

    @property
    def macro(self) -> int:
        """The current macro-action, 0..Q-1."""
        return int(self._state.macro[0])

    @property
    def memory(self) -> Hashable:
        """Macro-action and last action: all of its state but what was seen before.

        None for a policy that looks further back than one frame, or whose actions are vectors.
        """
        further = any(lags[-1] > 1 for lags in self._state.history.needs.values())
        return None if further or self.policy.config.vector else (self.macro, int(self._state.action[0]))

    @property
    def seen(self) -> bytes:
        """What the last scores were computed from; equal bytes are equal frames."""
        return self._seen

    def reset(self, env: gym.Env | None = None) -> None:
        """Begin an episode, in any environment."""
        self._state = self.policy.initial_state(1)

    def act(
        self, observation: Mapping[str, Any], info: Mapping[str, Any]
    ) -> int | Float[np.ndarray, " dims"]:
        """Return the action for the present frame, a class or a vector.

        Raises ValueError for what is missing or has another size.
        """
        shown = self._shown(observation)
        scores = self._decided(shown)
        if self.policy.config.vector:
            return self.policy.restored(scores, shown)[0].cpu().numpy()
        action = int(scores[0].argmax())
        self.took(action)
        return action

    def scores(self, observation: Mapping[str, Any]) -> Float[np.ndarray, " outputs"]:
        """Return the scores at the present frame, once per frame; then call `took`.

        The macro-action changes here where a switch function fires. Raises ValueError for what is missing or
        has another size.
        """
        return self._decided(self._shown(observation))[0].cpu().numpy()

    def took(self, action: int) -> None:
        """Note the class that was taken at the present frame; switch functions depend on it."""
        self._state = replace(self._state, action=torch.tensor([action], device=self.policy.device))

    def _shown(self, observation: Mapping[str, Any]) -> dict[str, Tensor]:
        """The policy's inputs, a batch of one."""
        found = observed(observation, self.policy.config)
        return {
            key: torch.from_numpy(np.array(value))[None].to(self.policy.device)
            for key, value in found.items()
        }

    def _decided(self, shown: Observation) -> Float[Tensor, "1 outputs"]:
        first = not self._state.history.past
        scores, self._state = self.policy.decide(shown, self._state)
        (self._seen,) = looked_at(self._state, first)
        return scores


def looked_at(state: PolicyState, first: bool) -> list[bytes]:
    """For every row, what its last scores were computed from; equal bytes are equal frames.

    Args:
        state: after the policy decided.
        first: whether it was a run's first frame, before which there is none.
    """
    lags = sorted(state.seen)[: 1 if first else None]
    parts = [state.seen[lag][key].cpu().numpy() for lag in lags for key in sorted(state.seen[lag])]
    return [b"".join(part[row].tobytes() for part in parts) for row in range(len(state.macro))]
