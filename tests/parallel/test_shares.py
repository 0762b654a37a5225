"""Columns that are divided among ranks: every rank finds what one process finds alone, bit for bit."""

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from dpmacro.boosting.learners.base import Frames
from dpmacro.boosting.learners.stumps import StumpLearner
from dpmacro.boosting.loop import Boosting
from dpmacro.boosting.losses.classes import ExponentialLoss
from dpmacro.boosting.losses.vectors import HuberLoss
from dpmacro.features.levels import SortedLevels
from dpmacro.parallel import ALONE, Shares
from tests.parallel.threads import on_ranks

SIZES = st.integers(2, 5)


def divided(levels, ranks, sort=True):
    """A rank's share of the levels."""
    shares = Shares(len(levels), ranks)
    build = SortedLevels.build if sort else SortedLevels.unsorted
    return build(levels[shares.own], shares=shares)


@given(count=st.integers(1, 20), size=SIZES)
def test_every_column_is_held_by_one_rank(count, size):
    own = on_ranks(size, lambda ranks: Shares(count, ranks).own)
    assert torch.equal(torch.cat(own).sort().values, torch.arange(count))
    assert max(map(len, own)) - min(map(len, own)) <= 1


@settings(deadline=None)
@given(
    count=st.integers(1, 12), frames=st.integers(1, 40), size=SIZES, seed=st.integers(0, 10), data=st.data()
)
def test_any_columns_are_known_to_all(count, frames, size, seed, data):
    generator = torch.Generator().manual_seed(seed)
    levels = torch.randint(0, 256, (count, frames), dtype=torch.uint8, generator=generator)
    columns = torch.tensor(data.draw(st.lists(st.integers(0, count - 1), max_size=6)), dtype=torch.int64)
    thresholds = torch.randint(0, 256, (len(columns),), dtype=torch.uint8, generator=generator)

    def work(ranks):
        own = divided(levels, ranks, False)
        return own.rows(columns), own.above(columns, thresholds), own.shares.whole(own.levels)

    for rows, above, whole in on_ranks(size, work):
        assert torch.equal(rows, levels[columns])
        assert torch.equal(above, levels[columns] > thresholds[:, None])
        assert torch.equal(whole, levels)


@settings(deadline=None, max_examples=40)
@given(
    count=st.integers(1, 12),
    size=SIZES,
    seed=st.integers(0, 99),
    many=st.booleans(),
    vectors=st.booleans(),
    outputs=st.sampled_from([2, 3, 7]),
    how=st.sampled_from([{}, {"drawn": 3}, {"drawn": 3, "sort": False}, {"reuse": 3}, {"bins": 3}]),
)
def test_boosting_is_that_of_one_process(count, size, seed, many, vectors, outputs, how):
    generator, how = torch.Generator().manual_seed(seed), dict(how)
    sort, frames = how.pop("sort", True), 30
    levels = torch.randint(0, 256 if many else 3, (count, frames), dtype=torch.uint8, generator=generator)
    weights = torch.rand(frames, 2, generator=generator)
    if vectors:
        loss, targets = HuberLoss(outputs), torch.randn(frames, 1, outputs, generator=generator)
    else:
        loss, classes = ExponentialLoss(outputs), torch.randint(0, outputs, (frames, 1), generator=generator)
        targets = torch.nn.functional.one_hot(classes, outputs).bool()

    def grown(ranks):
        learner = StumpLearner(divided(levels, ranks, sort), **how)
        boosting = Boosting(learner, targets, 2, 0.5, torch.Generator().manual_seed(1), loss=loss)
        for _ in range(5):
            boosting.round(weights)
        strong = boosting.strong()
        shown, parts = learner.shown(strong, frames, 7)
        return strong, boosting.scores, torch.cat([shown.scores(part) for part in parts])

    alone, scores, _ = grown(ALONE)
    for strong, own, shown in on_ranks(size, grown):
        for name, tensor in alone.tensors().items():
            assert torch.equal(strong.tensors()[name], tensor), name
        assert torch.equal(own, scores)
        assert torch.equal(shown, torch.cat([alone.scores(Frames(part)) for part in levels.split(7, 1)]))


def test_an_error_of_one_rank_ends_all():
    def work(ranks):
        with ranks.together():
            if ranks.rank == 1:
                raise ValueError("column 3 is not finite")

    with pytest.raises(ValueError, match="column 3 is not finite"):
        on_ranks(3, work)
