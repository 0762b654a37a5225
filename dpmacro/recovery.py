"""What a planner in trouble does: as a demonstrator did once, for a stretch, whatever it sees.

A planner that sees exactly what it saw before in the same macro-action will do what it did before, and so on
for ever. It replays the actions of a random stretch of that macro-action in the demonstrations, from a random
frame to the end of the segment, and so looks at the world from elsewhere. Its switch functions stay on watch.
"""

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Int64, UInt8
from torch import Tensor

from dpmacro.switching import macro_segments

__all__ = ["Recovery", "Stretches"]


@dataclass(frozen=True)
class Stretches:
    """The actions of every segment of the demonstrations, concatenated.

    Attributes:
        actions: 0..M-1 of every frame.
        lengths: frames of every segment.
        macros: macro-action of every segment, 0..Q-1.
    """

    actions: UInt8[Tensor, " frames"]
    lengths: Int64[Tensor, " segments"]
    macros: Int64[Tensor, " segments"]

    @classmethod
    def of(
        cls,
        labels: Int64[Tensor, " frames"],
        actions: Int64[Tensor, " frames"],
        lengths: Int64[Tensor, " trajectories"],
    ) -> "Stretches":
        """The segments of constant macro-label, in order. Raises ValueError for more than 256 actions."""
        if int(actions.max()) > 255:
            raise ValueError(f"an action is {int(actions.max())}: a policy keeps at most 256 actions, 0..255")
        segments = macro_segments(labels, lengths)
        return cls(
            actions.to(torch.uint8).cpu(),
            torch.tensor([segment.stop - segment.start for segment in segments]),
            torch.tensor([segment.macro for segment in segments]),
        )

    @classmethod
    def from_tensors(cls, tensors: Mapping[str, Tensor]) -> "Stretches":
        """What `tensors` gave; raises ValueError where the parts do not fit one another."""
        found = cls(tensors["actions"].cpu(), tensors["lengths"].cpu(), tensors["macros"].cpu())
        if int(found.lengths.sum()) != len(found.actions) or len(found.lengths) != len(found.macros):
            raise ValueError(
                f"{len(found.lengths)} segments of {int(found.lengths.sum())} frames in all for "
                f"{len(found.macros)} macro-actions and {len(found.actions)} actions"
            )
        return found

    def tensors(self) -> dict[str, Tensor]:
        """What defines them, for a file."""
        return {"actions": self.actions, "lengths": self.lengths, "macros": self.macros}

    def of_macro(self, macro: int) -> list[UInt8[np.ndarray, " _"]]:
        """The segments of one macro-action."""
        parts = self.actions.split(self.lengths.tolist())
        return [part.numpy() for part, own in zip(parts, self.macros.tolist(), strict=True) if own == macro]


class Recovery:
    """One running environment's watch over its planner."""

    def __init__(self, stretches: Stretches, macros: int) -> None:
        self._segments = [stretches.of_macro(macro) for macro in range(macros)]
        self._seen: set[bytes] = set()  # digests of what was seen in the macro-action
        self._stretch: list[int] = []  # actions still to replay, the next one last
        self.reset()

    def reset(self) -> None:
        """Begin an episode; its draws are the same in every one."""
        self._generator = np.random.default_rng(0)
        self._enter(-1)

    @property
    def replaying(self) -> bool:
        """Whether the last action was a demonstrator's."""
        return self._replaying

    def act(self, seen: bytes, macro: int, action: int) -> int:
        """The action to take.

        Args:
            seen: all that the planner's decision depends on beside its macro-action.
            macro: its macro-action, 0..Q-1.
            action: what it would do.
        """
        if macro != self._macro:
            self._enter(macro)
        if not self._stretch:
            digest = hashlib.blake2b(seen, digest_size=16).digest()
            if digest in self._seen and self._segments[macro]:
                self._stretch = self._draw(self._segments[macro])
            self._seen.add(digest)
        self._replaying = bool(self._stretch)
        return self._stretch.pop() if self._stretch else action

    def _enter(self, macro: int) -> None:
        self._macro, self._replaying = macro, False
        self._seen.clear()
        self._stretch.clear()

    def _draw(self, segments: list[UInt8[np.ndarray, " _"]]) -> list[int]:
        """A segment, the longer the likelier, from a frame on; the next action last."""
        frames = np.array([len(segment) for segment in segments])
        segment = segments[self._generator.choice(len(segments), p=frames / frames.sum())]
        return segment[self._generator.integers(len(segment)) :][::-1].tolist()
