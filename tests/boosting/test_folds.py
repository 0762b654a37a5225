"""Folds: even, in range, and together what belongs together."""

import torch
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from dpmacro.boosting.folds import STRETCHES, folds_of, frame_folds

SEEDS = st.integers(0, 2**16)


def generator(seed=0):
    return torch.Generator().manual_seed(seed)


def test_folds_are_even():
    assert folds_of(11, 4, generator()).bincount().tolist() == [3, 3, 3, 2]


def test_trajectories_of_a_group_share_their_fold():
    groups = torch.tensor([0, 0, 0, 4, 2, 2, 9])  # numbers may have gaps
    fold_of = folds_of(7, 4, generator(), groups)
    assert fold_of[0] == fold_of[1] == fold_of[2] and fold_of[4] == fold_of[5]
    assert sorted({int(fold_of[k]) for k in (0, 3, 4, 6)}) == [0, 1, 2, 3]


@settings(max_examples=60, deadline=None)
@given(st.lists(st.integers(1, 40), min_size=1, max_size=9), st.integers(2, 5), SEEDS)
def test_every_frame_has_a_fold_and_none_is_left_out_alone(lengths, folds, seed):
    fold_of = frame_folds(torch.tensor(lengths), folds, generator(seed))
    assert fold_of.shape == (sum(lengths),)
    used = fold_of.unique().tolist()
    assert used == list(range(len(used))) and len(used) <= folds
    assert len(used) == folds or sum(lengths) < folds


@settings(max_examples=40, deadline=None)
@given(
    st.lists(st.tuples(st.integers(1, 20), st.integers(0, 6)), min_size=2, max_size=12),
    st.integers(2, 4),
    SEEDS,
)
def test_with_enough_groups_whole_trajectories_are_left_out_with_their_group(trajectories, folds, seed):
    lengths, groups = (torch.tensor(part) for part in zip(*trajectories, strict=True))
    assume(len(groups.unique()) >= folds)
    parts = frame_folds(lengths, folds, generator(seed), groups).split(lengths.tolist())
    of_group: dict[int, int] = {}
    for group, part in zip(groups.tolist(), parts, strict=True):
        assert part.unique().tolist() == [of_group.setdefault(group, int(part[0]))]
    times = torch.tensor(list(of_group.values())).bincount(minlength=folds)
    assert len(times) == folds and int(times.max() - times.min()) <= 1


@settings(max_examples=40, deadline=None)
@given(st.lists(st.integers(24, 90), min_size=1, max_size=3), SEEDS)
def test_few_trajectories_are_left_out_in_stretches_alike_in_both_mirror_images(lengths, seed):
    both = torch.tensor(lengths * 2)
    groups = torch.arange(len(both)) % len(lengths)
    fold_of = frame_folds(both, 4, generator(seed), groups)
    originals, mirrored = fold_of.chunk(2)
    assert torch.equal(originals, mirrored)
    # Every stretch is a twelfth of its trajectory, and as many of them fall into every fold.
    shares = originals.bincount(minlength=4) / len(originals)
    assert bool((shares > 0.1).all()) and bool((shares < 0.4).all())
    for part in originals.split(lengths):
        runs = part.unique_consecutive(return_counts=True)[1]
        assert len(runs) <= 4 * STRETCHES and int(runs.min()) >= len(part) // (4 * STRETCHES)


def test_stretches_of_one_trajectory_fall_into_every_fold_equally():
    fold_of = frame_folds(torch.tensor([120]), 4, generator())
    assert fold_of.bincount().tolist() == [30] * 4
    stretches = fold_of.view(4 * STRETCHES, -1)
    assert bool((stretches == stretches[:, :1]).all())
    assert not torch.equal(fold_of, frame_folds(torch.tensor([120]), 4, generator(1)))


def test_stretches_of_several_trajectories_are_dealt_apart():
    first, second = frame_folds(torch.tensor([120, 120]), 4, generator()).chunk(2)
    assert not torch.equal(first, second)
