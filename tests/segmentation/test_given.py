"""Given labels against enumeration of every labelling that keeps to them."""

import itertools

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from refusals import refused

from dpmacro.segmentation.given import FREE, GivenLabels
from dpmacro.segmentation.marginals import margins
from dpmacro.segmentation.recursion import cost_of, segment
from dpmacro.segmentation.segments import follows_chain, transition_counts

DEVICES = ["cpu", *(["cuda"] if torch.cuda.is_available() else [])]


def every_labelling(n_frames, macros, bound, order):
    """All labellings within the bound, or all chains."""
    for labels in itertools.product(range(macros), repeat=n_frames):
        steps = np.diff(labels)
        if order == "chain":
            if labels[0] == 0 and labels[-1] == macros - 1 and set(steps) <= {0, 1}:
                yield labels
        elif np.count_nonzero(steps) <= bound:
            yield labels


def allowed(known, lengths, macros, bound, order):
    """For every trajectory the labellings that keep to what is given."""
    parts = np.split(np.array(known), np.cumsum(lengths)[:-1])
    return [
        [
            labels
            for labels in every_labelling(len(part), macros, bound, order)
            if all(label in (own, FREE) for own, label in zip(labels, part.tolist(), strict=True))
        ]
        for part in parts
    ]


@st.composite
def problems(draw, longest=6):
    """Given labels, mostly such as can be kept, with costs of very different sizes."""
    order = draw(st.sampled_from(["free", "chain"]))
    macros = draw(st.integers(1, 3))
    bound = macros - 1 if order == "chain" else draw(st.integers(0, 3))
    least = macros if order == "chain" else 1
    lengths = draw(st.lists(st.integers(least, longest), min_size=1, max_size=3))
    labels = []
    for length in lengths:
        one = draw(st.sampled_from(list(every_labelling(length, macros, bound, order))))
        kept = draw(st.lists(st.booleans(), min_size=length, max_size=length))
        labels += [label if keep else FREE for label, keep in zip(one, kept, strict=True)]
    if draw(st.integers(0, 3)) == 0:  # one label as it comes, which may be in no labelling
        labels[draw(st.integers(0, len(labels) - 1))] = draw(st.integers(0, macros - 1))
    rng = np.random.default_rng(draw(st.integers(0, 2**31)))
    size, scale = (sum(lengths), macros), 10.0 ** draw(st.integers(-9, 9))
    integers = draw(st.booleans())
    costs = rng.integers(-2, 3, size).astype(float) if integers else rng.normal(size=size)
    changes = rng.normal(size=(*size, macros)) * scale if draw(st.booleans()) else None
    if changes is not None:  # neither is ever read
        changes[:, range(macros), range(macros)] = np.nan
        changes[np.cumsum([0, *lengths[:-1]])] = np.nan
    changes = None if changes is None else torch.from_numpy(changes)
    return labels, lengths, macros, bound, order, torch.from_numpy(costs * scale), changes


@pytest.mark.parametrize("device", DEVICES)
@settings(max_examples=250, deadline=None)
@given(problem=problems())
def test_the_cheapest_labels_that_keep_to_what_is_given(device, problem):
    known, lengths, macros, bound, order, costs, changes = problem
    choices = allowed(known, lengths, macros, bound, order)
    if not all(choices):
        place = next(place for place, one in enumerate(choices) if not one)
        with pytest.raises(ValueError, match=rf"^demonstration {place}: [^\n]+$"):
            GivenLabels.of(known, lengths, macros, bound, order)
        return
    labels = GivenLabels.of(known, lengths, macros, bound, order)
    own, changing = costs.to(device), None if changes is None else changes.to(device)
    found = segment(labels.costs(own, changing), lengths, bound, changing, order)
    held = torch.tensor(known) != FREE
    assert torch.equal(found.labels.cpu()[held], torch.tensor(known)[held])
    ends = np.cumsum(lengths)
    for place, (end, length) in enumerate(zip(ends.tolist(), lengths, strict=True)):
        part = slice(end - length, end)
        within = costs[part], torch.tensor([length]), None if changes is None else changes[part]
        least = min(float(cost_of(torch.tensor(one), *within)) for one in choices[place])
        paid = float(cost_of(found.labels.cpu()[part], *within))
        assert paid == pytest.approx(least, rel=1e-9, abs=1e-9 * float(costs.abs().max()))
        assert float(found.cost[place]) == pytest.approx(paid, rel=1e-9, abs=1e-9 * float(costs.abs().max()))
        assert found.labels[part].tolist() in [list(one) for one in choices[place]]


@settings(max_examples=100, deadline=None)
@given(problems(), st.integers(0, 2**31), st.booleans())
def test_the_nearest_labelling_differs_on_the_fewest_frames(problem, seed, rename):
    known, lengths, macros, bound, order, _, _ = problem
    choices = allowed(known, lengths, macros, bound, order)
    if not all(choices):
        return
    labels = GivenLabels.of(known, lengths, macros, bound, order)
    generator = torch.Generator().manual_seed(seed)
    starts = torch.randint(macros, (3, sum(lengths)), generator=generator)
    found = labels.nearest(starts, rename)
    for own, start in zip(found, starts, strict=True):
        fewest = []
        for names in itertools.permutations(range(macros)) if rename else [range(macros)]:
            named = torch.tensor(names)[start]
            agreeing = int((named == torch.tensor(known)).sum())
            parts = zip(choices, named.split(lengths), strict=True)
            differing = sum(
                min(int((torch.tensor(one) != part).sum()) for one in some) for some, part in parts
            )
            fewest.append((-agreeing, differing, tuple(named.tolist())))
        best = min(fewest)[0]
        wanted = {(differing, named) for agreeing, differing, named in fewest if agreeing == best}
        assert any(int((own != torch.tensor(named)).sum()) == differing for differing, named in wanted)


def test_what_is_filled_in_needs_the_fewest_transitions_or_is_the_latest_chain():
    known = [FREE, 2, FREE, FREE, 0, FREE, FREE, FREE, 1]
    assert GivenLabels.of(known, [6, 3], 3, 1).filled.tolist() == [2, 2, 2, 2, 0, 0, 1, 1, 1]
    assert GivenLabels.of([FREE] * 4, [4], 2, 0).filled.tolist() == [0] * 4
    chain = GivenLabels.of([FREE, FREE, FREE, 1, FREE, FREE], [6], 3, 2, "chain")
    assert chain.filled.tolist() == [0, 0, 0, 1, 1, 2]
    assert chain.held.tolist() == [False, False, False, True, False, False]


@pytest.mark.parametrize("order", ["free", "chain"])
def test_long_trajectories_with_a_dear_frame_are_cut_where_they_should_be(order):
    """Thousands of held frames, and one that costs a million times as much, spare the others' digits."""
    lengths, generator = torch.tensor([30_000, 3_000]), torch.Generator().manual_seed(0)
    costs = torch.rand(33_000, 2, generator=generator, dtype=torch.float64)
    costs[10, 0], costs[15_000:30_000, 0] = 1e6, costs[15_000:30_000, 0] + 1e-3
    costs[10, 1] += 1e6
    known = torch.full((33_000,), FREE)
    known[:12_000], known[20_000:30_000] = 0, 1
    labels = GivenLabels.of(known, lengths, 2, 1, order)
    found = segment(labels.costs(costs), lengths, 1, order=order)
    sums = (costs[:, 0] - costs[:, 1])[12_000:20_000].cumsum(0)
    cut = 12_000 + 1 + int(sums.argmin()) if float(sums.min()) < 0 else 12_000
    assert follows_chain(found.labels[:30_000], lengths[:1], 2)
    assert int((found.labels[:30_000] == 0).sum()) == cut
    alone = segment(costs[30_000:], lengths[1:], 1, order=order)
    assert torch.equal(found.labels[30_000:], alone.labels), "where nothing is given nothing changes"


def test_costs_are_left_alone_where_nothing_is_given():
    costs = torch.rand(5, 3)
    free = GivenLabels.of([FREE] * 5, [2, 3], 3, 1)
    assert torch.equal(free.costs(costs), costs.double())


def test_frames_several_times_over_are_restarts_side_by_side():
    known, lengths = [0, FREE, FREE, 1, FREE, FREE], torch.tensor([4, 2])
    labels = GivenLabels.of(known, lengths, 2, 1)
    costs = torch.randn(3, 6, 2, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    together = segment(labels.costs(costs.flatten(0, 1)), lengths.repeat(3), 1).labels.view(3, 6)
    alone = [segment(labels.costs(one), lengths, 1).labels for one in costs]
    assert torch.equal(together, torch.stack(alone))


def test_a_margin_of_a_free_frame_is_the_price_among_labellings_that_keep_to_what_is_given():
    known = [0, FREE, FREE, FREE, 1]
    labels = GivenLabels.of(known, [5], 2, 1)
    costs = torch.tensor([[0.0, 9], [0, 1], [0, 2], [4, 0], [9, 0]])
    held = labels.costs(costs)
    found = segment(held, [5], 1).labels
    sure = margins(held, torch.tensor([5]), 1, found)
    assert found.tolist() == [0, 0, 0, 1, 1]
    assert sure[1:4].tolist() == [3, 2, 4], "1 with 2 after it, 2 alone, 3 as what comes before it"
    assert float(sure[0]) > 9 and float(sure[4]) > 9


def test_a_demonstration_with_too_many_transitions_is_named_by_its_number():
    known = [0, 0, 0, 1, 0, FREE, 1]
    with pytest.raises(ValueError, match=r"^demonstration 41: .* have 3 transitions, .* is 1: allow 3, or "):
        GivenLabels.of(known, [2, 5], 2, 1, numbers=[17, 41])
    assert int(transition_counts(GivenLabels.of(known, [2, 5], 2, 3).filled, torch.tensor([2, 5])).max()) == 3


@pytest.mark.parametrize(
    ("known", "frame"),
    [([1, FREE, FREE, FREE], 0), ([0, 2, FREE, 2], 0), ([FREE, FREE, FREE, 1], 3), ([0, FREE, 0, FREE], 2)],
)
def test_labels_of_no_chain_are_named_with_a_frame(known, frame):
    message = rf"^demonstration 1: near its frame {frame} .* in no chain 0, 1, ..., 2 of 4 frames"
    with pytest.raises(ValueError, match=message):
        GivenLabels.of([FREE] * 3 + known, [3, 4], 3, 2, "chain")


def test_what_cannot_be_given_is_refused():
    refused("given labels", GivenLabels.of, [0, 3], [2], 3, 1)
    refused("given labels", GivenLabels.of, [0, -2], [2], 3, 1)
    refused("given labels", GivenLabels.of, [0.5, 1], [2], 3, 1)
    refused("given labels", GivenLabels.of, [0.0, float("nan")], [2], 3, 1)
    refused("lengths", GivenLabels.of, [0, 1], [3], 3, 1)
    refused("order", GivenLabels.of, [0, 1], [2], 3, 1, "ring")
    refused("macros", GivenLabels.of, [0, 1], [2], 0, 1)
    refused("max_transitions", GivenLabels.of, [0, 1], [2], 2, -1)
    refused("max_transitions", GivenLabels.of, [0, 1], [2], 2, 2, "chain")
    refused("numbers", GivenLabels.of, [0, 1], [2], 2, 1, numbers=[1, 2])
    labels = GivenLabels.of([0, 1], [2], 2, 1)
    refused("costs", labels.costs, torch.zeros(3, 2))
    refused("costs", labels.costs, torch.zeros(2, 3))
    refused("costs", lambda: segment(labels.costs(torch.full((2, 2), torch.nan)), [2], 1))
