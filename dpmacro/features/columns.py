"""Images to sorted feature columns, in a form that fits into the memory there is.

A level takes a byte a column and frame, its place in the sorted order four more. Where sorted columns do not
fit, levels alone are held and boosting sorts as many random columns as fit, drawn anew every few rounds;
where the levels of all columns do not fit either, random columns of the feature set are left out. Switch
functions take more where they learn from mirror images: the levels once more, and those of the mirror images.
"""

from collections.abc import Callable
from dataclasses import dataclass

import torch
from jaxtyping import Int64, UInt8
from torch import Tensor

from dpmacro.data.images import GIB
from dpmacro.features.base import FeatureSet, frames_before
from dpmacro.features.levels import SortedLevels
from dpmacro.features.quantising import Quantiser

__all__ = ["Demand", "Plan", "prepare", "with_mirror_images"]

LIBRARIES = 0.65 * GIB  # what a process holds before it has seen a frame
VALUES = 2**26  # integers that are quantised at a time
SAMPLED = 20_000  # frames that choose the cuts, evenly spaced, where there are more
SORTED = 4  # bytes of a frame's place in a column's order
DRAWN = SORTED + 1  # likewise where columns are sorted when drawn, from a copy of their levels
LEAST_COLUMNS = 512  # as many as judging a segmentation searches


@dataclass(frozen=True)
class Demand:
    """What training asks of memory.

    Attributes:
        n_frames: of all demonstrations.
        image_bytes: of one frame.
        n_columns: of the feature set.
        table_bytes: scores, losses and weights of one frame while boosting.
        copies: of every frame's columns, like mirror images, that switch functions learn from as well.
        switch_bytes: of one frame while they learn, boosting being over: scores, losses, weights, sorted
            columns and copied images, those of the copies included.
    """

    n_frames: int
    image_bytes: int
    n_columns: int
    table_bytes: int
    copies: int = 0
    switch_bytes: int = 0


@dataclass(frozen=True)
class Plan:
    """How the feature columns are held.

    Attributes:
        columns: how many of the feature set are kept.
        of: how many the feature set has.
        drawn: how many of them a boosting round searches at most; 0 for all, held sorted.
        gibibytes: estimate of the most memory that training takes.
    """

    columns: int
    of: int
    drawn: int
    gibibytes: float

    @classmethod
    def fitting(cls, demand: Demand, limit: float) -> "Plan":
        """The richest plan within `limit` GiB: first all columns sorted, then all columns, then most of them.

        Raises ValueError with the least limit where there is no room for `LEAST_COLUMNS` columns.
        """
        n_frames, n_columns = demand.n_frames, demand.n_columns
        fixed = LIBRARIES + n_frames * demand.image_bytes
        sampled = 2 * min(n_frames, SAMPLED) * demand.image_bytes
        quantising = sampled + 4 * min(VALUES, n_columns * n_frames)
        boosting = n_frames * demand.table_bytes
        switching = n_frames * demand.switch_bytes
        copied = 1 + demand.copies if demand.copies else 0  # the frames' own levels are copied, too

        def most(columns: int, drawn: int) -> float:
            """Of the plan; all columns are sorted where `drawn` is 0."""
            order = 0 if drawn else SORTED * columns
            then = boosting + DRAWN * drawn * n_frames, switching + copied * columns * n_frames
            return (fixed + columns * n_frames + max(quantising, order * n_frames + max(then))) / GIB

        if (whole := most(n_columns, 0)) <= limit:
            return cls(n_columns, n_columns, 0, whole)
        least = min(LEAST_COLUMNS, n_columns)
        if most(least, least) > limit:
            raise ValueError(
                f"memory_limit is {limit:g} GiB: {n_frames} frames need {most(least, least):.2f} GiB at "
                "least: give that, shrink images by --dataset.image_size, or take fewer --dataset.episodes"
            )
        room = limit * GIB - fixed
        kept = (
            int((room - max(quantising, boosting + DRAWN * least * n_frames)) / n_frames),
            int((room - switching) / ((1 + copied) * n_frames)),
        )
        columns = min(max(min(kept), least), n_columns)
        drawn = int((room - boosting - columns * n_frames) / (DRAWN * n_frames))
        drawn = min(max(drawn, least), columns)
        return cls(columns, n_columns, drawn, most(columns, drawn))


def prepare(
    images: UInt8[Tensor, "frames height width 3"],
    lengths: Int64[Tensor, " trajectories"],
    features: FeatureSet,
    plan: Plan,
    generator: torch.Generator,
    on_columns: Callable[[int], None] = lambda _: None,
) -> tuple[FeatureSet, Quantiser, SortedLevels]:
    """The columns that the plan keeps, their cuts, and the levels of every frame, sorted if it says so.

    Columns are computed a part at a time, so that raw values never stand in memory all at once; `on_columns`
    is told how many are done.
    """
    if plan.columns < features.count:
        kept = torch.randperm(features.count, generator=generator)[: plan.columns].sort().values
        features = features.select(kept)
    before = frames_before(lengths.to(images.device))
    n_frames = len(images)
    sample = torch.linspace(0, n_frames - 1, min(n_frames, SAMPLED), device=images.device).round().long()
    sampled, sampled_before = (images if len(sample) == n_frames else images[sample]), images[before[sample]]
    levels = torch.empty(features.count, n_frames, dtype=torch.uint8, device=images.device)
    cuts = []
    for numbers in torch.arange(features.count).split(max(VALUES // len(sample), 1)):
        part = features.select(numbers)
        values = part.values(sampled, sampled_before)
        quantiser = Quantiser.fit(values)
        cuts.append(quantiser.cuts)
        rows = slice(int(numbers[0]), int(numbers[-1]) + 1)
        if len(sample) == n_frames:
            levels[rows] = quantiser.levels(values)
        else:
            for frames in torch.arange(n_frames, device=images.device).split(max(VALUES // len(numbers), 1)):
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
    features: FeatureSet,
    quantiser: Quantiser,
) -> SortedLevels:
    """The levels of all frames, then those of their mirror images, left and right exchanged; none sorted."""
    before = frames_before(lengths.to(images.device))
    levels = torch.cat([data.levels, torch.empty_like(data.levels)], 1)
    for frames in torch.arange(len(images), device=images.device).split(max(VALUES // features.count, 1)):
        values = features.values(images[frames].flip(2), images[before[frames]].flip(2))
        levels[:, len(images) + frames] = quantiser.levels(values)
    return SortedLevels.unsorted(levels)
