"""What a policy chooses, as a world takes it."""

from dataclasses import dataclass
from typing import Any

import gymnasium as gym
import numpy as np

from dpmacro.worlds.base import WorldError

__all__ = ["ActionMap"]

NUMBERS = "biuf"  # kinds of numpy's types
SHOWN = 80  # letters of an action in a message


@dataclass(frozen=True)
class ActionMap:
    """How actions are handed to a world: classes as they are, vectors clipped into what it takes.

    Attributes:
        world: its id, for messages.
        space: of its actions, Discrete, or a Box of vectors.
        start: number of the world's first class, added to a policy's, which count from 0.
    """

    world: str
    space: gym.spaces.Discrete | gym.spaces.Box
    start: int = 0

    @classmethod
    def fit(
        cls, world: str, space: gym.Space, classes: int | None = None, dims: int | None = None
    ) -> "ActionMap":
        """The map for a world.

        Args:
            world: its id.
            space: of its actions.
            classes: number of actions that a policy chooses from; None where it gives vectors.
            dims: size of a policy's vectors; None where it gives classes. Both are None for an expert, which
                knows the world's own actions.

        Raises WorldError where the world takes neither classes nor vectors, or others than the policy gives.
        """
        vectors = isinstance(space, gym.spaces.Box) and len(space.shape) == 1
        if not vectors and not isinstance(space, gym.spaces.Discrete):
            raise WorldError(
                f"the world {world} takes actions of {space}, and policies give one of several actions "
                "(Discrete) or a vector (a Box of one dimension): wrap the world"
            )
        takes = f"vectors of {space.shape[0]} numbers" if vectors else f"one of {space.n} actions"
        gives = f"one of {classes} actions" if dims is None else f"vectors of {dims} numbers"
        if vectors:
            fits = classes is None and dims in (None, space.shape[0])
        else:
            fits = dims is None and (classes is None or classes <= space.n)
        if not fits:
            raise WorldError(
                f"the world {world} takes {takes}, and the policy gives {gives}: choose the world that its "
                "demonstrations are from, or one like it"
            )
        start = int(space.start) if classes is not None and not vectors else 0
        return cls(world, space, start)

    def of(self, action: Any, when: str) -> tuple[Any, bool]:
        """The action as the world takes it, and whether a vector had to be clipped.

        Raises WorldError, which says `when`, for a class that there is not, and for a vector of another size
        or one that is not finite.
        """
        try:
            vector = np.asarray(action)
        except (ValueError, TypeError, RuntimeError):  # an expert's lists of other lengths, GPUs' tensors
            vector = np.asarray(None)
        sound = vector.dtype.kind in NUMBERS and bool(np.isfinite(vector).all())
        if isinstance(self.space, gym.spaces.Discrete):
            low, n = int(self.space.start), int(self.space.n)
            number = vector.item() + self.start if sound and vector.size == 1 else None
            if number is None or number != int(number) or not low <= number < low + n:
                raise self._refused(action, f"one of {low} to {low + n - 1}", when)
            return int(number), False
        if not sound or vector.shape != self.space.shape:
            raise self._refused(action, f"{self.space.shape[0]} finite numbers", when)
        if self.space.dtype.kind in "iu":
            vector = np.rint(vector)
        clipped = np.clip(vector, self.space.low, self.space.high)
        return clipped.astype(self.space.dtype), bool((clipped != vector).any())

    def _refused(self, action: Any, takes: str, when: str) -> WorldError:
        shown = " ".join(str(action.tolist() if isinstance(action, np.ndarray) else repr(action)).split())
        shown = shown if len(shown) <= SHOWN else f"{shown[:SHOWN]}..."
        return WorldError(
            f"the action {shown} {when} is none that the world {self.world} takes: it takes {takes}"
        )

    @property
    def recorded_type(self) -> type:
        """The type that keeps actions of many steps."""
        if isinstance(self.space, gym.spaces.Box):
            return np.float32
        return np.uint8 if self.start >= 0 and self.start + self.space.n <= 256 else np.int64
