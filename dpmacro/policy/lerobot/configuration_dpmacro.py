"""DpmacroConfig: what LeRobot knows of a policy of dpmacro."""

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, NoReturn

from lerobot.configs.policies import PreTrainedConfig

from dpmacro.policy.config import PolicyConfig, parsed_config
from dpmacro.policy.files import ACTION, TYPE, features_of

__all__ = ["DpmacroConfig", "refuse_training"]


@PreTrainedConfig.register_subclass(TYPE)
@dataclass
class DpmacroConfig(PreTrainedConfig):
    """The config.json of a policy that train.py saved, as LeRobot reads and writes it.

    Attributes:
        device: where the policy's tensors are. It acts in less than a millisecond on a CPU.
        push_to_hub: LeRobot's option; off, since train.py pushes nothing.
        pretrained_revision: LeRobot's option of version 0.6; declared here since 0.4 refuses files with it.
        recovery: whether a policy that repeats itself takes another action; None for as it was saved.
        planner: what `dpmacro.policy.config.PolicyConfig` holds.
    """

    device: str | None = "cpu"
    push_to_hub: bool = False
    pretrained_revision: str | None = None
    recovery: bool | None = None
    planner: dict[str, Any] = field(default_factory=dict)

    @cached_property
    def policy(self) -> PolicyConfig:
        """What `planner` holds. Raises ValueError where it holds no policy."""
        if not self.planner:
            refuse_training()
        try:
            return parsed_config(self.planner)
        except ValueError as error:
            raise ValueError(
                f"the planner of config.json is none of this version of dpmacro ({error}): train it again"
            ) from error

    @property
    def one_hot(self) -> bool:
        """Whether the action of classes is one number a class, 1 for the one taken; else it is its number."""
        return tuple(self.output_features[ACTION].shape) == (self.policy.outputs,)

    def validate_features(self) -> None:
        """Raise ValueError where the action of the environment is not of the policy's size.

        LeRobot puts that of the environment into `output_features`. Classes may also be told as one number,
        0..M-1.
        """
        own = tuple(features_of(self.policy)[1][ACTION]["shape"])
        found = (self.output_features or {}).get(ACTION)
        if found is None:
            raise ValueError(f"output_features of the policy has no {ACTION!r}: the policy has one of {own}")
        allowed = (own,) if self.policy.vector else (own, (1,))
        if tuple(found.shape) not in allowed:
            raise ValueError(
                f"the environment's action has the shape {tuple(found.shape)}: the policy acts by "
                f"{' or '.join(map(str, allowed))}, give it the environment of its demonstrations"
            )

    @property
    def observation_delta_indices(self) -> None:
        """None: the policy itself remembers what it saw before."""

    @property
    def action_delta_indices(self) -> None:
        """None: it chooses one action at a time."""

    @property
    def reward_delta_indices(self) -> None:
        """None: it knows no rewards."""

    def get_optimizer_preset(self) -> NoReturn:
        """Raise ValueError: LeRobot cannot train it."""
        refuse_training()

    def get_scheduler_preset(self) -> None:
        """None: nothing is scheduled."""


def refuse_training() -> NoReturn:
    """Raise ValueError saying what trains such a policy."""
    raise ValueError(
        "policies of the type dpmacro are not trained by LeRobot: train one by dpmacro's train.py and give "
        "--policy.path=<the run's pretrained_model>"
    )
