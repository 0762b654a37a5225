"""The segmentation as the textbook has it, a compiled loop over time: what the recursion is held to.

    E(n, q, s) = c_n(q) + min(E(n-1, q, s), min_{q'} E(n-1, q', s-1))

with at most s transitions so far. The inner minimum may take q' = q, which is never cheaper than staying; so
it is one number for all q, and a frame takes Q S steps.
"""

import numba
import numpy as np

__all__ = ["segment_all", "segment_one"]


@numba.njit(cache=False)
def segment_all(costs: np.ndarray, bound: int) -> tuple[np.ndarray, np.ndarray]:
    """Labels uint8 [trajectories, frames] and least costs [trajectories].

    `costs` are [trajectories, frames, macros]; a trajectory has at most `bound` >= 0 transitions.
    """
    labels = np.empty(costs.shape[:2], np.uint8)
    totals = np.empty(len(costs))
    sources = np.empty((costs.shape[1], bound + 1, costs.shape[2]), np.int8)
    for trajectory in range(len(costs)):
        totals[trajectory] = segment_one(costs[trajectory], sources, labels[trajectory])
    return labels, totals


@numba.njit(cache=False)
def segment_one(costs: np.ndarray, sources: np.ndarray, labels: np.ndarray) -> float:
    """The least cost of one trajectory's costs [frames, macros]; writes its labels [frames].

    `sources` int8 [frames, bounds, macros] is room for the macro-action before each, -1 for the same.
    """
    n_frames, n_macros = costs.shape
    n_bounds = sources.shape[1]
    best = np.empty((n_bounds, n_macros))
    for s in range(n_bounds):
        best[s] = costs[0]
    for n in range(1, n_frames):
        for s in range(n_bounds - 1, -1, -1):  # downwards: E(n-1, q', s-1) is still there
            arriving, source = np.inf, -1
            if s > 0:
                for q in range(n_macros):
                    if best[s - 1, q] < arriving:
                        arriving, source = best[s - 1, q], q
            for q in range(n_macros):
                moved = arriving < best[s, q]
                best[s, q] = costs[n, q] + (arriving if moved else best[s, q])
                sources[n, s, q] = source if moved else -1
    s = n_bounds - 1
    q = int(np.argmin(best[s]))
    total = best[s, q]
    for n in range(n_frames - 1, -1, -1):
        labels[n] = q
        if n > 0 and sources[n, s, q] >= 0:
            q, s = sources[n, s, q], s - 1
    return total
