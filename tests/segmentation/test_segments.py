"""Labels as segments, against plain loops over ragged trajectories."""

from itertools import pairwise

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from dpmacro.segmentation.segments import (
    chain_labels,
    distinct,
    follows_chain,
    macro_segments,
    starting_macros,
    transition_counts,
)

LABELLED = st.lists(st.lists(st.integers(0, 2), min_size=1, max_size=8), min_size=1, max_size=5)


def tensors(parts):
    """Labels of all trajectories, and lengths."""
    return torch.tensor([label for part in parts for label in part]), torch.tensor([len(p) for p in parts])


def test_segments_know_what_follows():
    segments = macro_segments(torch.tensor([0, 0, 1, 1, 1, 0, 2, 2]), torch.tensor([5, 3]))
    seen = [(s.trajectory, s.macro, s.start, s.stop, s.following, s.following_stop) for s in segments]
    assert seen == [
        (0, 0, 0, 2, 1, 5),
        (0, 1, 2, 5, None, 5),
        (1, 0, 5, 6, 2, 8),
        (1, 2, 6, 8, None, 8),
    ]


@settings(deadline=None)
@given(LABELLED)
def test_segments_are_the_labels(parts):
    labels, lengths = tensors(parts)
    segments = macro_segments(labels, lengths)
    again = [label for one in segments for label in [one.macro] * (one.stop - one.start)]
    assert again == labels.tolist()
    for one, after in zip(segments, [*segments[1:], None], strict=True):
        if after is not None and after.trajectory == one.trajectory:
            assert (one.following, one.following_stop) == (after.macro, after.stop)
            assert one.stop == after.start and one.macro != after.macro
        else:
            assert (one.following, one.following_stop) == (None, one.stop)


@settings(deadline=None)
@given(LABELLED)
def test_a_trajectory_starts_with_its_first_label(parts):
    assert starting_macros(*tensors(parts)).tolist() == [part[0] for part in parts]


@settings(deadline=None)
@given(LABELLED)
def test_transitions_are_counted_within_trajectories(parts):
    wanted = [sum(a != b for a, b in pairwise(part)) for part in parts]
    assert transition_counts(*tensors(parts)).tolist() == wanted


@settings(deadline=None)
@given(st.integers(1, 4), st.data())
def test_a_chain_is_cut_where_its_cuts_say(n_macros, data):
    stage_lengths = st.lists(st.integers(1, 4), min_size=n_macros, max_size=n_macros)
    held = data.draw(st.lists(stage_lengths, min_size=1, max_size=4))
    cuts = torch.tensor(held).cumsum(1)[:, :-1]
    lengths = torch.tensor(held).sum(1)
    labels = chain_labels(cuts, lengths)
    assert labels.tolist() == [q for one in held for q, count in enumerate(one) for _ in range(count)]
    assert follows_chain(labels, lengths, n_macros)


@settings(deadline=None)
@given(LABELLED, st.integers(1, 3))
def test_a_chain_goes_through_all_macro_actions_in_their_order(parts, n_macros):
    wanted = all(
        part[0] == 0 and part[-1] == n_macros - 1 and all(b - a in (0, 1) for a, b in pairwise(part))
        for part in parts
    )
    assert follows_chain(*tensors(parts), n_macros) == wanted


@pytest.mark.parametrize("cuts", [[0, 2], [2, 2], [3, 2], [2, 5]])
def test_cuts_that_make_no_chain_are_named(cuts):
    with pytest.raises(ValueError, match=r"^cuts\[1\] are \[\d, \d\]: give 2 frames that rise within 1 to 4"):
        chain_labels(torch.tensor([[1, 3], cuts]), torch.tensor([4, 5]))


def test_distinct_keeps_the_first_of_a_group():
    base = torch.arange(200) // 100
    near = base.clone()
    near[0] = 1
    assert distinct(torch.stack([base, near, 1 - base, base])).tolist() == [0, 2]
