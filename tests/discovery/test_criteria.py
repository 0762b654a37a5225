"""Which of several candidates is preferred: one rule, by paired differences, as tables."""

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from dpmacro.discovery.criteria import (
    ERROR_STRETCHES,
    RECOGNISED,
    CandidateScores,
    best_candidate,
    equally_good,
    part_sums,
    standard_error,
)

PARTS = 9
WAVE = torch.tensor([1.0, -1, 1, -1, 0, 1, -1, 1, -1])  # of mean 0
OTHER = torch.tensor([1.0, 1, -1, -1, 0, 1, 1, -1, -1])  # likewise, and at right angles to it
STEP = 0.01  # spread of a part, of which the standard error of the sum is 0.028


def losses(total, spread=0.0, wave=WAVE):
    """A loss of `total` nats a frame, over the parts in a pattern."""
    return torch.full((PARTS,), total / PARTS) + spread * wave


def scored(
    causal=None, recognised=1.0, alone=0.5, hindsight=0.3, context=0.3, causal_error=0.1
) -> CandidateScores:
    """Scores of a candidate whose losses are given in all, or part by part."""
    parts = [
        value if isinstance(value, torch.Tensor) else losses(value)
        for value in (0.4 if causal is None else causal, hindsight, context, alone)
    ]
    return CandidateScores(recognised, parts[0], causal_error, *parts[1:])


def spread_of(first, second):
    return standard_error(first - second)


# Losses of the best and of another, and whether they do equally well. All differences are 0.02. An unpaired
# rule would ask for the spread of the best's gain over a single classifier, whose loss is spread evenly.
PAIRED = {
    "hard parts are hard for both: the other is worse everywhere": (
        losses(0.30, 10 * STEP),
        losses(0.32, 10 * STEP),
        False,
    ),
    "the best does alike everywhere, the other here better, there worse": (
        losses(0.30),
        losses(0.32, STEP),
        True,
    ),
    "each has its own hard parts": (losses(0.30, STEP), losses(0.32, STEP, OTHER), True),
    "nothing varies": (losses(0.30), losses(0.32), False),
}


@pytest.mark.parametrize("case", PAIRED)
def test_the_error_of_a_difference_is_that_of_the_paired_parts(case):
    best, other, alike = PAIRED[case]
    assert equally_good([best, other]) == ([0, 1] if alike else [0])
    assert equally_good([other, best]) == ([0, 1] if alike else [1])
    alone = losses(0.5)
    unpaired = float((other - best).sum()) <= spread_of(alone, best)
    if "hard for both" in case or "the best does alike" in case:
        assert unpaired != alike, "the two rules disagree here"


@pytest.mark.parametrize("case", PAIRED)
def test_a_candidate_that_does_equally_well_is_kept_where_its_changes_are_recognised_better(case):
    best, other, alike = PAIRED[case]
    scores = [scored(best, recognised=0.8), scored(other, recognised=0.9)]
    assert best_candidate(scores) == int(alike)


ERROR = spread_of(losses(0.0, STEP), losses(0.0))


@pytest.mark.parametrize(
    ("candidates", "best"),
    [
        ([scored(0.45), scored(0.4)], 1),
        ([scored(losses(0.41, STEP), 0.9), scored(0.4, 0.8)], 0),  # within a standard error: recognised best
        ([scored(losses(0.45, STEP), 0.9), scored(0.4, 0.8)], 1),
        ([scored(losses(0.41, STEP), 0.8), scored(0.4, 0.8)], 1),  # recognised alike: least loss
        ([scored(0.45, 0.9), scored(0.4, 0.4)], 0),  # changes that are not recognised
        ([scored(0.45), scored(0.4, alone=0.3)], 0),  # worse than a single classifier
        ([scored(0.45), scored(torch.full((PARTS,), torch.inf))], 0),  # nothing was left out
        ([scored(0.3, alone=0.2, hindsight=0.2), scored(0.4, 0.4, hindsight=0.1)], 1),  # none can be run
        ([scored(0.3, 0.4, hindsight=0.1), scored(0.2, 0.4, hindsight=0.15)], 0),
        ([scored(0.4)], 0),
    ],
)
def test_the_best_candidate(candidates, best):
    assert best_candidate(candidates) == best


def test_exactly_one_standard_error_is_equally_good():
    best = losses(0.0)
    for excess, alike in ((0.999 * ERROR, True), (1.001 * ERROR, False)):
        assert (equally_good([best, losses(excess, STEP)]) == [0, 1]) == alike


@pytest.mark.parametrize(
    ("scores", "runnable"),
    [
        (scored(0.4, RECOGNISED, alone=0.5), True),
        (scored(0.4, RECOGNISED - 0.01, alone=0.5), False),
        (scored(0.5, 1.0, alone=0.4), False),
        (scored(torch.full((PARTS,), torch.inf), 1.0), False),
    ],
)
def test_what_can_be_run_recognises_half_its_changes_and_gains(scores, runnable):
    assert scores.runnable == runnable


def test_gains_and_scalars_are_sums_over_the_parts():
    scores = scored(losses(0.4, STEP), 0.7, alone=0.5, hindsight=0.2, context=0.35, causal_error=0.25)
    assert (scores.gain, scores.context_gain) == pytest.approx((0.1, 0.15))
    wanted = {"recognised": 0.7, "causal_error": 0.25, "causal_loss": 0.4, "hindsight_loss": 0.2}
    assert scores.scalars() == pytest.approx({**wanted, "context_loss": 0.35, "alone_loss": 0.5})


@settings(deadline=None)
@given(st.lists(st.tuples(st.integers(1, 5), st.integers(0, 3)), min_size=1, max_size=20), st.integers(0, 99))
def test_parts_are_groups_of_trajectories_or_stretches_where_groups_are_few(trajectories, seed):
    lengths, groups = (torch.tensor(part) for part in zip(*trajectories, strict=True))
    values = torch.rand(int(lengths.sum()), generator=torch.Generator().manual_seed(seed))
    few = part_sums(values, lengths, groups)  # four groups at most
    assert len(few) == min(ERROR_STRETCHES, len(values))
    assert float(few.sum()) == pytest.approx(float(values.mean()), rel=1e-5)
    groups = torch.arange(len(lengths)) % ERROR_STRETCHES
    if len(lengths) >= ERROR_STRETCHES:
        parts = values.split(lengths.tolist())
        wanted = [
            sum(float(part.sum()) for part, own in zip(parts, groups, strict=True) if own == group)
            for group in range(ERROR_STRETCHES)
        ]
        found = part_sums(values, lengths, groups)
        torch.testing.assert_close(found, torch.tensor(wanted) / len(values))


def test_the_standard_error_of_a_sum_over_parts():
    generator = torch.Generator().manual_seed(0)
    sums = torch.randn(4000, PARTS, generator=generator).sum(1)
    one = torch.randn(PARTS, generator=generator)
    assert standard_error(one) == pytest.approx(float(one.std()) * PARTS**0.5)
    assert float(sums.std()) == pytest.approx(PARTS**0.5, rel=0.05), "the spread that it estimates"
    assert standard_error(one[:1]) == standard_error(torch.tensor([1.0, torch.inf])) == 0.0


def test_what_explains_most_comes_before_what_can_be_run_where_that_is_asked_for():
    runs = scored(recognised=0.9, hindsight=0.4)
    explains = scored(recognised=0.1, hindsight=0.2, context=0.9)
    as_well = scored(recognised=0.7, hindsight=losses(0.2 + 0.5 * STEP, STEP))
    assert best_candidate([runs, explains]) == 0
    assert best_candidate([runs, explains, as_well], explaining=True) == 2, "of equals, what can be run"
    assert best_candidate([runs, explains], explaining=True) == 0, "of equals none can be run, another can"
    never = scored(recognised=0.2, hindsight=0.4)
    assert best_candidate([never, explains], explaining=True) == 1, "nothing can be run"
