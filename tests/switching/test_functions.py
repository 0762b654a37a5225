"""Switch functions as they run: segments, what they choose, after which actions they may fire."""

import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from dpmacro.switching.functions import causal_labels, cued, macro_segments, starting_macro


@settings(deadline=None)
@given(st.lists(st.lists(st.integers(0, 3), min_size=1, max_size=6), min_size=1, max_size=5))
def test_cues_do_not_reach_over_the_end_of_a_trajectory(parts):
    lengths = torch.tensor([len(part) for part in parts])
    actions = torch.tensor([action for part in parts for action in part])
    found = cued(actions, lengths, ((0, 2), (1,))).tolist()
    wanted = [
        [place > 0 and part[place - 1] in own for own in ((0, 2), (1,))]
        for part in parts
        for place in range(len(part))
    ]
    assert found == wanted


def test_segments_know_what_follows():
    events = macro_segments(torch.tensor([0, 0, 1, 1, 1, 0, 2, 2]), torch.tensor([5, 3]))
    seen = [(e.trajectory, e.macro, e.start, e.stop, e.following, e.following_stop) for e in events]
    assert seen == [
        (0, 0, 0, 2, 1, 5),
        (0, 1, 2, 5, None, 5),
        (1, 0, 5, 6, 2, 8),
        (1, 2, 6, 8, None, 8),
    ]


def test_causal_labels_take_the_first_firing_and_the_strongest_of_several():
    scores = torch.tensor([[0.0, 0, 0], [1, 2, 0], [0, 0, 5], [0, 0, 5], [0, 0, 0]])
    labels = causal_labels(
        scores, torch.tensor([0.5, 0.5, 0.5]), [(0, 1), (0, 2), (2, 0)], torch.tensor([3, 2]), 0
    )
    assert labels.tolist() == [0, 2, 0, 0, 0]


def test_the_starting_macro_is_the_most_common_first_label():
    assert starting_macro(torch.tensor([1, 0, 1, 2, 2, 0]), torch.tensor([2, 1, 3])) == 1
