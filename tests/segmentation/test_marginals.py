"""Min-marginals against every labelling there is."""

import itertools

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from dpmacro.segmentation.marginals import costs_without, margins
from dpmacro.segmentation.recursion import segment

DEVICES = ["cpu", *(["cuda"] if torch.cuda.is_available() else [])]


def problem(lengths, n_macros, seed, changes):
    generator = torch.Generator().manual_seed(seed)
    n_frames = sum(lengths)
    costs = torch.rand(n_frames, n_macros, generator=generator, dtype=torch.float64)
    extra = torch.rand(n_frames, n_macros, n_macros, generator=generator, dtype=torch.float64) - 0.3
    return costs, torch.tensor(lengths), extra if changes else None


def brute_force(costs, bound, changes, reach):
    """V_n(q) of one trajectory, by the cost of every labelling with one transition at most around frame n."""
    n_frames, n_macros = costs.shape
    least = torch.full((n_frames, n_macros), torch.inf, dtype=torch.float64)
    for path in itertools.product(range(n_macros), repeat=n_frames):
        moves = [n for n in range(1, n_frames) if path[n] != path[n - 1]]
        if len(moves) > bound:
            continue
        own = torch.tensor([costs[n, q] for n, q in enumerate(path)])
        extra = 0.0 if changes is None else sum(float(changes[n, path[n - 1], path[n]]) for n in moves)
        for n, q in enumerate(path):
            first, last = n - reach - 1, n + reach + 1  # the frames beside those left out
            sides = (first >= 0) + (last < n_frames)
            within = sum(first < move <= last for move in moves)
            if reach and sides and within > sides - 1:
                continue
            left_out = own[max(0, n - reach) : n + reach + 1].sum()
            least[n, q] = min(least[n, q], own.sum() - left_out + extra)
    return least


@settings(max_examples=60, deadline=None)
@given(
    st.lists(st.integers(1, 5), min_size=1, max_size=3),
    st.integers(1, 3),
    st.integers(0, 5),
    st.integers(0, 2**31),
    st.sampled_from([(0, False), (0, True), (1, False), (2, False)]),
)
def test_costs_without_a_frame_are_those_of_the_best_labelling(lengths, n_macros, bound, seed, kind):
    reach, with_changes = kind
    costs, lengths, changes = problem(lengths, n_macros, seed, with_changes)
    found = costs_without(costs, lengths, bound, reach, changes)
    ends = lengths.cumsum(0).tolist()
    for start, end in zip([0, *ends[:-1]], ends, strict=True):
        part = None if changes is None else changes[start:end]
        wanted = brute_force(costs[start:end], bound, part, reach)
        torch.testing.assert_close(found[start:end], wanted)


@settings(max_examples=40, deadline=None)
@given(st.integers(3, 6), st.integers(2, 3), st.integers(0, 4), st.integers(0, 2**31), st.booleans())
def test_a_margin_is_the_price_of_another_label(n_frames, n_macros, bound, seed, with_changes):
    costs, lengths, changes = problem([n_frames, 2], n_macros, seed, with_changes)
    labels = segment(costs, lengths, bound, changes).labels
    found = margins(costs, lengths, bound, labels, changes)
    assert bool((found >= -1e-9).all())
    best = float(segment(costs, lengths, bound, changes).cost.sum())
    for n in range(n_frames):
        elsewhere = costs.clone()
        elsewhere[n, labels[n]] = 1e3
        price = float(segment(elsewhere, lengths, bound, changes).cost.sum()) - best
        assert float(found[n]) == pytest.approx(price, abs=1e-9)


@pytest.mark.parametrize("bound", [1, 2, 3, 5])
def test_slack_in_the_bound_hides_no_excursion(bound):
    """Labels of frames from the frames around them, where the truth needs one transition of `bound`."""
    truth = torch.arange(60) // 30
    costs = torch.nn.functional.one_hot(1 - truth, 2).double() + 0.1
    found = costs_without(costs, torch.tensor([60]), bound, 5).argmin(1)
    clear = (torch.arange(60) - 29.5).abs() > 6  # nearer, the change lies among the frames left out
    assert torch.equal(found[clear], truth[clear])


@pytest.mark.parametrize("device", DEVICES)
def test_ragged_trajectories_do_not_see_one_another(device):
    costs, lengths, _ = problem([7, 3, 11], 3, 5, False)
    together = costs_without(costs.to(device), lengths, 2, 1).cpu()
    for start, end in [(0, 7), (7, 10), (10, 21)]:
        alone = costs_without(costs[start:end], torch.tensor([end - start]), 2, 1)
        torch.testing.assert_close(together[start:end], alone)


def test_one_macro_action_has_no_other_label():
    costs, lengths, _ = problem([4], 1, 0, False)
    assert margins(costs, lengths, 2, torch.zeros(4, dtype=torch.int64)).isinf().all()


def test_a_reach_needs_free_transitions():
    costs, lengths, changes = problem([4], 2, 0, True)
    with pytest.raises(ValueError, match="reach is 1"):
        costs_without(costs, lengths, 1, 1, changes)


def test_transition_costs_of_first_frames_are_not_read():
    costs, lengths, changes = problem([4, 1, 5], 3, 0, True)
    wanted = costs_without(costs, lengths, 2, 0, changes)
    changes[[0, 4, 5]] = torch.nan
    assert torch.equal(costs_without(costs, lengths, 2, 0, changes), wanted)
