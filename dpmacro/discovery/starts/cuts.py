"""Segmentations cut at random, at equal distances, or where features are extreme."""

import torch
from jaxtyping import Bool, Int64, Num
from torch import Tensor

from dpmacro.features.levels import SortedLevels

__all__ = ["feature_peaks", "random_cuts", "uniform_cuts"]

USUAL = 2.0  # mean changes of vectors; a change is larger


def random_cuts(
    lengths: Int64[Tensor, " trajectories"],
    restarts: int,
    macros: int,
    max_transitions: int,
    generator: torch.Generator,
) -> Int64[Tensor, "restarts frames"]:
    """S uniform random cuts in every trajectory, macro-actions in turn from the first."""
    parts = []
    for length in lengths.tolist():
        cuts = torch.rand(restarts, max_transitions, 1, generator=generator) * length
        parts.append((torch.arange(length) >= cuts).sum(1) % macros)
    return torch.cat(parts, 1)


def feature_peaks(
    data: SortedLevels,
    lengths: Int64[Tensor, " trajectories"],
    restarts: int,
    macros: int,
    max_transitions: int,
    generator: torch.Generator,
    actions: Num[Tensor, "frames *dims"] | None = None,
) -> Int64[Tensor, "restarts frames"]:
    """Cuts where S random features are extreme: change points that can be recognised when they come.

    A switch function sees images and nothing else, so a segmentation that can be run changes where something
    is seen. Every restart draws S columns, each with a sign, and cuts every trajectory where each has its
    first maximum after its first frame; macro-actions come in turn from the first.

    Given `actions`, cuts are made only where another action is taken than in the frame before, in
    trajectories that have such frames: where the macro-action changes, the action mostly changes too. Of
    vectors another action is one further away than is usual, by the changes of all frames.
    """
    shape = (restarts, max_transitions)
    columns = torch.randint(data.n_columns, shape, generator=generator)
    falling = torch.randint(2, shape, generator=generator, dtype=torch.bool)
    drawn = data.rows(columns.flatten()).unflatten(0, shape).cpu().short()  # [restarts, S, frames]
    heights = torch.where(falling[:, :, None], -drawn, drawn)
    allowed = torch.ones(drawn.shape[2], dtype=torch.bool)
    if actions is not None:
        allowed[1:] = _changed(actions.cpu())
    allowed[lengths.cumsum(0) - lengths] = False
    parts = []
    for part, own in zip(heights.split(lengths.tolist(), 2), allowed.split(lengths.tolist()), strict=True):
        places = own.nonzero()[:, 0] if own.any() else torch.arange(1, max(len(own), 2))
        peaks = places[part[:, :, places.clamp(max=len(own) - 1)].argmax(2)]
        parts.append((torch.arange(len(own)) >= peaks[:, :, None]).sum(1) % macros)
    return torch.cat(parts, 1)


def _changed(actions: Num[Tensor, "frames *dims"]) -> Bool[Tensor, " changes"]:
    """Whether every frame but the first takes another action than the one before."""
    if actions.ndim == 1:
        return actions[1:] != actions[:-1]
    change = (actions[1:] - actions[:-1]).norm(dim=1)
    return change > USUAL * change.mean() if len(change) else change > 0


def uniform_cuts(
    lengths: Int64[Tensor, " trajectories"], macros: int, max_transitions: int
) -> Int64[Tensor, "1 frames"]:
    """S cuts at equal distances in every trajectory, macro-actions in turn from the first."""
    parts = [torch.arange(length) * (max_transitions + 1) // length % macros for length in lengths.tolist()]
    return torch.cat(parts)[None]
