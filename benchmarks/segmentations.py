"""The segmentation against a loop over time in Numba, and against hmmlearn's Viterbi.

Numba finds the same optimum. hmmlearn finds the likeliest states of a hidden Markov model with as many
states, of as many frames: another problem, of the size of one bound s.
"""

import time
from collections.abc import Iterator
from typing import Any

import numpy as np
from plan import Plan, settled
from report import Row

__all__ = ["hidden_markov", "numba_loop", "ours", "problem", "rows"]

TRAJECTORIES, QUICK_TRAJECTORIES = (20, 200, 1_000), (20,)
FRAMES, QUICK_FRAMES = 900, 100
MACROS = (2, 4, 8)
BOUND = 8
SAME = 1e-9  # relative difference of two costs that are equal up to rounding


def rows(plan: Plan) -> Iterator[Row]:
    """Both peers, for S = Q - 1 and S = 8, in every size. Raises AssertionError where a cost differs."""
    frames = QUICK_FRAMES if plan.quick else FRAMES
    for trajectories in QUICK_TRAJECTORIES if plan.quick else TRAJECTORIES:
        for macros in MACROS:
            size = {"trajectories": trajectories, "frames": frames, "macros": macros, "repeats": plan.repeats}
            bounds = [macros - 1, BOUND]
            found = plan.attempt("segmentations.ours", bounds=bounds, **size)
            loop = plan.attempt("segmentations.numba_loop", bounds=bounds, **size)
            states = plan.attempt("segmentations.hidden_markov", **size)
            for k, bound in enumerate(bounds):
                if found is None:
                    continue
                case = f"{trajectories:,} x {frames} x {macros}, S = {bound}"
                seconds = settled(found["seconds"][k])
                if loop is not None:
                    same = np.allclose(found["costs"][k], loop["costs"][k], rtol=SAME, atol=0)
                    assert same, f"{case}: the two optima differ"
                    yield Row("segmentation", case, seconds, "Numba, one core", settled(loop["seconds"][k]))
                if states is not None:
                    yield Row("segmentation", case, seconds, "hmmlearn's Viterbi", settled(states["seconds"]))


def problem(trajectories: int, frames: int, macros: int) -> np.ndarray:
    """Costs [trajectories, frames, macros] of planted segments under noise, above 0."""
    random = np.random.default_rng(trajectories * macros)
    cuts = np.sort(random.random((trajectories, 1, macros - 1)) * frames)
    labels = (np.arange(frames)[:, None] >= cuts).sum(2)
    costs = random.exponential(size=(trajectories, frames, macros))
    return costs + (labels[:, :, None] != np.arange(macros)) * 0.5


def ours(trajectories: int, frames: int, macros: int, repeats: int, bounds: list[int]) -> dict[str, Any]:
    """`segment`: for every bound, seconds of `repeats` runs after a first, and the trajectories' costs."""
    import torch

    from dpmacro.segmentation.recursion import segment

    costs = torch.from_numpy(problem(trajectories, frames, macros)).flatten(0, 1)
    lengths = torch.full((trajectories,), frames)
    runs = [_repeat(lambda bound=bound: segment(costs, lengths, bound), repeats) for bound in bounds]
    return {"seconds": [run[0] for run in runs], "costs": [run[1].cost.tolist() for run in runs]}


def numba_loop(
    trajectories: int, frames: int, macros: int, repeats: int, bounds: list[int]
) -> dict[str, Any]:
    """The same by `recursion`, on one core; the first run compiles. Its labels cost what it says."""
    from recursion import segment_all

    costs = problem(trajectories, frames, macros)
    runs = [_repeat(lambda bound=bound: segment_all(costs, bound), repeats) for bound in bounds]
    for bound, (_, (labels, totals)) in zip(bounds, runs, strict=True):
        held = np.take_along_axis(costs, labels[:, :, None].astype(np.int64), 2).sum((1, 2))
        assert np.allclose(held, totals, rtol=SAME, atol=0)
        assert (np.diff(labels) != 0).sum(1).max() <= bound
    return {"seconds": [run[0] for run in runs], "costs": [run[1][1].tolist() for run in runs]}


def hidden_markov(trajectories: int, frames: int, macros: int, repeats: int) -> dict[str, Any]:
    """CategoricalHMM.decode of the symbol with the least cost in every frame; its cheapest emissions."""
    from hmmlearn.hmm import CategoricalHMM

    symbols = problem(trajectories, frames, macros).argmin(2).reshape(-1, 1)
    model = CategoricalHMM(n_components=macros)
    model.startprob_ = np.full(macros, 1 / macros)
    model.transmat_ = _mostly_diagonal(macros, 1 / frames)
    model.emissionprob_ = _mostly_diagonal(macros, 0.5)
    model.n_features = macros
    lengths = np.full(trajectories, frames)
    seconds, _ = _repeat(lambda: model.decode(symbols, lengths), repeats)
    return {"seconds": seconds}


def _mostly_diagonal(size: int, leaving: float) -> np.ndarray:
    return np.where(np.eye(size, dtype=bool), 1 - leaving, leaving / (size - 1))


def _repeat(step: Any, repeats: int) -> tuple[list[float], Any]:
    seconds = []
    for _ in range(repeats + 1):
        clock = time.perf_counter()
        result = step()
        seconds.append(time.perf_counter() - clock)
    return seconds, result
