"""DpmacroPolicy: a MacroPolicy that LeRobot loads and runs on batches of observations."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, NoReturn

import torch
from jaxtyping import Float, Float32, Int64
from lerobot.policies.pretrained import PreTrainedPolicy
from torch import Tensor

from dpmacro.policy.lerobot.configuration_dpmacro import DpmacroConfig, refuse_training
from dpmacro.policy.lerobot.inputs import inputs_of
from dpmacro.policy.planner import PolicyState, looked_at
from dpmacro.policy.policy import WEIGHTS_NAME, MacroPolicy
from dpmacro.policy.recovery import LoopBreaker

__all__ = ["DpmacroPolicy"]

SEED = 0  # of recovery's random draws, which are the same in every episode


class DpmacroPolicy(PreTrainedPolicy):
    """A policy of dpmacro as LeRobot's.

    Every row of a batch is an environment with a state of its own: its macro-action, what it saw and did
    before, and its loops where the policy recovers from them. `reset` begins all of them anew. Rows whose
    episode has ended may be stepped on, as `lerobot-eval` does; what is chosen for them does not touch the
    others.

    Attributes:
        macro_policy: what acts; None until numbers are loaded, as `from_pretrained` does.
    """

    config_class = DpmacroConfig
    name = "dpmacro"

    def __init__(self, config: DpmacroConfig, *unused: Any, **training: Any) -> None:
        """Take the config alone: what LeRobot tells of a dataset to train on is not used.

        Raises ValueError where the config holds no policy, or the environment's action does not fit.
        """
        super().__init__(config)
        config.validate_features()
        self.macro_policy: MacroPolicy | None = None
        self.reset()

    @property
    def macro(self) -> Int64[Tensor, " batch"] | None:
        """The current macro-action of every row, 0..Q-1; None before the first action."""
        return None if self._state is None else self._state.macro

    def reset(self) -> None:
        """Begin an episode in every row."""
        self._state: PolicyState | None = None
        self._breakers: list[LoopBreaker] = []

    @torch.inference_mode()
    def select_action(self, batch: dict[str, Any], **unused: Any) -> Float32[Tensor, "batch dims"]:
        """The action of every row: a vector in the dataset's units, or a class as the environment takes it.

        A class is one number a class, 1 for the one taken and 0 for the others; where the environment's
        action is one number, it is that of the class.

        Raises ValueError as `inputs_of`, and where the number of rows changes without a `reset`.
        """
        policy = self._loaded
        seen = inputs_of(batch, policy.config, policy.device)
        rows = len(next(iter(seen.values())))
        state = self._started(policy, rows) if self._state is None else self._state
        if len(state.macro) != rows:
            raise ValueError(
                f"the batch has {rows} rows and had {len(state.macro)} before: reset the policy in between"
            )
        first = not state.history.past
        scores, state = policy.decide(seen, state)
        if policy.config.vector:
            self._state = state
            return policy.restored(scores, seen)
        actions = self._classes(scores, state, first)
        self._state = replace(state, action=actions)
        if not self.config.one_hot:
            return actions[:, None].to(torch.float32)
        return torch.nn.functional.one_hot(actions, policy.config.outputs).to(torch.float32)

    def predict_action_chunk(self, batch: dict[str, Any], **unused: Any) -> Float32[Tensor, "batch 1 dims"]:
        """The actions of `select_action`, as chunks of one."""
        return self.select_action(batch)[:, None]

    def forward(self, batch: dict[str, Any]) -> NoReturn:
        """Raise ValueError: LeRobot cannot train it."""
        refuse_training()

    def get_optim_params(self) -> NoReturn:
        """Raise ValueError: LeRobot cannot train it."""
        refuse_training()

    @property
    def _loaded(self) -> MacroPolicy:
        if self.macro_policy is None:
            raise ValueError(
                "the policy has a config and no numbers: load it by DpmacroPolicy.from_pretrained"
            )
        return self.macro_policy

    def _started(self, policy: MacroPolicy, rows: int) -> PolicyState:
        """The state of that many rows before their first frame."""
        stretches = policy.replayed(self.config.recovery)
        self._breakers = [] if stretches is None else [LoopBreaker(stretches, SEED) for _ in range(rows)]
        return policy.initial_state(rows)

    def _classes(
        self, scores: Float[Tensor, "batch classes"], state: PolicyState, first: bool
    ) -> Int64[Tensor, " batch"]:
        """The classes to take: the highest, or what gets a row out of its loop."""
        if not self._breakers:
            return scores.argmax(1)
        rows = zip(
            self._breakers, looked_at(state, first), state.macro.tolist(), scores.cpu().numpy(), strict=True
        )
        chosen = [breaker.act(seen, macro, own) for breaker, seen, macro, own in rows]
        return torch.tensor(chosen, device=scores.device)

    def _apply(self, fn: Callable[[Tensor], Tensor], recurse: bool = True) -> "DpmacroPolicy":
        """Follow `to`, `cpu` and `cuda`: the policy's tensors are no parameters, and keep their types."""
        super()._apply(fn, recurse)
        device = fn(torch.empty(0)).device
        if self.macro_policy is not None and self.macro_policy.device != device:
            self.macro_policy = self.macro_policy.to(device)
            self.reset()
        return self

    @classmethod
    def _load_as_safetensor(
        cls, model: "DpmacroPolicy", model_file: str, map_location: str, strict: bool
    ) -> "DpmacroPolicy":
        """Load the numbers. Raises ValueError naming the file where they do not fit the config."""
        model.macro_policy = MacroPolicy.load_weights(model.config.policy, Path(model_file), map_location)
        model.macro_policy.replayed(model.config.recovery)  # refuses recovery without demonstrators' actions
        model.reset()
        return model

    def _save_pretrained(self, save_directory: Path, state_dict: dict[str, Tensor] | None = None) -> None:
        """Write config.json and model.safetensors; LeRobot's pipelines are saved by themselves."""
        self.config._save_pretrained(save_directory)
        self._loaded.save_weights(save_directory / WEIGHTS_NAME)
