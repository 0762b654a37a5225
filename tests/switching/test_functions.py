"""Switch functions as they run: what they choose, after which actions they may fire, where a run starts."""

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from visible import functions_of

from dpmacro.switching.functions import causal_labels, cued, predicted_labels

PAIRS = ((0, 1), (0, 2), (1, 0), (2, 1))


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


def test_causal_labels_take_the_first_firing_and_the_strongest_of_several():
    scores = torch.tensor([[0.0, 0, 0], [1, 2, 0], [0, 0, 5], [0, 0, 5], [0, 0, 0]])
    pairs, first = ((0, 1), (0, 2), (2, 0)), torch.tensor([0, 0])
    assert causal_labels(scores - 0.5, pairs, torch.tensor([3, 2]), first).tolist() == [0, 2, 0, 0, 0]


def test_every_trajectory_starts_with_its_own_macro_action():
    margins = torch.tensor([[-1.0, -1], [1, 1], [-1, -1], [-1, -1], [-1, 1], [1, -1]])
    found = causal_labels(margins, ((0, 1), (1, 0)), torch.tensor([3, 3]), torch.tensor([0, 1]))
    assert found.tolist() == [0, 1, 1, 1, 0, 1]
    assert causal_labels(margins[:, :0], (), torch.tensor([3, 3]), torch.tensor([0, 1])).tolist() == [
        *[0] * 3,
        *[1] * 3,
    ]


@settings(max_examples=60, deadline=None)
@given(
    st.lists(st.integers(1, 9), min_size=1, max_size=4),
    st.integers(0, 2**16),
    st.sampled_from([(), ((0,), (1,), (0, 1), (1, 2))]),
)
def test_a_policy_that_sees_demonstrations_follows_its_own_actions(lengths, seed, cues):
    """Frame by frame: fire after one's own last action, act by the macro-action of the moment."""
    generator = torch.Generator().manual_seed(seed)
    scores = torch.randn(sum(lengths), 3, 3, generator=generator)
    margins = torch.randn(sum(lengths), len(PAIRS), generator=generator)
    first = torch.randint(0, 3, (len(lengths),), generator=generator)
    found = predicted_labels(scores, margins, PAIRS, cues, torch.tensor(lengths), first)
    labels, actions, frame = [], [], 0
    for length, macro in zip(lengths, first.tolist(), strict=True):
        last = None
        for _ in range(length):
            ready = [
                (float(margins[frame, k]), target)
                for k, (source, target) in enumerate(PAIRS)
                if source == macro and margins[frame, k] > 0 and (not cues or last in cues[k])
            ]
            macro = max(ready)[1] if ready else macro
            last = int(scores[frame, macro].argmax())
            labels.append(macro)
            actions.append(last)
            frame += 1
    assert [found[0].tolist(), found[1].argmax(1).tolist()] == [labels, actions]


def test_without_switch_functions_a_run_stays_where_it_starts():
    scores = torch.tensor([[[1.0, 0], [0, 1]]]).repeat(5, 1, 1)
    found = predicted_labels(scores, torch.zeros(5, 0), (), (), torch.tensor([2, 3]), torch.tensor([1, 0]))
    assert [found[0].tolist(), found[1].argmax(1).tolist()] == [[1, 1, 0, 0, 0]] * 2


@pytest.mark.parametrize(("shares", "mean"), [([], 0.0), ([0.25, 0.75], 0.5)])
def test_the_mean_share_of_no_switch_function_is_0(shares, mean):
    pairs = PAIRS[: len(shares)]
    switches = functions_of(torch.zeros(4, len(shares)), pairs, recognised=torch.tensor(shares))
    assert switches.mean_recognised == mean
