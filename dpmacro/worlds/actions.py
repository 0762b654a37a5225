"""What a policy chooses, as a world takes it."""

from dataclasses import dataclass
from typing import Any

import gymnasium as gym
import numpy as np

from dpmacro.worlds.base import WorldError

__all__ = ["ActionMap"]


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

        Raises WorldError, which says `when`, for a vector of another size or one that is not finite.
        """
        if isinstance(self.space, gym.spaces.Discrete):
            return int(action) + self.start, False
        vector = np.asarray(action)
        if vector.shape != self.space.shape or not np.isfinite(vector).all():
            raise WorldError(
                f"the action {vector.tolist()} {when} is none that the world {self.world} takes: it takes "
                f"{self.space.shape[0]} finite numbers"
            )
        if self.space.dtype.kind in "iu":
            vector = np.rint(vector)
        clipped = np.clip(vector, self.space.low, self.space.high)
        return clipped.astype(self.space.dtype), bool((clipped != vector).any())

    @property
    def recorded_type(self) -> type:
        """The type that keeps actions of many steps."""
        if isinstance(self.space, gym.spaces.Box):
            return np.float32
        return np.uint8 if self.start >= 0 and self.start + self.space.n <= 256 else np.int64
