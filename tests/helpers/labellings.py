"""Pairs of labellings of ragged trajectories, drawn by hypothesis."""

import numpy as np
from hypothesis import strategies as st

NAMES = (-(2**63), -7, -1, 0, 1, 3, 50, 2**63 - 1)


@st.composite
def segmentations(draw, trajectories=3, longest=12, values=NAMES):
    """Labels, truth and lengths; labels are any integers, and may have too few or too many values."""
    lengths = draw(st.lists(st.integers(1, longest), min_size=1, max_size=trajectories))
    size = sum(lengths)
    sides = []
    for _ in range(2):
        names = draw(st.lists(st.sampled_from(values), min_size=1, max_size=5))
        frames = st.lists(st.sampled_from(names), min_size=size, max_size=size)
        sides.append(np.array(draw(frames), np.int64))
    return *sides, np.array(lengths)
