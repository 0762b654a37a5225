from math import comb

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dpmacro.metrics.success import mcnemar, success_summary, wilson_interval


@pytest.mark.parametrize(
    ("successes", "runs", "low", "high"),
    [  # tables of Newcombe 1998 and R's prop.test(correct=FALSE)
        (81, 263, 0.2553, 0.3662),
        (15, 148, 0.0624, 0.1605),
        (0, 20, 0.0, 0.1611),
        (1, 29, 0.0061, 0.1718),
        (29, 29, 0.8830, 1.0),
    ],
)
def test_wilson_interval_agrees_with_published_values(successes, runs, low, high):
    assert wilson_interval(successes, runs) == pytest.approx((low, high), abs=6e-5)


def test_a_higher_confidence_gives_a_wider_interval():
    low, high = wilson_interval(5, 10, confidence=0.99)
    assert low < wilson_interval(5, 10)[0] and high > wilson_interval(5, 10)[1]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [((0, 0), "0 of 0"), ((3, 2), "3 of 2"), ((-1, 2), "-1 of 2"), ((1, 2, 1.0), "confidence is 1.0")],
)
def test_wilson_interval_names_what_is_wrong(arguments, message):
    with pytest.raises(ValueError, match=message):
        wilson_interval(*arguments)


def test_success_summary_splits_failures():
    summary = success_summary(
        ["success", "red_first", "red_never_reached", "red_first"], [1, 0, 1, 0], [1, 0, 0, 0]
    )
    assert (summary.successes, summary.runs, summary.rate) == (1, 4, 0.25)
    assert summary.interval == wilson_interval(1, 4)
    assert list(summary.endings.items()) == [(("red_first", 0, 0), 2), (("red_never_reached", 1, 0), 1)]


@pytest.mark.parametrize("arguments", [([], [], []), (["success"], [1], []), (["success"], [], [0])])
def test_success_summary_needs_complete_runs(arguments):
    with pytest.raises(ValueError, match=r"0 of 0|every run needs one of each"):
        success_summary(*arguments)


def test_the_interval_holds_the_rate_itself():
    for runs in range(1, 60):
        for successes in range(runs + 1):
            low, high = wilson_interval(successes, runs)
            assert 0 <= low <= successes / runs <= high <= 1


@settings(deadline=None)  # scipy is imported by the first call
@given(st.lists(st.tuples(st.booleans(), st.booleans()), min_size=1, max_size=40))
def test_mcnemar_is_a_coin_thrown_in_the_worlds_that_tell(pairs):
    first, second = zip(*pairs, strict=True)
    found, mirrored = mcnemar(first, second), mcnemar(second, first)
    b, c = pairs.count((True, False)), pairs.count((False, True))
    assert (found.both, found.neither) == (pairs.count((True, True)), pairs.count((False, False)))
    assert (found.only_first, found.only_second) == (b, c)
    assert found.pairs == len(pairs)
    throws = b + c
    as_far = [comb(throws, k) for k in range(throws + 1) if abs(2 * k - throws) >= abs(b - c)]
    assert found.p == pytest.approx(sum(as_far) / 2**throws)
    assert (mirrored.only_first, mirrored.only_second, mirrored.p) == (c, b, pytest.approx(found.p))


def test_mcnemar_agrees_with_a_published_value():
    # Agresti's 150 and 86 voters who change their mind, exact p of R's exact2x2; R's binom.test(6, 16).
    voters = mcnemar([True] * 150 + [False] * 86, [False] * 150 + [True] * 86)
    assert voters.p == pytest.approx(3.716e-05, rel=1e-3)
    assert mcnemar([True] * 6 + [False] * 10, [False] * 6 + [True] * 10).p == pytest.approx(0.4545, abs=5e-5)


@pytest.mark.parametrize(("first", "second"), [([], []), ([True], [True, False]), ([True], [])])
def test_mcnemar_needs_pairs(first, second):
    with pytest.raises(ValueError, match=f"{len(first)} and {len(second)} runs: give as many of each"):
        mcnemar(first, second)
