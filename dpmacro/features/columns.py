"""Observations to feature columns: computed, quantised to 256 levels and sorted, a part of them at a time."""

from collections.abc import Callable, Iterator

import torch
from jaxtyping import Int64, Num
from torch import Tensor

from dpmacro.features import memory
from dpmacro.features.base import Encoder, Observation, frame_bytes
from dpmacro.features.history import Recording
from dpmacro.features.levels import LEVELS, SortedLevels
from dpmacro.features.memory import Plan
from dpmacro.features.quantising import Quantiser
from dpmacro.parallel import ALONE, Ranks, Shares

__all__ = ["prepare", "with_mirror_images"]


def prepare(
    observations: Observation,
    lengths: Int64[Tensor, " trajectories"],
    encoder: Encoder,
    plan: Plan,
    generator: torch.Generator,
    on_columns: Callable[[int], None] = lambda _: None,
    ranks: Ranks = ALONE,
) -> tuple[Encoder, Quantiser, SortedLevels]:
    """The columns that the plan keeps, their cuts, and the levels of every frame, sorted if the plan says so.

    Columns are computed a part at a time, and a part of the frames at a time, so that neither raw values nor
    copies of observations ever stand in memory all at once.

    Args:
        observations: all frames of all trajectories, by key; what `encoder` does not look at is not read.
        lengths: frames per trajectory.
        encoder: the columns to choose from.
        plan: how many are kept, drawn at random where they are not all, and whether they are sorted. Columns
            without pixels are kept in any case.
        generator: draws the columns that are kept.
        on_columns: called after each part with the number of columns in it.
        ranks: who computes, quantises and sorts a share of the columns each; all have all cuts in the end.

    Raises ValueError where the plan keeps fewer columns than those without pixels, where an observation
    lacks or does not fit, and where values are not finite.
    """
    if plan.columns < encoder.count:
        encoder = encoder.select(_kept(encoder, plan.columns, generator))
    recording = _recording(observations, lengths, encoder)
    n_frames, device = recording.n_frames, observations[encoder.keys[0]].device
    sampled = min(n_frames, memory.SAMPLED)
    sample = None
    if sampled < n_frames:
        sample = torch.linspace(0, n_frames - 1, sampled, device=device).round().long()
    shares = Shares(encoder.count, ranks)
    levels = torch.empty(len(shares.own), n_frames, dtype=torch.uint8, device=device)
    cuts = [torch.empty(0, LEVELS - 1, dtype=encoder.dtype, device=device)]
    with ranks.together():
        for places in torch.arange(len(shares.own)).split(_room(encoder, sampled)):
            part = encoder.select(shares.own[places])
            values = _values(recording, part, sample, _at_a_time(part, observations))
            quantiser = Quantiser.fit(values, encoder.dtype)
            cuts.append(quantiser.cuts)
            rows = slice(int(places[0]), int(places[-1]) + 1)
            if sample is None:
                levels[rows] = quantiser.levels(values)
            else:
                for frames in _chunks(n_frames, min(_at_a_time(part, observations), _room(part, part.count))):
                    del values  # before the next ones need as much
                    values = part.values(recording.seen(part, frames))
                    levels[rows, frames] = quantiser.levels(values)
            del values
            on_columns(len(places))
    kinds = encoder.sees_pixels.cpu().long()
    build = SortedLevels.unsorted if plan.drawn else SortedLevels.build
    quantiser = Quantiser(shares.whole(torch.cat(cuts)))
    return encoder, quantiser, build(levels, kinds=kinds, shares=shares)


def with_mirror_images(
    data: SortedLevels,
    observations: Observation,
    lengths: Int64[Tensor, " trajectories"],
    encoder: Encoder,
    quantiser: Quantiser,
) -> SortedLevels:
    """The levels of all frames, then those of their mirror images, left and right exchanged; none sorted.

    Raises ValueError where a column looks at something else than pixels: that has no mirror image.
    """
    if not bool(encoder.sees_pixels.all()):
        blind = encoder.names()[int((~encoder.sees_pixels).long().argmax())]
        raise ValueError(f"column {blind!r} has no mirror image: mirror cameras alone")
    encoder, quantiser = encoder.select(data.shares.own), quantiser.select(data.shares.own)
    recording = _recording(observations, lengths, encoder)
    n_frames = recording.n_frames
    levels = torch.cat([data.levels, torch.empty_like(data.levels)], 1)
    for frames in _chunks(n_frames, min(_at_a_time(encoder, observations), _room(encoder, encoder.count))):
        seen = recording.seen(encoder, frames)
        mirrored = {lag: {key: images.flip(2) for key, images in one.items()} for lag, one in seen.items()}
        levels[:, n_frames + frames.start : n_frames + frames.stop] = quantiser.levels(
            encoder.values(mirrored)
        )
    return SortedLevels.unsorted(levels, shares=data.shares)


def _recording(
    observations: Observation, lengths: Int64[Tensor, " trajectories"], encoder: Encoder
) -> Recording:
    """The observations that the encoder looks at."""
    missing = [key for key in encoder.keys if key not in observations]
    if missing:
        raise ValueError(f"no {missing[0]} was recorded, only {', '.join(observations)}")
    return Recording({key: observations[key] for key in encoder.keys}, lengths)


def _kept(encoder: Encoder, count: int, generator: torch.Generator) -> Int64[Tensor, " kept"]:
    """Numbers of `count` columns: those without pixels, the rest drawn at random."""
    drawable = encoder.sees_pixels.cpu()
    blind = (~drawable).nonzero()[:, 0]
    if len(blind) > count:
        raise ValueError(f"{len(blind)} columns look at no pixels and are kept, the plan keeps {count}")
    pixels = drawable.nonzero()[:, 0]
    drawn = torch.randperm(len(pixels), generator=generator)[: count - len(blind)]
    return torch.cat([blind, pixels[drawn]]).sort().values


def _room(encoder: Encoder, size: int) -> int:
    """How many columns of `size` frames, or frames of `size` columns, may be computed at a time.

    Values of float64 take twice the bytes, and those of a part stand beside them while they are copied.
    """
    each = 3 if encoder.dtype == torch.float64 else 1
    return max(memory.VALUES // (each * max(size, 1)), 1)


def _at_a_time(encoder: Encoder, observations: Observation) -> int:
    """How many frames' observations may be copied at a time."""
    each = sum(len(lags) * frame_bytes({key: observations[key]}) for key, lags in encoder.needs.items())
    return max(memory.GATHERED // max(each, 1), 1)


def _chunks(n_frames: int, size: int) -> Iterator[slice]:
    """All frames, `size` at a time."""
    for start in range(0, n_frames, size):
        yield slice(start, min(start + size, n_frames))


def _values(
    recording: Recording, encoder: Encoder, sample: Int64[Tensor, " sample"] | None, size: int
) -> Num[Tensor, "columns sampled"]:
    """The values of the sampled frames, of all for None, computed of `size` frames at a time."""
    n_frames = recording.n_frames if sample is None else len(sample)
    chunks = [chunk if sample is None else sample[chunk] for chunk in _chunks(n_frames, size)]
    if len(chunks) == 1:
        return encoder.values(recording.seen(encoder, chunks[0]))
    result, done = torch.empty(0), 0
    for chunk in chunks:
        values = encoder.values(recording.seen(encoder, chunk))
        if done == 0:
            result = torch.empty(encoder.count, n_frames, dtype=values.dtype, device=values.device)
        result[:, done : done + values.shape[1]] = values
        done += values.shape[1]
    return result
