"""Sorted columns against a plain count of every level."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from dpmacro.features import levels as module
from dpmacro.features.levels import SortedLevels

DEVICES = ["cpu", *(["cuda"] if torch.cuda.is_available() else [])]


@pytest.fixture(params=[module.BLOCK, 7], autouse=True)
def blocks(request):
    """Frames are sorted in blocks, here of few."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "BLOCK", request.param)
        yield


def listed(chunk, k, place):
    """The frames that a chunk lists in a bin of its k-th column, ascending where their levels are equal."""
    found, bag = [], k * chunk.thresholds.shape[1] + place
    for order, starts in chunk.entries:
        edges = [*starts.flatten().tolist(), len(order)]
        found += order[edges[bag] : edges[bag + 1]].tolist()
    return found


def bins_of(data, size):
    """{column: {level: frames}} as the chunks list them; the fullest bin as None."""
    found, column = {}, 0
    for chunk in data.chunks(size):
        columns, width = chunk.thresholds.shape
        for k in range(columns):
            lists = [listed(chunk, k, place) for place in range(width)]
            count = int(data.counts[column])
            assert not any(lists[count:]), "a bin that the column lacks lists frames"
            bins = dict(zip(chunk.thresholds[k, :count].tolist(), lists[:count], strict=True))
            full = int(chunk.thresholds[k, chunk.fullest[k]])
            assert bins[full] == []
            bins[full] = None
            found[int(data.columns[column])] = bins
            column += 1
    return found


@pytest.mark.parametrize("device", DEVICES)
@settings(max_examples=20, deadline=None)
@given(
    seed=st.integers(0, 2**16),
    n_columns=st.integers(1, 150),
    n_frames=st.integers(1, 60),
    n_levels=st.sampled_from([1, 3, 256]),
    size=st.sampled_from([1, 7, 128]),
)
def test_every_frame_is_listed_once_in_the_bin_of_its_level(
    device, seed, n_columns, n_frames, n_levels, size
):
    levels = np.random.default_rng(seed).integers(0, n_levels, (n_columns, n_frames)).astype(np.uint8)
    data = SortedLevels.build(torch.tensor(levels, device=device))
    for column, bins in bins_of(data, size).items():
        expected = {level: np.flatnonzero(levels[column] == level).tolist() for level in set(levels[column])}
        full = max(expected, key=lambda level: (len(expected[level]), -int(level)))
        assert list(bins) == sorted(expected)
        assert bins == {**expected, full: None}


def test_taken_columns_are_the_same_sorted_before_or_then():
    levels = torch.randint(0, 256, (90, 50), dtype=torch.uint8, generator=torch.Generator().manual_seed(0))
    columns = torch.tensor([3, 4, 40, 89])
    whole = bins_of(SortedLevels.build(levels), 16)
    for data in (SortedLevels.build(levels), SortedLevels.unsorted(levels)):
        assert bins_of(data.take(columns), 3) == {int(column): whole[int(column)] for column in columns}


@settings(max_examples=30, deadline=None)
@given(
    seed=st.integers(0, 2**16),
    n_columns=st.integers(1, 9),
    n_frames=st.integers(1, 300),
    n_levels=st.sampled_from([1, 3, 20, 256]),
    size=st.sampled_from([1, 4, 128]),
    most=st.integers(1, 40),
)
def test_bins_side_by_side_are_taken_together(seed, n_columns, n_frames, n_levels, size, most):
    generator = np.random.default_rng(seed)
    levels = generator.integers(0, generator.integers(1, n_levels + 1, (n_columns, 1)), (n_columns, n_frames))
    data = SortedLevels.build(torch.tensor(levels.astype(np.uint8)))
    column = 0
    for chunk in data.chunks(size, most):
        columns, width = chunk.thresholds.shape
        assert width <= most
        for k in range(columns):
            present = np.unique(levels[column])
            together = -(-len(present) // most)
            groups = [present[first : first + together] for first in range(0, len(present), together)]
            full = max(present, key=lambda level: ((levels[column] == level).sum(), -level))
            for place in range(width):
                group = groups[place] if place < len(groups) else []
                own = np.flatnonzero(np.isin(levels[column], group) & (levels[column] != full))
                assert sorted(listed(chunk, k, place)) == own.tolist()
                if place < len(groups):
                    assert int(chunk.thresholds[k, place]) == group[-1]
                    assert (full in group) == (place == int(chunk.fullest[k]))
            column += 1
    assert column == n_columns


@given(
    counts=st.lists(st.integers(1, 60), min_size=1, max_size=4),
    count=st.integers(1, 100),
    seed=st.integers(0, 2**16),
)
def test_draws_are_shared_out_among_kinds_of_columns(counts, count, seed):
    kinds = torch.cat([torch.full((own,), kind) for kind, own in enumerate(counts)])
    kinds = kinds[torch.randperm(len(kinds), generator=torch.Generator().manual_seed(seed))]
    levels = torch.zeros(len(kinds), 2, dtype=torch.uint8)
    for data in (SortedLevels.build(levels, kinds=kinds), SortedLevels.unsorted(levels, kinds)):
        drawn = data.drawn(count, torch.Generator().manual_seed(seed))
        assert drawn.tolist() == sorted({*drawn.tolist()}) and len(drawn) == min(count, len(kinds))
        of_kind = torch.bincount(kinds[drawn], minlength=len(counts)).tolist()
        for own, most in zip(of_kind, counts, strict=True):
            assert own == most or own >= max(of_kind) - 1  # all of them, or as many as of any other
    alike = SortedLevels.unsorted(levels, torch.zeros_like(kinds))
    bare = SortedLevels.unsorted(levels)
    one, other = (each.drawn(count, torch.Generator().manual_seed(seed)) for each in (alike, bare))
    assert torch.equal(one, other)
