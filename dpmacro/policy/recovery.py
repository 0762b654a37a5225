"""What a planner in trouble does: its least certain decision the other way, then on like a demonstrator.

A planner that sees exactly what it saw before in the same macro-action will, where its world is as
predictable as it is, do what it did before, and so on for ever. Of the decisions on that circle the one
nearest to a tie is doubted most: in a turn without end, the one that faces a flag too far away to be
recognised. There it takes the action that came second, and replays what a demonstrator did from the first
such action of a random segment on: for as many frames as the circle has, after the next circle for twice as
many, and so on, the segment's end at most. Where it dithers a nudge is enough, a flag far away takes a walk.
Its switch functions stay on watch.
"""

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Int64, UInt8
from torch import Tensor

from dpmacro.switching.functions import macro_segments

__all__ = ["ACTIONS", "Recovery", "Stretches"]

ACTIONS = 256  # that a byte tells apart


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
        """The segments of constant macro-label, in order. ValueError for more than `ACTIONS` actions."""
        if int(actions.max()) >= ACTIONS:
            raise ValueError(
                f"an action is {int(actions.max())}: a policy holds {ACTIONS} at most, from 0 on"
            )
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
        # Digest of a sight -> the lead of the decision made there; the latest sight comes last.
        self._leads: dict[bytes, float] = {}
        self._stretch: list[int] = []  # actions still to replay, the next one last
        self.reset()

    def reset(self) -> None:
        """Begin an episode; its draws are the same in every one."""
        self._generator = np.random.default_rng(0)
        self._enter(-1)

    @property
    def replaying(self) -> bool:
        """Whether the last action was not the planner's."""
        return self._replaying

    def act(self, seen: bytes, macro: int, scores: Float[np.ndarray, " actions"]) -> int:
        """The action to take.

        Args:
            seen: all that the planner's decision depends on beside its macro-action.
            macro: its macro-action, 0..Q-1.
            scores: of every action, of which it would take the highest, the first of several.
        """
        if macro != self._macro:
            self._enter(macro)
        if not self._stretch and len(scores) > 1:
            self._watch(hashlib.blake2b(seen, digest_size=16).digest(), scores)
        self._replaying = bool(self._stretch)
        return self._stretch.pop() if self._stretch else int(scores.argmax())

    def _enter(self, macro: int) -> None:
        self._macro, self._replaying = macro, False
        self._stretches = 0  # replayed in this macro-action
        self._stretch.clear()
        self._forget()

    def _forget(self) -> None:
        self._leads.clear()
        self._start = self._doubted = b""  # sights: where the circle was found, and its most doubted one

    def _watch(self, sight: bytes, scores: Float[np.ndarray, " actions"]) -> None:
        """Take note of a decision; begin a stretch if it is the most doubted one of a circle."""
        first, second = np.argsort(-scores, kind="stable")[:2].tolist()
        if sight not in self._leads:
            self._doubted = b""
        elif not self._doubted or sight == self._start:
            circle = list(self._leads)[list(self._leads).index(sight) :]
            self._start, self._doubted = sight, min(circle, key=self._leads.__getitem__)
            self._room = len(circle) << self._stretches
        self._leads.pop(sight, None)
        self._leads[sight] = float(scores[first] - scores[second])
        if sight == self._doubted:
            self._stretch = self._draw(second)
            self._stretches += 1
            self._forget()

    def _draw(self, action: int) -> list[int]:
        """A segment of the macro-action from that action on, `_room` frames at most; the next one last."""
        segments = [own for own in self._segments[self._macro] if (own == action).any()]
        if not segments:
            return [action]
        segment = segments[self._generator.integers(len(segments))]
        first = int((segment == action).argmax())
        return segment[first : first + self._room][::-1].tolist()
