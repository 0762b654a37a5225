"""Initial segmentations keep the bound and cut where they say."""

import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from dpmacro.discovery.starts import (
    action_events,
    feature_peaks,
    initial_segmentations,
    random_cuts,
    uniform_cuts,
)
from dpmacro.features.levels import SortedLevels
from dpmacro.segmentation.segments import transition_counts


@settings(max_examples=25, deadline=None)
@given(
    lengths=st.lists(st.integers(1, 30), min_size=1, max_size=4),
    macros=st.integers(1, 4),
    bound=st.integers(0, 5),
    seed=st.integers(0, 999),
)
def test_the_bound_holds_and_a_seed_repeats(lengths, macros, bound, seed):
    levels = torch.randint(0, 256, (9, sum(lengths)), dtype=torch.uint8)
    actions = torch.randint(0, 4, (sum(lengths),))
    lengths = torch.tensor(lengths)
    for start in (
        lambda g: action_events(actions, lengths, 3, macros, bound, g),
        lambda g: initial_segmentations(SortedLevels.unsorted(levels), actions, lengths, 3, macros, bound, g),
        lambda g: uniform_cuts(lengths, macros, bound).expand(3, -1),
        lambda g: random_cuts(lengths, 3, macros, bound, g),
        lambda g: feature_peaks(SortedLevels.unsorted(levels), lengths, 3, macros, bound, g),
        lambda g: feature_peaks(SortedLevels.unsorted(levels), lengths, 3, macros, bound, g, actions),
    ):
        labels = start(torch.Generator().manual_seed(seed))
        assert torch.equal(labels, start(torch.Generator().manual_seed(seed)))
        assert labels.shape == (3, int(lengths.sum()))
        assert set(labels.unique().tolist()) <= set(range(macros))
        for row in labels:
            assert (transition_counts(row, lengths) <= bound).all()


def test_feature_peaks_cut_where_a_feature_is_extreme():
    levels = torch.tensor([[5, 9, 1, 9, 4, 2, 7, 0, 7, 3]], dtype=torch.uint8)
    labels = feature_peaks(
        SortedLevels.unsorted(levels), torch.tensor([5, 5]), 40, 2, 1, torch.Generator().manual_seed(0)
    )
    starts = {tuple(row.tolist()) for row in labels}
    assert starts == {(0, 1, 1, 1, 1, 0, 1, 1, 1, 1), (0, 0, 1, 1, 1, 0, 0, 1, 1, 1)}


def test_feature_peaks_may_be_cut_only_where_the_action_changes():
    levels = torch.tensor([[5, 9, 1, 9, 4, 2, 7, 0, 7, 3]], dtype=torch.uint8)
    actions = torch.tensor([0, 0, 1, 1, 2, 2, 2, 2, 2, 2])
    generator = torch.Generator().manual_seed(0)
    labels = feature_peaks(SortedLevels.unsorted(levels), torch.tensor([5, 5]), 40, 2, 1, generator, actions)
    # The second trajectory, where no action follows another, is cut anywhere.
    starts = {tuple(row.tolist()) for row in labels}
    assert starts == {(0, 0, 0, 0, 1, 0, 1, 1, 1, 1), (0, 0, 1, 1, 1, 0, 0, 1, 1, 1)}


def test_uniform_cuts_are_equally_far_apart():
    assert uniform_cuts(torch.tensor([6, 3]), 2, 2).tolist() == [[0, 0, 1, 1, 0, 0, 0, 1, 0]]


def test_rare_actions_make_or_end_a_subtask():
    # 3 is a grasp, 4 a release: once each in either trajectory.
    actions = torch.tensor([0, 0, 0, 3, 0, 0, 4, 0, 0, 0, 3, 3, 0, 4])
    lengths = torch.tensor([7, 7])
    during, after = action_events(actions, lengths, 2, 3, 4, torch.Generator().manual_seed(0))
    grasp, release = during[3], during[6]
    assert {int(grasp), int(release)} == {1, 2}
    assert torch.equal(during, (actions == 3) * grasp + (actions == 4) * release)
    # 3, taken twice in a row, ends one subtask only.
    assert after.tolist() == [0, 0, 0, 0, 1, 1, 1, 0, 0, 0, 0, 0, 1, 1]


def test_one_action_alone_has_no_events():
    labels = action_events(torch.zeros(5, dtype=torch.int64), torch.tensor([5]), 4, 3, 2, torch.Generator())
    assert labels.shape == (4, 5)
    assert (labels == 0).all()


def test_as_many_starts_as_restarts():
    levels = torch.randint(0, 256, (9, 40), dtype=torch.uint8)
    actions = torch.randint(0, 3, (40,))
    for restarts in (1, 2, 3, 4, 5, 32):
        starts = initial_segmentations(
            SortedLevels.unsorted(levels),
            actions,
            torch.tensor([25, 15]),
            restarts,
            2,
            1,
            torch.Generator().manual_seed(0),
        )
        assert starts.shape == (restarts, 40)
