"""What a segmentation asks switch functions for: examples for every change and every fold of trajectories."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int64
from torch import Tensor

from dpmacro.segmentation.segments import Segment, macro_segments, starting_macros
from dpmacro.switching.examples import cues_of, examples, start_examples
from dpmacro.switching.functions import cued
from dpmacro.switching.settings import SwitchSettings

__all__ = ["Ends", "Fold", "Wanted"]


@dataclass(frozen=True)
class Fold:
    """What one fit of the switch functions leaves out, and what the rest says."""

    left_out: Bool[Tensor, " trajectories"]
    cues: tuple[tuple[int, ...], ...]  # of every pair; none stands for any
    asked: Bool[Tensor, "frames switches"]  # where the cues allow a change


@dataclass(frozen=True)
class Ends:
    """The segments of the macro-action that a change leaves, parted by how they end."""

    changes: Sequence[Segment]
    others: Sequence[Segment]

    @classmethod
    def of(cls, pair: tuple[int, int], segments: Sequence[Segment]) -> "Ends":
        left = [one for one in segments if one.macro == pair[0]]
        return cls(
            [one for one in left if one.following == pair[1]],
            [one for one in left if one.following != pair[1]],
        )

    def without(self, left_out: Bool[Tensor, " trajectories"]) -> tuple[list[Segment], list[Segment]]:
        """Both, but for those of trajectories that are left out."""
        kept = (~left_out).tolist()
        changes, others = (
            [one for one in own if kept[one.trajectory]] for own in (self.changes, self.others)
        )
        return changes, others


@dataclass(frozen=True)
class Wanted:
    """What a segmentation asks switch functions for: problems, `len(folds)` for every switch and start."""

    pairs: tuple[tuple[int, int], ...]
    starts: tuple[int, ...]  # macro-actions that trajectories begin with
    begun: Int64[Tensor, " trajectories"]
    ends: list[Ends]  # of every pair
    folds: list[Fold]
    weights: list[Float[Tensor, " frames"]]  # of every problem
    targets: list[Bool[Tensor, " frames"]]

    @property
    def asking(self) -> tuple[int, ...]:
        """The starts that need a function each to be told apart."""
        return self.starts if len(self.starts) > 1 else ()

    @property
    def switches(self) -> int:
        """How many functions there are: of changes, and of starts."""
        return len(self.pairs) + len(self.asking)

    @classmethod
    def of(
        cls,
        labels: Int64[Tensor, " frames"],
        lengths: Int64[Tensor, " trajectories"],
        fold_of: Int64[Tensor, " trajectories"],
        numbers: Sequence[int],
        settings: SwitchSettings,
        actions: Int64[Tensor, " frames"] | None,
    ) -> "Wanted":
        """Of labels, with the folds `numbers`."""
        n_frames = len(labels)
        segments = macro_segments(labels, lengths)
        pairs = tuple(sorted({(one.macro, one.following) for one in segments if one.following is not None}))
        begun = starting_macros(labels, lengths)
        starts = tuple(begun.unique().tolist())
        folds = [_fold(fold_of == fold, pairs, segments, lengths, actions) for fold in numbers]
        how = settings.window, settings.whole_past
        everywhere = torch.ones(n_frames, dtype=torch.bool)
        found = [
            examples(pair, segments, fold.left_out, shown, *how, lengths)
            for place, pair in enumerate(pairs)
            for fold in folds
            for shown in [fold.asked[:, place] if settings.focused else everywhere]
        ]
        found += [
            start_examples(start, segments, fold.left_out, n_frames, settings.window)
            for start in (starts if len(starts) > 1 else ())
            for fold in folds
        ]
        weights, targets = [one for one, _ in found], [one for _, one in found]
        return cls(pairs, starts, begun, [Ends.of(pair, segments) for pair in pairs], folds, weights, targets)


def _fold(
    left_out: Bool[Tensor, " trajectories"],
    pairs: Sequence[tuple[int, int]],
    segments: Sequence[Segment],
    lengths: Int64[Tensor, " trajectories"],
    actions: Int64[Tensor, " frames"] | None,
) -> Fold:
    """A fold with the cues that the trajectories outside it give."""
    if actions is None or not pairs:
        return Fold(left_out, (), torch.ones(int(lengths.sum()), len(pairs), dtype=torch.bool))
    inside = [one for one in segments if not left_out[one.trajectory]]
    cues = tuple(cues_of(pair, inside, actions) for pair in pairs)
    return Fold(left_out, cues, cued(actions, lengths, cues))
