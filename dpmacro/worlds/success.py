"""What tells whether a run has succeeded: the world's info, or its rewards."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from dpmacro.worlds.base import WorldError

__all__ = ["SuccessRule"]

KEYS = ("is_success", "success")  # of an info, the first that there is


@dataclass(frozen=True)
class SuccessRule:
    """Which of a world's signs counts.

    A run has succeeded where the info of its last step says so under `is_success` or `success`. Where the
    info has neither, rewards tell: their sum has to reach `threshold`, or, without one, the step on which
    the world ends the run has to earn more than 0.

    Attributes:
        world: its id, for messages.
        given: a key of the info, or a sum of rewards, that counts instead; None for the rule above.
        threshold: the sum of rewards at which gymnasium takes the world for solved; None where it names none.
    """

    world: str
    given: str | int | float | None = None
    threshold: float | None = None

    def shown(self, info: Mapping[str, Any]) -> bool:
        """Whether an info says that the world is in a successful state now; false where rewards tell."""
        key = self._key(info)
        return key is not None and key in info and self._true(key, info[key])

    def judge(
        self, info: Mapping[str, Any], last_reward: float, total: float, terminated: bool
    ) -> tuple[bool, str]:
        """Whether a run has succeeded, and what told so, in words.

        Args:
            info: of its last step.
            last_reward: of that step.
            total: sum of all rewards.
            terminated: whether the world itself ended the run.

        Raises WorldError where the info lacks the given key.
        """
        key = self._key(info)
        if key is not None:
            if key not in info:
                raise WorldError(
                    f"the info of the world {self.world} has no {key!r} to tell success: it has "
                    f"{', '.join(map(str, info)) or 'nothing'}; correct --world.success"
                )
            return self._true(key, info[key]), f'info["{key}"]'
        least = self.threshold if self.given is None else float(self.given)
        if least is not None:
            return total >= least, f"rewards of {least:g} or more in sum"
        return terminated and last_reward > 0, "a reward above 0 on the step that ends the run"

    def _key(self, info: Mapping[str, Any]) -> str | None:
        if self.given is not None:
            return self.given if isinstance(self.given, str) else None
        return next((key for key in KEYS if key in info), None)

    def _true(self, key: str, value: Any) -> bool:
        try:
            flags = np.asarray(value)
        except (ValueError, TypeError, RuntimeError):  # lists of other lengths, tensors on a GPU
            flags = np.empty(0)
        if flags.size != 1 or flags.dtype.kind not in "biuf" or np.isnan(flags).any():
            raise WorldError(
                f"the info of the world {self.world} has {value!r} as {key!r}: name what is true or false by "
                "--world.success="
            )
        return bool(flags.reshape(-1)[0])
