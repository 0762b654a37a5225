"""The recursion against enumeration of every labelling, ragged batches against single trajectories."""

import itertools

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from dpmacro.segmentation.recursion import cost_of, segment
from dpmacro.segmentation.segments import transition_counts

DEVICES = ["cpu", *(["cuda"] if torch.cuda.is_available() else [])]


def brute_force(costs: np.ndarray, bound: int, transition_costs: np.ndarray | None) -> float:
    """The cheapest labelling of one trajectory by enumeration."""
    n_frames, n_macros = costs.shape
    best = np.inf
    for labels in itertools.product(range(n_macros), repeat=n_frames):
        changes = [n for n in range(1, n_frames) if labels[n] != labels[n - 1]]
        if len(changes) <= bound:
            best = min(best, loop_cost(labels, costs, transition_costs))
    return best


def loop_cost(labels, costs, transition_costs) -> float:
    """What the labels of one trajectory cost."""
    total = sum(costs[n, q] for n, q in enumerate(labels))
    if transition_costs is not None:
        pairs = [(n, labels[n - 1], labels[n]) for n in range(1, len(labels)) if labels[n] != labels[n - 1]]
        total += sum(transition_costs[pair] for pair in pairs)
    return total


@pytest.mark.parametrize("with_transition_costs", [False, True])
@pytest.mark.parametrize("integers", [False, True], ids=["floats", "ties"])
@pytest.mark.parametrize("device", DEVICES)
def test_equals_enumeration_of_every_labelling(device, integers, with_transition_costs):
    generator = np.random.default_rng(0)
    for n_frames, n_macros, bound in itertools.product(range(1, 8), range(1, 4), range(4)):
        draw = (lambda *s: generator.integers(-2, 3, s).astype(float)) if integers else generator.normal
        costs = draw(n_frames, n_macros) if integers else draw(size=(n_frames, n_macros))
        size = (n_frames, n_macros, n_macros)
        extra = (draw(*size) if integers else draw(size=size)) if with_transition_costs else None
        result = segment(
            torch.tensor(costs, device=device),
            torch.tensor([n_frames]),
            bound,
            None if extra is None else torch.tensor(extra, device=device),
        )
        labels = result.labels.tolist()
        by_bound = [brute_force(costs, s, extra) for s in range(bound + 1)]
        assert result.cost_by_bound[0].tolist() == pytest.approx(by_bound, abs=1e-9)
        assert loop_cost(labels, costs, extra) == pytest.approx(by_bound[-1], abs=1e-9)
        n_changes = int(transition_counts(result.labels, torch.tensor([n_frames], device=device)))
        assert n_changes <= bound
        if integers:
            assert n_changes == by_bound.index(by_bound[-1]), "ties go to the fewest transitions"


@settings(max_examples=60, deadline=None)
@given(
    lengths=st.lists(st.integers(1, 40), min_size=1, max_size=6),
    n_macros=st.integers(1, 5),
    bound=st.integers(0, 6),
    seed=st.integers(0, 2**16),
)
def test_a_ragged_batch_equals_its_trajectories_one_by_one(lengths, n_macros, bound, seed):
    generator = torch.Generator().manual_seed(seed)
    costs = torch.randn(sum(lengths), n_macros, generator=generator, dtype=torch.float64)
    batch = segment(costs, torch.tensor(lengths), bound)
    singles = [segment(part, torch.tensor([len(part)]), bound) for part in costs.split(lengths)]
    assert torch.equal(batch.labels, torch.cat([single.labels for single in singles]))
    torch.testing.assert_close(batch.cost, torch.cat([single.cost for single in singles]))
    held = costs.gather(1, batch.labels[:, None])[:, 0]
    sums = torch.stack([part.sum() for part in held.split(lengths)])
    torch.testing.assert_close(batch.cost, sums)
    assert (transition_counts(batch.labels, torch.tensor(lengths)) <= bound).all()
    assert (batch.cost_by_bound.diff(dim=1) <= 0).all(), "a looser bound is never dearer"


@pytest.mark.parametrize("device", DEVICES)
@settings(max_examples=60, deadline=None)
@given(
    lengths=st.lists(st.integers(1, 6), min_size=1, max_size=5),
    n_macros=st.integers(1, 4),
    seed=st.integers(0, 2**16),
    with_transition_costs=st.booleans(),
)
def test_the_cost_of_labels_is_that_of_a_plain_loop(device, lengths, n_macros, seed, with_transition_costs):
    generator = np.random.default_rng(seed)
    n_frames = sum(lengths)
    labels, costs = generator.integers(0, n_macros, n_frames), generator.normal(size=(n_frames, n_macros))
    extra = generator.normal(size=(n_frames, n_macros, n_macros)) if with_transition_costs else None
    if extra is not None:
        extra[:, range(n_macros), range(n_macros)] = np.nan  # never read
        extra[np.cumsum([0, *lengths[:-1]])] = np.nan
    parts = np.split(np.arange(n_frames), np.cumsum(lengths)[:-1])
    wanted = sum(
        loop_cost(labels[part].tolist(), costs[part], None if extra is None else extra[part])
        for part in parts
    )
    changing = None if extra is None else torch.tensor(extra, device=device)
    given = torch.tensor(labels, device=device), torch.tensor(costs, device=device), torch.tensor(lengths)
    found = cost_of(*given, changing)
    assert found.dtype == torch.float64 and float(found) == pytest.approx(wanted, abs=1e-9)


@settings(max_examples=30, deadline=None)
@given(st.lists(st.integers(1, 12), min_size=1, max_size=4), st.integers(0, 4), st.integers(0, 2**16))
def test_the_cost_of_the_cheapest_labels_is_the_cost_of_the_segmentation(lengths, bound, seed):
    generator = torch.Generator().manual_seed(seed)
    costs = torch.randn(sum(lengths), 3, generator=generator)
    changing = torch.randn(sum(lengths), 3, 3, generator=generator)
    found = segment(costs, torch.tensor(lengths), bound, changing)
    own = cost_of(found.labels, costs, torch.tensor(lengths), changing)
    assert float(own) == pytest.approx(float(found.cost.sum()), abs=1e-9)


def test_a_shift_of_all_costs_moves_the_cost_and_not_the_labels():
    costs = torch.rand(50, 3, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    lengths = torch.tensor([20, 30])
    plain, shifted = segment(costs, lengths, 2), segment(costs + 8.0, lengths, 2)
    assert torch.equal(plain.labels, shifted.labels)
    torch.testing.assert_close(shifted.cost, plain.cost + 8.0 * lengths)


@pytest.mark.parametrize(
    ("costs", "lengths", "bound", "message"),
    [
        (torch.tensor([[0.0, float("nan")]]), [1], 1, r"^costs\[0, 1\] is nan: give finite costs"),
        (torch.tensor([[0.0], [float("inf")]]), [2], 1, r"^costs\[1, 0\] is inf"),
        (torch.zeros(3, 2), [3, 0], 1, r"lengths\[1\] is 0"),
        (torch.zeros(3, 2), [2, 2], 1, "add up to 4 frames but costs have 3"),
        (torch.zeros(3, 2), [3], -1, "max_transitions is -1"),
        (torch.zeros(3, 0), [3], 1, "one macro at least"),
        (torch.zeros(0, 2), [], 1, "costs have shape"),
    ],
)
def test_bad_input_is_named(costs, lengths, bound, message):
    with pytest.raises(ValueError, match=message):
        segment(costs, torch.tensor(lengths, dtype=torch.int64), bound)


@pytest.mark.parametrize(
    ("shape", "value", "message"),
    [((3, 2), 0.0, "shape"), ((3, 2, 2), float("nan"), r"^transition_costs\[1, 0, 1\] is nan")],
)
def test_bad_transition_costs_are_named(shape, value, message):
    with pytest.raises(ValueError, match=message):
        segment(torch.zeros(3, 2), torch.tensor([3]), 1, torch.full(shape, value))


@settings(max_examples=30, deadline=None)
@given(st.lists(st.integers(1, 9), min_size=1, max_size=4), st.integers(0, 3), st.integers(0, 2**31))
def test_transition_costs_of_first_frames_are_not_read(lengths, bound, seed):
    generator = torch.Generator().manual_seed(seed)
    costs = torch.randn(sum(lengths), 3, generator=generator)
    changing = torch.randn(sum(lengths), 3, 3, generator=generator)
    wanted = segment(costs, lengths, bound, changing)
    changing[np.cumsum([0, *lengths[:-1]])] = torch.nan
    found = segment(costs, lengths, bound, changing)
    assert torch.equal(found.labels, wanted.labels)
    assert torch.equal(found.cost_by_bound, wanted.cost_by_bound)


@pytest.mark.parametrize("order", ["chains", ""])
def test_an_unknown_order_is_named(order):
    with pytest.raises(ValueError, match=r"^order is .*: give 'free' or 'chain'$"):
        segment(torch.zeros(3, 2), [3], 1, order=order)
