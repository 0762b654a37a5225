"""Builds the benchmark's matrices: quantised features of recorded demonstrations, or planted classes."""

from typing import Any

import numpy as np
import torch
from matrices import SIZES, Matrix, planted

from dpmacro.data.demonstrations import Demonstrations
from dpmacro.features.base import Seen, frames_before
from dpmacro.features.kinds import make_features
from dpmacro.features.quantising import Quantiser

__all__ = ["build", "recorded"]

HELD_OUT = 5  # at most every fifth trajectory is held out


def build(kind: str, folder: str, dataset: str, quick: bool) -> dict[str, Any]:
    """Write the matrix of that kind; returns its shape and the number of held-out frames.

    Recorded demonstrations give their first frames to training. Trajectories that begin after them are held
    out, a fifth of all at most and one at least.
    """
    n_frames, n_columns = SIZES[kind][quick]
    if kind == "random":
        matrix = planted(n_frames, n_frames // 5, n_columns, np.random.default_rng(0))
    else:
        matrix = recorded(kind, Demonstrations.load(dataset), n_frames, n_columns)
    matrix.save(folder)
    return {"shape": matrix.features.shape, "held_out": len(matrix.held_features)}


def recorded(kind: str, demonstrations: Demonstrations, n_frames: int, n_columns: int) -> Matrix:
    """Quantised features of demonstrations, evenly chosen columns where there are more than asked for."""
    lengths = torch.from_numpy(demonstrations.lengths)
    starts = lengths.cumsum(0) - lengths
    n_held = min(max(int((starts >= n_frames).sum()), 1), max(len(lengths) // HELD_OUT, 1))
    held = int(starts[-n_held])
    n_frames = min(n_frames, held)
    images = torch.from_numpy(demonstrations.images)
    previous = images[frames_before(lengths)]
    height, width = images.shape[1:3]
    features = make_features(kind, height, width, n_columns, torch.Generator().manual_seed(0))
    features = features.select(torch.linspace(0, features.count - 1, min(n_columns, features.count)).long())
    values = features.values(_seen(images[:n_frames], previous[:n_frames]))
    quantiser = Quantiser.fit(values)
    kept = (n_frames - starts).clamp(min=torch.zeros_like(lengths), max=lengths)
    return Matrix(
        quantiser.levels(values).T.numpy(),
        demonstrations.actions[:n_frames],
        kept[kept > 0].numpy(),
        quantiser.levels(features.values(_seen(images[held:], previous[held:]))).T.numpy(),
        demonstrations.actions[held:],
    )


def _seen(images: torch.Tensor, previous: torch.Tensor) -> Seen:
    """Images, and those before them, as an encoder of one camera looks at them."""
    return {0: {"observation.image": images}, 1: {"observation.image": previous}}
