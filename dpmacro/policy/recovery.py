"""Recovery: a planner that repeats itself takes another action, and then follows a demonstration.

What is detected: a planner sees frames that it saw before under the same macro-action. It takes the same
action again, and where the world is as deterministic as the planner is, the steps in between form a loop. The
run stays in it until its time is up.

What is done: of the decisions on the loop, the closest is the one whose best action leads the second best by
the least. When the run comes to that decision again, the second best action is taken. What follows it in a
demonstration is replayed: in a random one of the demonstrations' segments of the same macro-action, from the
segment's first such action on. The first replay under a macro-action takes at most as many steps as the loop
has, the next one twice as many as its loop has, then four times as many, and so on, but never more than are
left in the segment. Then the planner decides again.

Why: the closest decision is where the policy is least certain, for instance where it faces a flag that is too
far away to be recognised. One other action breaks a loop of two steps. A flag far away has to be walked up to
before it is recognised, and the loop round it is long.

Limits: noise in the frames hides a repetition. A replay does not look at the frames, but for the switch
functions, and a change of macro-action ends it. Where no demonstration took the second best action under the
macro-action, that action alone is taken. Since replays are drawn at random, a run with recovery never proves
to be a loop, and takes all the time that the world gives.
"""

import hashlib
from collections.abc import Hashable, Mapping
from dataclasses import dataclass
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from jaxtyping import Float, Int64, UInt8
from torch import Tensor

from dpmacro.features.stored import check_range, check_tensor
from dpmacro.policy.planner import MacroPlanner
from dpmacro.segmentation.segments import macro_segments

__all__ = ["MAX_ACTIONS", "LoopBreaker", "RecoveringPlanner", "Stretches"]

MAX_ACTIONS = 256  # a byte holds an action


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
        """The segments of constant macro-label, in order. ValueError for more than `MAX_ACTIONS` actions."""
        if int(actions.max()) >= MAX_ACTIONS:
            raise ValueError(
                f"an action is {int(actions.max())}: a policy holds {MAX_ACTIONS} at most, from 0 on"
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
        if tensors.keys() != {"actions", "lengths", "macros"}:
            raise ValueError(f"stretches have {', '.join(tensors)}: give actions, lengths and macros")
        found = cls(tensors["actions"].cpu(), tensors["lengths"].cpu(), tensors["macros"].cpu())
        check_tensor("actions of stretches", found.actions, (torch.uint8,), None)
        check_tensor("lengths of stretches", found.lengths, (torch.int64,), None)
        check_tensor("macros of stretches", found.macros, (torch.int64,), None)
        check_range("lengths of stretches", found.lengths, 1, len(found.actions))
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
        """The actions of every segment of one macro-action, in order; none for one that has no segment."""
        parts = self.actions.split(self.lengths.tolist())
        return [part.numpy() for part, own in zip(parts, self.macros.tolist(), strict=True) if own == macro]


class RecoveringPlanner:
    """A planner that gets out of loops, as `dpmacro.worlds.base.Planner`.

    Args:
        planner: what decides while there is no loop.
        stretches: what demonstrators did under every macro-action.
        seed: of the random draws, which are the same in every episode.
    """

    memory: Hashable = None  # of `worlds.base.Planner`: draws are random, so no run is known to repeat itself

    def __init__(self, planner: MacroPlanner, stretches: Stretches, seed: int) -> None:
        self.planner = planner
        self._breaker = LoopBreaker(stretches, seed)

    @property
    def macro(self) -> int:
        """The current macro-action, 0..Q-1."""
        return self.planner.macro

    def reset(self, env: gym.Env | None = None) -> None:
        """Begin an episode, in any environment."""
        self.planner.reset(env)
        self._breaker.reset()

    def act(self, observation: dict[str, np.ndarray], info: dict[str, Any]) -> int:
        """Return the action for the present frame. Raises ValueError for a frame of another size."""
        scores = self.planner.scores(observation)
        action = self._breaker.act(self.planner.seen, self.planner.macro, scores)
        self.planner.took(action)
        return action


class LoopBreaker:
    """The decisions of one episode since the macro-action last changed, and what breaks a loop of them.

    Args:
        stretches: what demonstrators did under every macro-action.
        seed: of the random draws, which are the same in every episode.
    """

    def __init__(self, stretches: Stretches, seed: int) -> None:
        self._segments = {macro: stretches.of_macro(macro) for macro in set(stretches.macros.tolist())}
        self._seed = seed
        # From a digest of frames to the lead of the best action there, the latest decision last.
        self._leads: dict[bytes, float] = {}
        self._replay: list[int] = []  # actions still to take, the next one last
        self.reset()

    def reset(self) -> None:
        """Begin an episode."""
        self._generator = np.random.default_rng(self._seed)
        self._enter(-1)

    @property
    def replaying(self) -> bool:
        """Whether the last action was another than the planner's own."""
        return self._replaying

    def act(self, seen: bytes, macro: int, scores: Float[np.ndarray, " actions"]) -> int:
        """Return the action to take.

        Args:
            seen: the frames that the scores were computed from; equal bytes are equal frames.
            macro: the planner's macro-action, 0..Q-1.
            scores: of every action; of equal ones the first is the best.
        """
        if macro != self._macro:
            self._enter(macro)
        if not self._replay and len(scores) > 1:
            self._watch(hashlib.blake2b(seen, digest_size=16).digest(), scores)
        self._replaying = bool(self._replay)
        return self._replay.pop() if self._replay else int(scores.argmax())

    def _enter(self, macro: int) -> None:
        self._macro, self._replaying = macro, False
        self._replays = 0  # under this macro-action
        self._replay.clear()
        self._forget()

    def _forget(self) -> None:
        self._leads.clear()
        self._start = self._closest = b""  # digests: where the loop was noticed, and its closest decision

    def _watch(self, digest: bytes, scores: Float[np.ndarray, " actions"]) -> None:
        """Note a decision; begin a replay if it is the closest one of a loop."""
        first, second = np.argsort(-scores, kind="stable")[:2].tolist()
        if digest not in self._leads:
            self._closest = b""  # a new frame: the loop, if there was one, has been left
        elif not self._closest or digest == self._start:
            loop = list(self._leads)[list(self._leads).index(digest) :]
            self._start, self._closest = digest, min(loop, key=self._leads.__getitem__)
            self._limit = len(loop) << self._replays
        self._leads.pop(digest, None)
        self._leads[digest] = float(scores[first] - scores[second])
        if digest == self._closest:
            self._replay = self._draw(second)
            self._replays += 1
            self._forget()

    def _draw(self, action: int) -> list[int]:
        """Return that action and what follows in a random segment, at most `_limit` long, the next last."""
        segments = [own for own in self._segments.get(self._macro, []) if (own == action).any()]
        if not segments:
            return [action]
        segment = segments[self._generator.integers(len(segments))]
        first = int((segment == action).argmax())
        return segment[first : first + self._limit][::-1].tolist()
