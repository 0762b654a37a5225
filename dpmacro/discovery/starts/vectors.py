"""Initial segmentations where actions are vectors: every kind, a share of each."""

from collections.abc import Callable, Mapping

import torch
from jaxtyping import Int64
from torch import Tensor

from dpmacro.discovery.starts.chains import chained
from dpmacro.discovery.starts.clusters import merged_pieces, spectral_windows, window_clusters
from dpmacro.discovery.starts.cuts import feature_peaks, random_cuts, uniform_cuts
from dpmacro.discovery.starts.events import cut_at, jump_places, shift_places, slow_places
from dpmacro.discovery.starts.evidence import Evidence, principal
from dpmacro.discovery.starts.goals import by_goals
from dpmacro.discovery.starts.linear import Moments
from dpmacro.discovery.task import Task
from dpmacro.features.levels import SortedLevels

__all__ = ["KINDS", "evidence_of", "vector_starts"]

SHARES = {  # of the restarts
    "goals": 5,
    "spectral": 3,
    "merged": 2,
    "windows": 4,
    "jumps": 2,
    "shifts": 2,
    "random": 2,
    "peaks": 2,
    "slow": 1,
}


KINDS = tuple(SHARES)
COMPONENTS = 16  # of the columns


def evidence_of(data: SortedLevels, task: Task, generator: torch.Generator) -> Evidence:
    """What the starts of a task look at."""
    components = principal(data, COMPONENTS, generator)
    bounds = task.macros, task.max_transitions, task.order == "chain"
    return Evidence(task.actions.cpu(), components, task.lengths, *bounds)


def vector_starts(
    data: SortedLevels,
    evidence: Evidence,
    moments: Moments,
    restarts: int,
    generator: torch.Generator,
    shares: Mapping[str, int] = SHARES,
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
        "peaks": lambda n: feature_peaks(data, evidence.lengths, n, *bounds, generator),
        "jumps": lambda n: cut_at(jump_places, evidence, n, generator),
        "shifts": lambda n: cut_at(shift_places, evidence, n, generator),
        "slow": lambda n: cut_at(slow_places, evidence, n, generator),
        "goals": lambda n: by_goals(data, evidence, n, generator),
        "windows": lambda n: window_clusters(evidence, n, generator),
        "merged": lambda n: merged_pieces(evidence, n, generator, moments),
        "spectral": lambda n: spectral_windows(evidence, n, generator, moments),
    }
    total, given, found = sum(shares.values()), 0, {}
    so_far = 0
    for name, share in shares.items():
        so_far += share
        count = -(-restarts * so_far // total) - given
        given += count
        starts = kinds[name](count)
        found[name] = chained(starts, evidence.lengths, evidence.macros) if evidence.chain else starts
    return found
