"""Images to feature columns: computed, quantised to 256 levels and sorted, a part of them at a time."""

from collections.abc import Callable

import torch
from jaxtyping import Int64, UInt8
from torch import Tensor

from dpmacro.features import memory
from dpmacro.features.base import Encoder, frames_before
from dpmacro.features.levels import SortedLevels
from dpmacro.features.memory import Plan
from dpmacro.features.quantising import Quantiser

__all__ = ["prepare", "with_mirror_images"]


def prepare(
    images: UInt8[Tensor, "frames height width 3"],
    lengths: Int64[Tensor, " trajectories"],
    features: Encoder,
    plan: Plan,
    generator: torch.Generator,
    on_columns: Callable[[int], None] = lambda _: None,
) -> tuple[Encoder, Quantiser, SortedLevels]:
    """The columns that the plan keeps, their cuts, and the levels of every frame, sorted if the plan says so.

    Columns are computed a part at a time, so that raw values never stand in memory all at once.

    Args:
        images: all frames of all trajectories.
        lengths: frames per trajectory.
        features: the columns to choose from.
        plan: how many are kept, drawn at random where they are not all, and whether they are sorted.
        generator: draws the columns that are kept.
        on_columns: called after each part with the number of columns in it.
    """
    if plan.columns < features.count:
        kept = torch.randperm(features.count, generator=generator)[: plan.columns].sort().values
        features = features.select(kept)
    before = frames_before(lengths.to(images.device))
    n_frames = len(images)
    n_sampled = min(n_frames, memory.SAMPLED)
    sample = torch.linspace(0, n_frames - 1, n_sampled, device=images.device).round().long()
    sampled, sampled_before = (images if len(sample) == n_frames else images[sample]), images[before[sample]]
    levels = torch.empty(features.count, n_frames, dtype=torch.uint8, device=images.device)
    cuts = []
    for numbers in torch.arange(features.count).split(max(memory.VALUES // len(sample), 1)):
        part = features.select(numbers)
        values = part.values(sampled, sampled_before)
        quantiser = Quantiser.fit(values)
        cuts.append(quantiser.cuts)
        rows = slice(int(numbers[0]), int(numbers[-1]) + 1)
        if len(sample) == n_frames:
            levels[rows] = quantiser.levels(values)
        else:
            size = max(memory.VALUES // len(numbers), 1)
            for frames in torch.arange(n_frames, device=images.device).split(size):
                del values  # before the next ones need as much
                values = part.values(images[frames], images[before[frames]])
                levels[rows, frames[0] : frames[-1] + 1] = quantiser.levels(values)
        del values
        on_columns(len(numbers))
    del sampled, sampled_before
    data = SortedLevels.unsorted(levels) if plan.drawn else SortedLevels.build(levels)
    return features, Quantiser(torch.cat(cuts)), data


def with_mirror_images(
    data: SortedLevels,
    images: UInt8[Tensor, "frames height width 3"],
    lengths: Int64[Tensor, " trajectories"],
    features: Encoder,
    quantiser: Quantiser,
) -> SortedLevels:
    """The levels of all frames, then those of their mirror images, left and right exchanged; none sorted."""
    before = frames_before(lengths.to(images.device))
    levels = torch.cat([data.levels, torch.empty_like(data.levels)], 1)
    size = max(memory.VALUES // features.count, 1)
    for frames in torch.arange(len(images), device=images.device).split(size):
        values = features.values(images[frames].flip(2), images[before[frames]].flip(2))
        levels[:, len(images) + frames] = quantiser.levels(values)
    return SortedLevels.unsorted(levels)
