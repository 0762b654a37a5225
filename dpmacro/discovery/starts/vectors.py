"""Initial segmentations where actions are vectors: every kind, a share of each."""

from collections.abc import Callable

import torch
from jaxtyping import Int64, UInt8
from torch import Tensor

from dpmacro.discovery.starts.chains import chained
from dpmacro.discovery.starts.clusters import merged_pieces, spectral_windows, window_clusters
from dpmacro.discovery.starts.cuts import feature_peaks, random_cuts, uniform_cuts
from dpmacro.discovery.starts.events import jumps, shifts, slow_moments
from dpmacro.discovery.starts.evidence import Evidence
from dpmacro.discovery.starts.linear import Moments

__all__ = ["vector_starts"]

SHARES = {  # of the restarts
    "random": 3,
    "peaks": 3,
    "jumps": 2,
    "shifts": 2,
    "slow": 2,
    "windows": 2,
    "merged": 1,
    "spectral": 1,
}


def vector_starts(
    levels: UInt8[Tensor, "columns frames"],
    evidence: Evidence,
    moments: Moments,
    restarts: int,
    generator: torch.Generator,
) -> dict[str, Int64[Tensor, "own frames"]]:
    """`restarts` starts by their kind; all keep the bound, and are chains where those are asked for."""
    bounds = evidence.macros, evidence.max_transitions
    kinds: dict[str, Callable[[int], Tensor]] = {
        "random": lambda n: torch.cat(
            [
                uniform_cuts(evidence.lengths, *bounds)[:n],
                random_cuts(evidence.lengths, max(n - 1, 0), *bounds, generator),
            ]
        ),
        "peaks": lambda n: feature_peaks(levels, evidence.lengths, n, *bounds, generator),
        "jumps": lambda n: jumps(evidence, n, generator),
        "shifts": lambda n: shifts(evidence, n, generator),
        "slow": lambda n: slow_moments(evidence, n, generator),
        "windows": lambda n: window_clusters(evidence, n, generator),
        "merged": lambda n: merged_pieces(evidence, n, generator, moments),
        "spectral": lambda n: spectral_windows(evidence, n, generator, moments),
    }
    total, given, found = sum(SHARES.values()), 0, {}
    so_far = 0
    for name, share in SHARES.items():
        so_far += share
        count = -(-restarts * so_far // total) - given
        given += count
        starts = kinds[name](count)
        found[name] = chained(starts, evidence.lengths, evidence.macros) if evidence.chain else starts
    return found
