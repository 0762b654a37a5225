"""Stages made by hand, for tests of what is written of them."""

import numpy as np

from dpmacro.annotation.stages import Stages


def some_stages(lengths, names=("a", "b"), fps=10, labels=None):
    """The first half of every demonstration is of the first stage, the rest of the second, or as given."""
    n_frames = sum(lengths)
    if labels is None:
        labels = np.concatenate([np.arange(length) * 2 // length for length in lengths])
    return Stages(
        np.asarray(labels, np.int64),
        np.ones(n_frames),
        np.zeros(n_frames, bool),
        np.zeros(n_frames, bool),
        names,
        np.array(lengths),
        tuple(range(len(lengths))),
        np.concatenate([np.arange(length) / fps for length in lengths]),
        float(fps),
    )
