"""What a fit leaves out: folds of trajectories, or of stretches where trajectories are few."""

import torch
from jaxtyping import Int64
from torch import Tensor

__all__ = ["folds_of", "frame_folds"]

STRETCHES = 3  # so many per fold and trajectory


def frame_folds(
    lengths: Int64[Tensor, " trajectories"],
    folds: int,
    generator: torch.Generator,
    groups: Int64[Tensor, " trajectories"] | None = None,
) -> Int64[Tensor, " frames"]:
    """A fold for every frame: that of its trajectory, as `folds_of` deals them.

    Where there are fewer groups of trajectories than folds, every trajectory is cut into `STRETCHES` times as
    many stretches as there are folds, and those are dealt; a trajectory and its mirror image are cut alike.
    """
    lengths = lengths.cpu()
    groups = torch.arange(len(lengths)) if groups is None else groups.cpu()
    if len(groups.unique()) >= folds:
        return folds_of(len(lengths), folds, generator, groups).repeat_interleave(lengths)
    n_stretches = STRETCHES * folds
    stretches = [
        number * n_stretches + torch.arange(length) * n_stretches // length
        for number, length in zip(groups.tolist(), lengths.tolist(), strict=True)
    ]
    stretch_of = torch.cat(stretches).unique(return_inverse=True)[1]
    return folds_of(int(stretch_of.max()) + 1, folds, generator)[stretch_of]


def folds_of(
    n_trajectories: int,
    folds: int,
    generator: torch.Generator,
    groups: Int64[Tensor, " trajectories"] | None = None,
) -> Int64[Tensor, " trajectories"]:
    """A fold for every trajectory, at random, as even as can be; trajectories of a group share theirs."""
    groups = torch.arange(n_trajectories) if groups is None else groups.cpu().unique(return_inverse=True)[1]
    n_groups = int(groups.max()) + 1
    order = torch.randperm(n_groups, generator=generator)
    fold_of = torch.empty(n_groups, dtype=torch.int64)
    fold_of[order] = torch.arange(n_groups) % max(1, min(folds, n_groups))
    return fold_of[groups]
