"""Chains against enumeration of every chain: segmentation, margins, and the costs without frames."""

import itertools

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from dpmacro.segmentation.marginals import costs_without, margins
from dpmacro.segmentation.recursion import cost_of, segment
from dpmacro.segmentation.segments import follows_chain, starting_macros, transition_counts

DEVICES = ["cpu", *(["cuda"] if torch.cuda.is_available() else [])]


@st.composite
def problems(draw, longest=8, most_macros=4):
    """Costs of ragged trajectories that hold a chain, and transition costs or None; NaN must not be read."""
    n_macros = draw(st.integers(1, most_macros))
    lengths = draw(st.lists(st.integers(n_macros, longest), min_size=1, max_size=3))
    generator = torch.Generator().manual_seed(draw(st.integers(0, 2**31)))
    size = (sum(lengths), n_macros)
    if draw(st.booleans()):
        costs = torch.randn(size, generator=generator, dtype=torch.float64)
    else:
        costs = torch.randint(-2, 3, size, generator=generator).double()
    if not draw(st.booleans()):
        return costs, torch.tensor(lengths), None
    changes = torch.full((*size, n_macros), torch.nan, dtype=torch.float64)
    for q in range(1, n_macros):
        changes[:, q - 1, q] = torch.randn(sum(lengths), generator=generator, dtype=torch.float64)
    changes[torch.tensor(lengths).cumsum(0) - torch.tensor(lengths)] = torch.nan
    return costs, torch.tensor(lengths), changes


def parts_of(costs, lengths, changes):
    """The costs, the transition costs and the first and last frame of every trajectory."""
    ends = lengths.cumsum(0).tolist()
    for start, end in zip([0, *ends[:-1]], ends, strict=True):
        yield costs[start:end], None if changes is None else changes[start:end], start, end


def every_chain(n_frames, n_macros):
    """All labellings 0, ..., Q - 1 with the frames at which they change."""
    for cuts in itertools.combinations(range(1, n_frames), n_macros - 1):
        yield [sum(cut <= n for cut in cuts) for n in range(n_frames)], cuts


def price(labels, cuts, costs, changes, left_out=range(0)):
    """What a chain costs at all frames but some."""
    total = sum(float(costs[n, q]) for n, q in enumerate(labels) if n not in left_out)
    return total + (0 if changes is None else sum(float(changes[n, labels[n] - 1, labels[n]]) for n in cuts))


def least_through(costs, changes, reach=None):
    """The least cost of any chain through every label of every frame; V_n(q) if `reach` is given."""
    n_frames, n_macros = costs.shape
    least = torch.full((n_frames, n_macros), torch.inf, dtype=torch.float64)
    for n in range(n_frames):
        gap = range(0) if reach is None else range(n - reach, n + reach + 1)
        within = range(n - reach, n + reach + 2) if reach else range(0)  # where changes touch left-out frames
        chains = list(every_chain(n_frames, n_macros))
        calm = [(labels, cuts) for labels, cuts in chains if sum(cut in within for cut in cuts) <= 1]
        assert calm or n_frames < n_macros - 1 + 2 * reach + 2
        for labels, cuts in calm or chains:
            q = labels[n]
            least[n, q] = min(float(least[n, q]), price(labels, cuts, costs, changes, gap))
    return least


@pytest.mark.parametrize("device", DEVICES)
@settings(max_examples=100, deadline=None)
@given(problem=problems())
def test_the_cheapest_chain_is_that_of_enumeration(device, problem):
    costs, lengths, changes = problem
    n_macros = costs.shape[1]
    given_changes = None if changes is None else changes.to(device)
    found = segment(costs.to(device), lengths, n_macros - 1, given_changes, order="chain")
    assert follows_chain(found.labels, lengths, n_macros)
    assert found.cost.dtype == torch.float64
    assert torch.equal(found.cost_by_bound, found.cost[:, None])
    labels = found.labels.tolist()
    for i, (own, changing, start, end) in enumerate(parts_of(costs, lengths, changes)):
        prices = {cuts: price(path, cuts, own, changing) for path, cuts in every_chain(len(own), n_macros)}
        least = min(prices.values())
        assert float(found.cost[i]) == pytest.approx(least, abs=1e-9)
        cuts = tuple(n for n in range(1, end - start) if labels[start + n] != labels[start + n - 1])
        assert prices[cuts] == pytest.approx(least, abs=1e-9)
        if changes is None and bool((costs == costs.round()).all()):
            ties = [one for one, cost in prices.items() if cost == least]
            assert cuts == min(ties, key=lambda one: one[::-1]), "the last transition as early as it can be"
    total = cost_of(found.labels.cpu(), costs, lengths, changes)
    assert float(total) == pytest.approx(float(found.cost.sum()), abs=1e-9)


@settings(max_examples=80, deadline=None)
@given(problems(longest=7))
def test_a_margin_is_the_price_of_another_chain(problem):
    costs, lengths, changes = problem
    bound = costs.shape[1] - 1
    labels = segment(costs, lengths, bound, changes, "chain").labels
    found = margins(costs, lengths, bound, labels, changes, "chain")
    for own, changing, start, end in parts_of(costs, lengths, changes):
        least = least_through(own, changing)
        taken = torch.nn.functional.one_hot(labels[start:end], bound + 1).bool()
        wanted = least.masked_fill(taken, torch.inf).amin(1) - least[taken]
        torch.testing.assert_close(found[start:end], wanted)
        assert found[start].isinf() and found[end - 1].isinf()


@settings(max_examples=120, deadline=None)
@given(problems(), st.integers(0, 3))
def test_costs_without_frames_are_those_of_the_best_chain(problem, reach):
    costs, lengths, changes = problem
    changes = None if reach else changes
    found = costs_without(costs, lengths, costs.shape[1] - 1, reach, changes, "chain")
    for own, changing, start, end in parts_of(costs, lengths, changes):
        torch.testing.assert_close(found[start:end], least_through(own, changing, reach))


@pytest.mark.parametrize("with_changes", [False, True])
def test_many_long_trajectories_are_their_segmentations_one_by_one(with_changes):
    """More than one portion of padded trajectories."""
    generator = torch.Generator().manual_seed(0)
    lengths = torch.randint(4, 2000, (60,), generator=generator)
    costs = torch.randn(int(lengths.sum()), 4, generator=generator)
    changes = torch.randn(len(costs), 4, 4, generator=generator) if with_changes else None
    together = segment(costs, lengths, 3, changes, "chain")
    sure = margins(costs, lengths, 3, together.labels, changes, "chain")
    for i, (own, changing, start, end) in enumerate(parts_of(costs, lengths, changes)):
        alone = segment(own, [end - start], 3, changing, "chain")
        assert torch.equal(together.labels[start:end], alone.labels)
        torch.testing.assert_close(together.cost[i], alone.cost[0])
        again = margins(own, torch.tensor([end - start]), 3, alone.labels, changing, "chain")
        torch.testing.assert_close(sure[start:end], again)


def test_a_chain_costs_no_less_than_the_cheapest_labels_in_any_order():
    generator = torch.Generator().manual_seed(0)
    costs = torch.randn(500, 4, generator=generator)
    lengths = torch.tensor([200, 300])
    free, chain = segment(costs, lengths, 3), segment(costs, lengths, 3, order="chain")
    assert bool((free.cost <= chain.cost).all())
    assert transition_counts(chain.labels, lengths).tolist() == [3, 3]
    assert starting_macros(chain.labels, lengths).tolist() == [0, 0]


def test_a_trajectory_of_one_frame_a_stage_has_one_chain():
    costs, lengths = torch.rand(9, 3), torch.tensor([3, 3, 3])
    labels = segment(costs, lengths, 2, order="chain").labels
    assert labels.tolist() == [0, 1, 2] * 3
    assert margins(costs, lengths, 2, labels, order="chain").isinf().all()


@pytest.mark.parametrize(
    ("macros", "lengths", "bound", "message"),
    [
        (
            3,
            [4, 2, 1],
            2,
            r"^lengths\[1\] is 2: a chain of 3 macro-actions needs as many frames .* give 1 macro",
        ),
        (3, [4, 4], 1, r"^max_transitions is 1: give 2, one less than the macro-actions of costs"),
        (3, [4, 4], 3, r"^max_transitions is 3: give 2"),
    ],
)
def test_what_holds_no_chain_is_named(macros, lengths, bound, message):
    costs = torch.zeros(sum(lengths), macros)
    for ask in (segment, costs_without):
        with pytest.raises(ValueError, match=message):
            ask(costs, torch.tensor(lengths), bound, order="chain")


def test_a_transition_cost_that_a_chain_reads_is_finite():
    changes = torch.zeros(4, 3, 3)
    changes[0] = changes[:, 2, 0] = torch.nan
    changes[2, 1, 2] = torch.inf
    with pytest.raises(ValueError, match=r"^transition_costs\[2, 1, 2\] is inf"):
        segment(torch.zeros(4, 3), [4], 2, changes, "chain")


def test_margins_are_those_of_a_chain():
    with pytest.raises(ValueError, match=r"^labels are no chain of 2 macro-actions"):
        margins(torch.zeros(3, 2), torch.tensor([3]), 1, torch.tensor([0, 1, 0]), order="chain")
