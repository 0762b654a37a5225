"""Macro-actions as clusters: of windows, of pieces, and of windows by how well one's model predicts another."""

import torch
from jaxtyping import Float, Int64
from torch import Tensor

from dpmacro.discovery.starts.evidence import Evidence, k_means, window_means
from dpmacro.discovery.starts.linear import Moments

__all__ = ["merged_pieces", "spectral_windows", "window_clusters"]

WINDOWS = 400  # at most, that are compared with one another
PIECES = 6  # a segment to be merged


def window_clusters(
    evidence: Evidence, restarts: int, generator: torch.Generator
) -> Int64[Tensor, "restarts frames"]:
    """K-means of window means of actions and components, then the bounded segmentation of the distances.

    In turn, of both, of actions, and of components; the window is drawn, of 3 frames up to half a segment.
    """
    parts = (
        torch.cat([evidence.actions, evidence.components], 1),
        evidence.actions,
        evidence.components,
    )
    starts = []
    for restart in range(restarts):
        width = 1 + int((2 * evidence.gap) ** float(torch.rand(1, generator=generator)))
        means = window_means(parts[restart % 3], evidence.lengths, width, width + 1)
        centres = k_means(means[:: max(len(means) // 2**12, 1)], evidence.macros, generator)
        starts.append(evidence.cheapest(_in_order(torch.cdist(means, centres) ** 2, evidence)))
    return _stacked(starts, evidence)


def merged_pieces(
    evidence: Evidence, restarts: int, generator: torch.Generator, moments: Moments
) -> Int64[Tensor, "restarts frames"]:
    """Short pieces of every trajectory, merged bottom up to S + 1 by what one linear model costs two of them.

    The two neighbours whose merging costs least are one (Keogh et al. 2001), in all trajectories side by
    side. The pieces that stay are named by k-means of their moments' means. Every restart shifts the pieces.
    """
    starts = []
    for _ in range(restarts):
        count = PIECES * (evidence.max_transitions + 1)
        phase = torch.rand(1, generator=generator)
        piece = _pieces(evidence.lengths, count, float(phase))  # [frames], 0..count-1 within the trajectory
        starts.append(_named_pieces(evidence, _merged(evidence, piece, count, moments), moments, generator))
    return _stacked(starts, evidence)


def spectral_windows(
    evidence: Evidence, restarts: int, generator: torch.Generator, moments: Moments
) -> Int64[Tensor, "restarts frames"]:
    """Clusters of windows by how well a linear model of one predicts another, then of frames by model.

    Normalised spectral clustering (Ng, Jordan, Weiss 2002) of exp(-d / median), d being the mean error of
    either window's model on the other beyond their own. Every restart draws the windows and their length,
    between half a segment and an eighth.
    """
    starts = []
    for _ in range(restarts):
        longest = max(4 * evidence.gap, 2)
        length = max(int(longest * 2.0 ** (-1 - 2 * float(torch.rand(1, generator=generator)))), 2)
        starts.append(_spectral(evidence, length, moments, generator))
    return _stacked(starts, evidence)


def _spectral(
    evidence: Evidence, length: int, moments: Moments, generator: torch.Generator
) -> Int64[Tensor, " frames"]:
    pieces = _windows(evidence.lengths, length)
    count = int(pieces[-1]) + 1
    sizes = pieces.bincount(minlength=count).float()
    sums = torch.zeros(count, moments.table.shape[1]).index_add_(0, pieces, moments.table)
    drawn = torch.randperm(count, generator=generator)[:WINDOWS].sort().values
    means, sizes = sums[drawn] / sizes[drawn, None], sizes[drawn]
    errors = (means @ moments.models(sums[drawn]).T).clamp(min=0)  # [window, model]
    own = errors.diagonal()
    apart = (errors - own[:, None]).clamp(min=0)
    apart = apart + apart.T
    near = torch.exp(-apart / apart.median().clamp(min=1e-9))
    degree = near.sum(1).rsqrt()
    _, vectors = torch.linalg.eigh((degree[:, None] * near * degree).double())
    embedded = torch.nn.functional.normalize(vectors[:, -evidence.macros :].float(), dim=1)
    cluster = torch.cdist(embedded, k_means(embedded, evidence.macros, generator)).argmin(1)
    by_cluster = torch.zeros(evidence.macros, sums.shape[1]).index_add_(0, cluster, sums[drawn])
    costs = (moments.table @ moments.models(by_cluster).T).clamp(min=0)
    empty = cluster.bincount(minlength=evidence.macros) == 0
    costs[:, empty] = costs.max() + 1
    return evidence.cheapest(_in_order(costs, evidence))


def _merged(
    evidence: Evidence, piece: Int64[Tensor, " frames"], count: int, moments: Moments
) -> Int64[Tensor, " frames"]:
    """Numbers 0.. of the pieces that are left, over all trajectories."""
    n_trajectories, most = len(evidence.lengths), evidence.max_transitions + 1
    place = torch.arange(n_trajectories).repeat_interleave(evidence.lengths) * count + piece
    sums = torch.zeros(n_trajectories * count, moments.table.shape[1]).index_add_(0, place, moments.table)
    sums = sums.unflatten(0, (n_trajectories, count))
    owner = torch.arange(count).repeat(n_trajectories, 1)  # piece -> the piece it is part of, its first
    rows = torch.arange(n_trajectories)

    def error(sums: Tensor) -> Tensor:
        flat = sums.flatten(0, -2)
        return (flat * moments.models(flat)).sum(1).view(sums.shape[:-1])

    for left in range(count, most, -1):
        if left == count:
            single, pair = error(sums), error(sums[:, :-1] + sums[:, 1:])
        cost = pair - single[:, :-1] - single[:, 1:]
        k = cost.argmin(1)
        both = sums[rows, k] + sums[rows, k + 1]
        keep = torch.ones(sums.shape[:2], dtype=torch.bool)
        keep[rows, k + 1] = False
        sums[rows, k] = both
        sums = sums[keep].view(n_trajectories, left - 1, -1)
        single, pair = error(sums), error(sums[:, :-1] + sums[:, 1:])
        owner = owner - (owner > k[:, None]).long()
    return owner[place // count, piece] + (place // count) * count


def _named_pieces(
    evidence: Evidence, piece: Int64[Tensor, " frames"], moments: Moments, generator: torch.Generator
) -> Int64[Tensor, " frames"]:
    if evidence.chain:
        return piece % (PIECES * (evidence.max_transitions + 1))
    piece = piece.unique_consecutive(return_inverse=True)[1]
    sizes = piece.bincount()[:, None]
    means = torch.zeros(len(sizes), moments.table.shape[1]).index_add_(0, piece, moments.table) / sizes
    return torch.cdist(means, k_means(means, evidence.macros, generator)).argmin(1)[piece]


def _pieces(lengths: Int64[Tensor, " trajectories"], count: int, phase: float) -> Int64[Tensor, " frames"]:
    parts = [
        (torch.arange(length) * count / length + phase).long().clamp(max=count - 1)
        for length in lengths.tolist()
    ]
    return torch.cat(parts)


def _windows(lengths: Int64[Tensor, " trajectories"], length: int) -> Int64[Tensor, " frames"]:
    """Number of every frame's window, of about `length` frames, within trajectories."""
    parts, first = [], 0
    for own in lengths.tolist():
        count = max(own // length, 1)
        parts.append(torch.arange(own) * count // own + first)
        first += count
    return torch.cat(parts)


def _in_order(costs: Float[Tensor, "frames macros"], evidence: Evidence) -> Float[Tensor, "frames macros"]:
    """For a chain, clusters in the order of the mean time at which each is cheapest."""
    if not evidence.chain:
        return costs
    time = torch.cat([torch.arange(n) / n for n in evidence.lengths.tolist()])
    nearest = costs.argmin(1)
    total = torch.zeros(costs.shape[1]).index_add_(0, nearest, time)
    return costs[:, (total / nearest.bincount(minlength=costs.shape[1]).clamp(min=1)).argsort()]


def _stacked(starts: list[Tensor], evidence: Evidence) -> Int64[Tensor, "restarts frames"]:
    if not starts:
        return torch.zeros(0, len(evidence.actions), dtype=torch.int64)
    return torch.stack(starts)
