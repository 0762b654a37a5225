"""What the starts of vectors look at: the actions and a few principal components of the columns."""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int64
from torch import Tensor

from dpmacro.features.levels import SortedLevels
from dpmacro.segmentation.recursion import segment

__all__ = ["Evidence", "best_places", "firsts", "in_turn", "k_means", "principal", "window_means"]

COLUMNS = 256  # at most, drawn at random
SAMPLE = 2**14  # frames that the covariance is taken from
BLOCK = 2**14  # frames projected at a time
SWEEPS = 25  # of k-means


@dataclass(frozen=True)
class Evidence:
    """The frames of all trajectories and the bounds on their macro-labels; on the CPU.

    Attributes:
        actions: standardised.
        components: of the columns, decorrelated, with variance 1.
        lengths: frames of every trajectory.
        macros: Q.
        max_transitions: S.
        chain: whether macro-labels are 0, 1, ..., S in every trajectory.
    """

    actions: Float[Tensor, "frames dims"]
    components: Float[Tensor, "frames components"]
    lengths: Int64[Tensor, " trajectories"]
    macros: int
    max_transitions: int
    chain: bool = False

    @property
    def gap(self) -> int:
        """Frames that cuts keep from one another and from the ends: a fourth of a segment of mean length."""
        return max(int(self.lengths.float().mean()) // (4 * (self.max_transitions + 1)), 1)

    @property
    def values(self) -> Float[Tensor, "frames both"]:
        """Actions, then components."""
        return torch.cat([self.actions, self.components], 1)

    def cheapest(self, costs: Float[Tensor, "frames macros"]) -> Int64[Tensor, " frames"]:
        """The macro-labels of least cost, within the bounds."""
        order = "chain" if self.chain else "free"
        return segment(costs, self.lengths, self.max_transitions, order=order).labels


def principal(
    data: SortedLevels, count: int, generator: torch.Generator
) -> Float[Tensor, "frames components"]:
    """Up to `count` principal components of the columns' levels, each with variance 1; fewer where flat."""
    chosen = torch.randperm(data.n_columns, generator=generator)[:COLUMNS].sort().values
    own = data.rows(chosen).cpu()
    step = max(own.shape[1] // SAMPLE, 1)
    sample = own[:, ::step].double()
    mean, deviation = sample.mean(1, keepdim=True), sample.std(1, correction=0, keepdim=True)
    scale = torch.where(deviation > 0, 1 / deviation.clamp(min=1e-9), 0.0)
    sample = (sample - mean) * scale
    values, vectors = torch.linalg.eigh(sample @ sample.T / sample.shape[1])
    values, vectors = values.flip(0)[:count], vectors.flip(1)[:, :count]
    kept = values > 1e-6 * max(len(own), 1)
    basis = (vectors[:, kept] / values[kept].sqrt() * scale).float()
    return torch.cat([((part - mean).float().T @ basis) for part in own.double().split(BLOCK, 1)])


def firsts(lengths: Int64[Tensor, " trajectories"]) -> Bool[Tensor, " frames"]:
    """True at the first frame of every trajectory."""
    result = torch.zeros(int(lengths.sum()), dtype=torch.bool)
    result[lengths.cumsum(0) - lengths] = True
    return result


def window_means(
    values: Float[Tensor, "frames dims"],
    lengths: Int64[Tensor, " trajectories"],
    before: int,
    after: int,
) -> Float[Tensor, "frames dims"]:
    """Means over frames n - before .. n + after - 1, those of the same trajectory; 0 where there are none."""
    sums = torch.nn.functional.pad(values.double().cumsum(0), (0, 0, 1, 0))
    ends = lengths.cumsum(0)
    first, last = (ends - lengths).repeat_interleave(lengths), ends.repeat_interleave(lengths)
    time = torch.arange(len(values))
    low, high = torch.maximum(time - before, first), torch.minimum(time + after, last)
    return ((sums[high] - sums[low]) / (high - low).clamp(min=1)[:, None]).float()


def best_places(
    scores: Float[Tensor, " frames"], lengths: Int64[Tensor, " trajectories"], count: int, gap: int
) -> Bool[Tensor, " frames"]:
    """Up to `count` frames of highest finite score in every trajectory, greedily, more than `gap` apart.

    They are more than `gap` from the ends, too, where the trajectory is long enough for that.
    """
    inside = torch.arange(int(lengths.max())) < lengths[:, None]
    padded = torch.full(inside.shape, -torch.inf)
    padded[inside] = scores.float()
    time = torch.arange(padded.shape[1])
    margin = torch.minimum(torch.full_like(lengths, gap), lengths // 4)[:, None]
    padded[(time < margin.clamp(min=1)) | (time >= lengths[:, None] - margin)] = -torch.inf
    places = torch.zeros(inside.shape, dtype=torch.bool)
    rows = torch.arange(len(lengths))
    for _ in range(count):
        place = padded.argmax(1)
        places[rows, place] |= padded[rows, place] > -torch.inf
        padded[(time - place[:, None]).abs() <= gap] = -torch.inf
    return places[inside]


def in_turn(
    changes: Bool[Tensor, " frames"], lengths: Int64[Tensor, " trajectories"], macros: int
) -> Int64[Tensor, " frames"]:
    """Macro-actions in turn from the first, the next at every change."""
    total = changes.long().cumsum(0)
    before = (total - changes.long())[lengths.cumsum(0) - lengths]
    return (total - before.repeat_interleave(lengths)) % macros


def k_means(
    points: Float[Tensor, "points dims"], count: int, generator: torch.Generator
) -> Float[Tensor, "clusters dims"]:
    """Centres of `count` clusters by Lloyd's sweeps from k-means++ (Arthur and Vassilvitskii 2007).

    Where there are fewer distinct points than clusters some centres are the same.
    """
    centres = points[torch.randint(len(points), (1,), generator=generator)]
    for _ in range(count - 1):
        far = (torch.cdist(points, centres) ** 2).amin(1)
        drawn = torch.multinomial(far + 1e-12 * (1 + far.mean()), 1, generator=generator)
        centres = torch.cat([centres, points[drawn]])
    for _ in range(SWEEPS):
        nearest = torch.cdist(points, centres).argmin(1)
        counts = nearest.bincount(minlength=count)
        sums = torch.zeros_like(centres).index_add(0, nearest, points)
        after = torch.where((counts > 0)[:, None], sums / counts.clamp(min=1)[:, None], centres)
        if torch.equal(after, centres):
            break
        centres = after
    return centres
