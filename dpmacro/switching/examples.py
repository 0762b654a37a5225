"""What switch functions learn from: examples of a change, examples of a start, and the cues of a change."""

from collections.abc import Sequence

import torch
from jaxtyping import Bool, Float, Int64
from torch import Tensor

from dpmacro.segmentation.segments import Segment

__all__ = ["cues_of", "examples", "start_examples"]

COVERED = 0.75  # of the changes, by their cues


def examples(
    pair: tuple[int, int],
    segments: Sequence[Segment],
    left_out: Bool[Tensor, " trajectories"],
    shown: Bool[Tensor, " frames"],
    window: int,
    whole_past: bool,
    lengths: Int64[Tensor, " trajectories"],
) -> tuple[Float[Tensor, " frames"], Bool[Tensor, " frames"]]:
    """Base weights, half a side, and targets of a switch function that never sees what is left out.

    Args:
        pair: (from, to) macro-actions.
        segments: of all trajectories.
        left_out: trajectories without examples.
        shown: frames that may be examples.
        window: J, the positive frames from a change on; fewer where the next segment is shorter.
        whole_past: whether the negatives are all frames of the trajectory before a change of the pair (the
            paper's), instead of those of all segments of the pair's first macro-action, and, weighing as much
            as those together, the first J frames after its changes to others.
        lengths: frames of every trajectory.

    Without those of other changes functions of one macro-action would all fire where it ends, and which fires
    highest would be chance.
    """
    weights, rivals = torch.zeros(2, len(shown))
    targets = torch.zeros(len(shown), dtype=torch.bool)
    firsts = (lengths.cumsum(0) - lengths).tolist()
    for segment in segments:
        changes = (segment.macro, segment.following) == pair
        if segment.macro != pair[0] or left_out[segment.trajectory] or (whole_past and not changes):
            continue
        weights[firsts[segment.trajectory] if whole_past else segment.start : segment.stop] = 1
        after = slice(segment.stop, min(segment.stop + window, segment.following_stop))
        if changes:
            weights[after] = 1
            targets[after] = True
        else:
            rivals[after] = 1
    past, rivals = weights * shown * ~targets, rivals * shown * (weights == 0)
    if past.any() and rivals.any():
        rivals *= past.sum() / rivals.sum()
    return _balanced(weights * shown + rivals, targets), targets


def start_examples(
    start: int,
    segments: Sequence[Segment],
    left_out: Bool[Tensor, " trajectories"],
    n_frames: int,
    window: int,
) -> tuple[Float[Tensor, " frames"], Bool[Tensor, " frames"]]:
    """Likewise for a start: the first frames, `window` at most, of trajectories that begin so and others."""
    weights = torch.zeros(n_frames)
    targets = torch.zeros(n_frames, dtype=torch.bool)
    seen = -1
    for segment in segments:
        if segment.trajectory == seen:
            continue
        seen = segment.trajectory
        if not left_out[segment.trajectory]:
            first = slice(segment.start, min(segment.start + window, segment.stop))
            weights[first] = 1
            targets[first] = segment.macro == start
    return _balanced(weights, targets), targets


def _balanced(
    weights: Float[Tensor, " frames"], targets: Bool[Tensor, " frames"]
) -> Float[Tensor, " frames"]:
    """Weights of which positives and negatives have half each."""
    weights = weights.clone()
    for side in (targets, ~targets):
        weights[side] /= (2 * weights[side].sum()).clamp(min=1)
    return weights


def cues_of(
    pair: tuple[int, int], segments: Sequence[Segment], actions: Int64[Tensor, " frames"]
) -> tuple[int, ...]:
    """The actions that come right before most changes of a pair, the fewest that cover `COVERED` of them.

    Not all: a segmentation that is a frame or two late has the action after the change there. Every action,
    where the segments show no such change.
    """
    before = [one.stop - 1 for one in segments if (one.macro, one.following) == pair]
    actions = actions.cpu()
    if not before:
        return tuple(actions.unique().tolist())
    counts = actions[before].bincount()
    order = counts.argsort(descending=True, stable=True)
    enough = int((counts[order].cumsum(0) < COVERED * len(before)).sum()) + 1
    return tuple(sorted(order[:enough].tolist()))
