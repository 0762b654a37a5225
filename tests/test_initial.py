"""Initial segmentations keep the bound and cut where they say."""

import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from dpmacro.initial import feature_peaks, random_cuts
from dpmacro.segmentation import transition_counts


@settings(max_examples=25, deadline=None)
@given(
    lengths=st.lists(st.integers(1, 30), min_size=1, max_size=4),
    macros=st.integers(1, 4),
    bound=st.integers(0, 5),
    seed=st.integers(0, 999),
)
def test_the_bound_holds_and_a_seed_repeats(lengths, macros, bound, seed):
    levels = torch.randint(0, 256, (9, sum(lengths)), dtype=torch.uint8)
    lengths = torch.tensor(lengths)
    for start in (
        lambda g: random_cuts(lengths, 3, macros, bound, g),
        lambda g: feature_peaks(levels, lengths, 3, macros, bound, g),
    ):
        labels = start(torch.Generator().manual_seed(seed))
        assert torch.equal(labels, start(torch.Generator().manual_seed(seed)))
        assert labels.shape == (3, int(lengths.sum()))
        assert set(labels.unique().tolist()) <= set(range(macros))
        for row in labels:
            assert (transition_counts(row, lengths) <= bound).all()


def test_feature_peaks_cut_where_a_feature_is_extreme():
    levels = torch.tensor([[5, 9, 1, 9, 4, 2, 7, 0, 7, 3]], dtype=torch.uint8)
    labels = feature_peaks(levels, torch.tensor([5, 5]), 40, 2, 1, torch.Generator().manual_seed(0))
    starts = {tuple(row.tolist()) for row in labels}
    assert starts == {(0, 1, 1, 1, 1, 0, 1, 1, 1, 1), (0, 0, 1, 1, 1, 0, 0, 1, 1, 1)}
