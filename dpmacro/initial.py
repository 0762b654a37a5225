"""Initial segmentations for DPBoost's restarts."""

import torch
from jaxtyping import Int64, UInt8
from torch import Tensor

__all__ = ["feature_peaks", "random_cuts"]


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
    levels: UInt8[Tensor, "columns frames"],
    lengths: Int64[Tensor, " trajectories"],
    restarts: int,
    macros: int,
    max_transitions: int,
    generator: torch.Generator,
) -> Int64[Tensor, "restarts frames"]:
    """Cuts where S random features are extreme: change points that can be recognised when they come.

    A switch function sees images and nothing else, so a segmentation that can be run changes where something
    is seen. Every restart draws S columns, each with a sign, and cuts every trajectory where each has its
    first maximum after its first frame; macro-actions come in turn from the first.
    """
    shape = (restarts, max_transitions)
    columns = torch.randint(len(levels), shape, generator=generator)
    falling = torch.randint(2, shape, generator=generator, dtype=torch.bool)
    parts = []
    drawn = levels[columns.to(levels.device)].cpu()  # [restarts, S, frames]
    for part in drawn.split(lengths.tolist(), 2):
        later = part[:, :, 1:] if part.shape[2] > 1 else part
        peaks = 1 + torch.where(falling, later.argmin(2), later.argmax(2))
        parts.append((torch.arange(part.shape[2]) >= peaks[:, :, None]).sum(1) % macros)
    return torch.cat(parts, 1)
