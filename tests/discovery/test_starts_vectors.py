"""Starts of vectors keep the bound, are chains where asked for, and find cuts that are known."""

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from dpmacro.boosting.losses.vectors import HuberLoss
from dpmacro.discovery import race
from dpmacro.discovery.race import boosted, boosted_in_turn, raced
from dpmacro.discovery.settings import SearchSettings
from dpmacro.discovery.starts import (
    KINDS,
    Evidence,
    Moments,
    chained,
    evidence_of,
    feature_peaks,
    linear_alternation,
    vector_starts,
)
from dpmacro.discovery.starts.clusters import merged_pieces, spectral_windows, window_clusters
from dpmacro.discovery.starts.events import cut_at, jump_places, shift_places, slow_places
from dpmacro.discovery.starts.evidence import best_places, k_means, principal, window_means
from dpmacro.discovery.starts.goals import goals
from dpmacro.discovery.task import Task
from dpmacro.features.levels import SortedLevels
from dpmacro.features.quantising import Quantiser
from dpmacro.metrics.frames import frame_accuracy, named_after_truth
from dpmacro.segmentation.segments import transition_counts


def seeded(seed=0):
    return torch.Generator().manual_seed(seed)


def task_of(actions, lengths, macros, bound, order="free", seed=0):
    loss = HuberLoss(actions.shape[1])
    return Task(actions, lengths, torch.arange(len(lengths)), loss, macros, bound, seed, order)


def all_starts(levels, task, seed=0):
    evidence = evidence_of(SortedLevels.unsorted(levels), task, seeded(seed))
    moments = Moments(evidence)
    kinds = vector_starts(
        SortedLevels.unsorted(levels),
        evidence,
        moments,
        2 * len(KINDS),
        seeded(seed),
        dict.fromkeys(KINDS, 1),
    )
    kinds["linear"] = linear_alternation(evidence, torch.cat(list(kinds.values())), moments).labels
    return kinds


def accuracy(labels, truth):
    return frame_accuracy(named_after_truth(labels.numpy(), truth.numpy())[0], truth.numpy())


@settings(max_examples=30, deadline=None)
@given(
    lengths=st.lists(st.integers(1, 30), min_size=1, max_size=4),
    dims=st.integers(1, 3),
    macros=st.integers(1, 4),
    bound=st.integers(0, 5),
    constant=st.booleans(),
    flat=st.booleans(),
    seed=st.integers(0, 999),
)
def test_the_bound_holds_and_a_seed_repeats(lengths, dims, macros, bound, constant, flat, seed):
    frames = sum(lengths)
    levels = torch.randint(0, 1 if flat else 256, (9, frames), dtype=torch.uint8, generator=seeded(seed))
    actions = torch.zeros(frames, dims) if constant else torch.randn(frames, dims, generator=seeded(seed))
    task = task_of(actions, torch.tensor(lengths), macros, bound)
    for name, labels in all_starts(levels, task, seed=seed).items():
        assert torch.equal(labels, all_starts(levels, task, seed=seed)[name]), name
        assert labels.shape == ((2 if name != "linear" else 2 * len(KINDS)), frames)
        assert labels.min() >= 0 and labels.max() < macros
        for row in labels:
            assert (transition_counts(row, task.lengths) <= bound).all(), name


@settings(max_examples=30, deadline=None)
@given(
    macros=st.integers(1, 4),
    spare=st.lists(st.integers(0, 30), min_size=1, max_size=4),
    constant=st.booleans(),
    seed=st.integers(0, 999),
)
def test_chains_where_they_are_asked_for(macros, spare, constant, seed):
    lengths = torch.tensor(spare) + macros
    frames = int(lengths.sum())
    levels = torch.randint(0, 256, (5, frames), dtype=torch.uint8, generator=seeded(seed))
    actions = torch.zeros(frames, 2) if constant else torch.randn(frames, 2, generator=seeded(seed))
    task = task_of(actions, lengths, macros, macros - 1, "chain")
    for name, labels in all_starts(levels, task, seed=seed).items():
        for row in labels:
            for part in row.split(lengths.tolist()):
                assert part.unique_consecutive().tolist() == list(range(macros)), name


@pytest.mark.parametrize(
    ("labels", "macros", "chain"),
    [
        ([0, 0, 1, 1, 0, 0], 3, [0, 0, 1, 1, 2, 2]),
        ([0, 1, 0, 1, 0, 1], 2, [0, 1, 1, 1, 1, 1]),  # the first change stays
        ([2, 2, 2, 2, 2, 2], 3, [0, 1, 1, 2, 2, 2]),  # halves, then the first half of those
        ([0, 0], 2, [0, 1]),
    ],
)
def test_other_segmentations_as_chains(labels, macros, chain):
    assert chained(torch.tensor([labels]), torch.tensor([len(labels)]), macros)[0].tolist() == chain


TRUE_CUTS = (20, 45)  # of trajectories of 60 frames


@pytest.fixture(scope="module")
def toy():
    """Three stages: each its own mean action, a gripper that closes and opens, a halt at every change."""
    generator = seeded(1)
    lengths = torch.full((10,), 60)
    truth = torch.zeros(60, dtype=torch.int64)
    for cut in TRUE_CUTS:
        truth[cut:] += 1
    truth = truth.repeat(10)
    noise = 0.2 * torch.randn(600, 3, generator=generator)
    means = torch.tensor([[2.0, 0.0], [0.0, 2.0], [-2.0, -2.0]])[truth]
    place = torch.arange(60).repeat(10)
    near = torch.stack([(place - cut).abs() for cut in TRUE_CUTS]).amin(0)
    moving = 1 - torch.exp(-(near.float() ** 2) / 8)
    gripper = (truth == 1).float()[:, None]
    actions = torch.cat([means * moving[:, None] + noise[:, :2], gripper], 1)
    position = torch.cat([part.cumsum(0) for part in (means * moving[:, None]).split(60)])
    values = torch.cat([position, noise[:, 2:]], 1).T.contiguous()
    levels = Quantiser.fit(values).levels(values)
    return levels, actions, lengths, truth


def cuts_found(labels, lengths, tolerance):
    """Share of the true cuts with a change of label so near."""
    hits = 0
    for part in labels.split(lengths.tolist()):
        changes = (part[1:] != part[:-1]).nonzero()[:, 0] + 1
        hits += sum(bool(((changes - cut).abs() <= tolerance).any()) for cut in TRUE_CUTS)
    return hits / (len(lengths) * len(TRUE_CUTS))


@pytest.mark.parametrize(
    ("kind", "tolerance"),
    [("jumps", 0), ("shifts", 3), ("slow", 3), ("windows", 4), ("merged", 4), ("spectral", 6), ("linear", 4)],
)
def test_each_kind_finds_the_cuts_that_it_is_made_for(toy, kind, tolerance):
    levels, actions, lengths, _ = toy
    evidence = evidence_of(SortedLevels.unsorted(levels), task_of(actions, lengths, 3, 2), seeded())
    moments = Moments(evidence)
    starts = {
        "jumps": lambda: cut_at(jump_places, evidence, 2, seeded()),
        "shifts": lambda: cut_at(shift_places, evidence, 4, seeded()),
        "slow": lambda: cut_at(slow_places, evidence, 6, seeded()),
        "windows": lambda: window_clusters(evidence, 4, seeded()),
        "merged": lambda: merged_pieces(evidence, 4, seeded(), moments),
        "spectral": lambda: spectral_windows(evidence, 4, seeded(), moments),
        "linear": lambda: linear_alternation(evidence, merged_pieces(evidence, 4, seeded(), moments)).labels,
    }[kind]()
    assert max(cuts_found(row, lengths, tolerance) for row in starts) >= 0.9


def test_pieces_that_end_alike_have_one_name():
    """Three places, visited in any order; column k says how far the k-th is."""
    generator, levels, truth, changes = seeded(2), [], [], []
    for _ in range(12):
        for target in torch.randperm(3, generator=generator).tolist():
            part = torch.randint(0, 256, (3, 15), generator=generator)
            part[target, -1] = 128 + int(torch.randint(-2, 3, (1,), generator=generator))
            levels.append(part)
            truth += [target] * 15
            changes += [True] + [False] * 14
    truth, lengths = torch.tensor(truth), torch.full((12,), 45)
    evidence = Evidence(torch.zeros(540, 1), torch.zeros(540, 1), lengths, 3, 2)
    labels = goals(torch.cat(levels, 1).to(torch.uint8), torch.tensor(changes), evidence)
    assert accuracy(labels, truth) > 0.9


def test_the_linear_alternation_lowers_its_loss_and_finds_two_rules():
    generator = seeded(3)
    lengths = torch.full((8,), 60)
    truth = (torch.arange(60) >= 25).long().repeat(8)
    inputs = torch.randn(480, 2, generator=generator)
    actions = torch.where(truth == 0, inputs[:, 0], inputs[:, 1])[:, None]
    evidence = Evidence(actions + 0.1 * torch.randn(480, 1, generator=generator), inputs, lengths, 2, 1)
    starts = torch.stack([(torch.arange(60) >= cut).long().repeat(8) for cut in (10, 30, 50)])
    ended = linear_alternation(evidence, starts)
    assert accuracy(ended.labels[ended.loss.argmin()], truth) > 0.97
    again = linear_alternation(evidence, ended.labels)
    assert (again.loss <= ended.loss * (1 + 1e-4)).all()


def test_window_means_stay_within_trajectories():
    values = torch.tensor([[1.0], [2.0], [3.0], [10.0], [20.0]])
    means = window_means(values, torch.tensor([3, 2]), 1, 1)
    assert means[:, 0].tolist() == [1.0, 1.5, 2.5, 10.0, 15.0]
    assert window_means(values, torch.tensor([3, 2]), 1, 0)[:, 0].tolist() == [0.0, 1.0, 2.0, 0.0, 10.0]


def test_best_places_are_apart_and_finite():
    scores = torch.tensor([9.0, 1, 2, 8, 7, 1, 1, 5, 0, 9])
    assert best_places(scores, torch.tensor([10]), 2, 2).nonzero()[:, 0].tolist() == [3, 7]
    assert not best_places(torch.ones(2), torch.tensor([1, 1]), 3, 1).any()


def test_centres_of_clusters_even_of_one_point():
    points = torch.cat([torch.zeros(5, 2), torch.ones(5, 2)])
    assert sorted(k_means(points, 2, seeded()).tolist()) == [[0.0, 0.0], [1.0, 1.0]]
    assert (k_means(torch.ones(3, 2), 4, seeded()) == 1).all()


def test_components_are_uncorrelated_and_none_of_flat_columns():
    levels = torch.randint(0, 256, (6, 500), dtype=torch.uint8, generator=seeded())
    found = principal(SortedLevels.unsorted(levels), 4, seeded())
    torch.testing.assert_close(found.T @ found / 500, torch.eye(4), atol=1e-3, rtol=0)
    assert principal(SortedLevels.unsorted(torch.full((3, 20), 7, dtype=torch.uint8)), 4, seeded()).shape == (
        20,
        0,
    )


def test_peaks_of_vectors_only_where_the_action_changes_much():
    levels = torch.tensor([[5, 9, 1, 9, 4]], dtype=torch.uint8)
    actions = torch.tensor([[0.0], [0.0], [0.1], [0.1], [5.0]])
    labels = feature_peaks(SortedLevels.unsorted(levels), torch.tensor([5]), 10, 2, 1, seeded(), actions)
    assert {tuple(row.tolist()) for row in labels} == {(0, 0, 0, 0, 1)}


def test_a_race_ends_with_few_distinct_starts(toy):
    levels, actions, lengths, truth = toy
    data, task = SortedLevels.build(levels), task_of(actions, lengths, 3, 2)
    whole = raced(data, task, 10)
    assert whole.shape == (2, 600) and max(accuracy(row, truth) for row in whole) > 0.9
    assert torch.equal(whole, raced(data, task, 10))
    for row in whole:
        assert (transition_counts(row, lengths) <= 2).all()


def test_starts_in_turn_end_as_they_do_together(toy, monkeypatch):
    levels, actions, lengths, _ = toy
    data, task = SortedLevels.build(levels), task_of(actions, lengths, 3, 2)
    starts = all_starts(levels, task)["random"].repeat(2, 1)
    short = SearchSettings(rounds=6, warmup=2, drawn=2)
    together = boosted(data, task, starts, short, 0.3, seeded())
    monkeypatch.setattr(race, "TABLE", 1)
    alone = boosted_in_turn(data, task, starts, short, 0.3)
    assert torch.equal(together.labels, alone.labels)
    torch.testing.assert_close(together.loss, alone.loss, atol=1e-5, rtol=1e-5)
