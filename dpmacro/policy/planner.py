"""MacroPlanner: a policy that runs in one environment, and the state that a policy keeps between frames."""

from collections.abc import Hashable
from dataclasses import dataclass, replace
from typing import Any, Protocol, runtime_checkable

import gymnasium as gym
import numpy as np
import torch
from jaxtyping import Bool, Float, Int64, UInt8
from torch import Tensor

from dpmacro.policy.config import PolicyConfig

__all__ = ["Decides", "MacroPlanner", "PolicyState"]


@dataclass
class PolicyState:
    """What a policy keeps of every environment of a batch between two frames."""

    macro: Int64[Tensor, " batch"]  # the current macro-action, 0..Q-1; -1 where the first frame is to tell
    action: Int64[Tensor, " batch"]  # the last action, -1 before the first
    previous: UInt8[Tensor, "batch height width 3"] | None = None  # None before the first frame
    restarted: Bool[Tensor, " batch"] | None = None  # environments whose next frame is their first


@runtime_checkable
class Decides(Protocol):
    """What a planner needs of its policy; `MacroPolicy` says what the parts mean."""

    @property
    def config(self) -> PolicyConfig: ...

    @property
    def device(self) -> torch.device: ...

    def initial_state(self, batch: int) -> PolicyState: ...

    def decide(
        self, images: UInt8[Tensor, "batch height width 3"], state: PolicyState
    ) -> tuple[Float[Tensor, "batch actions"], PolicyState]: ...


class MacroPlanner:
    """A policy in one running environment, as `dpmacro.worlds.base.Planner`.

    It uses the observation's `pixels` and nothing else. They must have the size that the demonstrations were
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
        """Macro-action and last action: all of its state but the previous frame."""
        return self.macro, int(self._state.action[0])

    @property
    def seen(self) -> bytes:
        """The frames that the last scores were computed from; equal bytes are equal frames."""
        return self._seen

    def reset(self, env: gym.Env | None = None) -> None:
        """Begin an episode, in any environment."""
        self._state = self.policy.initial_state(1)

    def act(self, observation: dict[str, np.ndarray], info: dict[str, Any]) -> int:
        """Return the action for the present frame. Raises ValueError for a frame of another size."""
        action = int(self.scores(observation).argmax())
        self.took(action)
        return action

    def scores(self, observation: dict[str, np.ndarray]) -> Float[np.ndarray, " actions"]:
        """Return the score of every action at the present frame, once per frame; then call `took`.

        The macro-action changes here where a switch function fires. Raises ValueError for a frame of another
        size.
        """
        pixels = self.policy.config.image_transform.apply(observation["pixels"], "the observation")
        images, previous = torch.from_numpy(pixels)[None], self._state.previous
        scores, self._state = self.policy.decide(images.to(self.policy.device), self._state)
        seen = images if previous is None else torch.cat([images, previous.cpu()])
        self._seen = seen.numpy().tobytes()
        return scores[0].cpu().numpy()

    def took(self, action: int) -> None:
        """Note the action that was taken at the present frame; switch functions depend on it."""
        self._state = replace(self._state, action=torch.tensor([action], device=self.policy.device))
