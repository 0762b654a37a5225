"""What switch functions charge a segmentation, against a plain loop over frames."""

import math
from itertools import pairwise

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from dpmacro.segmentation.recursion import cost_of
from dpmacro.switching.costs import SCORE_LIMIT, change_log_odds, charges_of


def made_up(labels, lengths, macros, seed=0):
    """Scores of a function for every change of the labels, random; pairs, log odds, lengths."""
    parts = torch.tensor(labels).split(lengths)
    steps = {step for part in parts for step in pairwise(part.tolist())}
    pairs = sorted(step for step in steps if step[0] != step[1])
    generator = torch.Generator().manual_seed(seed)
    scores = 3 * torch.randn(len(labels), len(pairs), generator=generator)
    lengths = torch.tensor(lengths)
    return scores, pairs, change_log_odds(torch.tensor(labels), lengths, macros), lengths


def log_odds_by_hand(labels, lengths, macros):
    parts = torch.tensor(labels).split(lengths)
    frames = [labels.count(q) for q in range(macros)]
    times = [
        [
            sum(int(((part[:-1] == q) & (part[1:] == r)).sum()) for part in parts) * (q != r)
            for r in range(macros)
        ]
        for q in range(macros)
    ]
    return [[math.log((times[q][r] + 1) / (frames[q] + 1)) for r in range(macros)] for q in range(macros)]


def loss(score):
    return math.log1p(math.exp(-2 * score))


def charged_by_hand(labels, scores, pairs, log_odds, lengths, macros):
    """Every frame but a first asks the switch functions of the macro-action before it."""
    total, n = 0.0, 0
    for length in lengths.tolist():
        for place in range(length):
            if place > 0:
                before, now = int(labels[n - 1]), int(labels[n])
                for other in set(range(macros)) - {before}:
                    told = 0.5 * log_odds[before][other]
                    if (before, other) in pairs:
                        score = float(scores[n, pairs.index((before, other))])
                        told += min(max(score, -SCORE_LIMIT), SCORE_LIMIT)
                    total += loss(told) if other == now else loss(-told)
            n += 1
    return total


@settings(max_examples=60, deadline=None)
@given(
    st.data(), st.integers(2, 4), st.lists(st.integers(1, 7), min_size=1, max_size=4), st.integers(0, 2**16)
)
def test_what_labels_pay_is_what_every_frame_is_asked(data, macros, lengths, seed):
    some = st.lists(st.integers(0, macros - 1), min_size=sum(lengths), max_size=sum(lengths))
    seen = data.draw(some)
    scores, pairs, log_odds, lengths = made_up(seen, lengths, macros, seed)
    by_hand = log_odds_by_hand(seen, lengths.tolist(), macros)
    torch.testing.assert_close(log_odds, torch.tensor(by_hand))
    extra = charges_of(scores, pairs, log_odds, lengths)
    labels = torch.tensor(data.draw(some))  # any labels, changes among them that were never seen
    paid = cost_of(labels, extra.staying, lengths, extra.changing)
    asked = charged_by_hand(labels, scores, pairs, by_hand, lengths, macros)
    assert float(paid) == pytest.approx(asked, rel=1e-5, abs=1e-5)
    starts = lengths.cumsum(0) - lengths
    assert not extra.staying[starts].any(), "nothing is asked at a first frame"
    assert extra.staying.dtype == extra.changing.dtype == torch.float64


@pytest.mark.parametrize("weight", [0.0, 0.5, 3.0])
def test_a_weight_scales_all_costs(weight):
    given = made_up([0, 0, 1, 1, 2, 0, 1, 1], [5, 3], 3)
    once, scaled = charges_of(*given), charges_of(*given, weight)
    torch.testing.assert_close(scaled.staying, weight * once.staying)
    torch.testing.assert_close(scaled.changing, weight * once.changing)


def test_a_change_never_seen_is_dear_and_a_confident_score_is_bounded():
    _, pairs, log_odds, lengths = made_up([0] * 20 + [1] * 20, [40], 2)
    extra = charges_of(torch.full((40, 1), 50.0), pairs, log_odds, lengths)
    never = 0.5 * math.log(1 / 21)
    assert float(extra.staying[5, 1]) == pytest.approx(loss(-never))
    seen = 0.5 * math.log(2 / 21) + SCORE_LIMIT
    wanted = loss(seen) - loss(-never)  # what is asked of 0, less what would have been asked of 1
    assert float(extra.changing[5, 0, 1]) == pytest.approx(wanted, rel=1e-5)
    assert float(extra.changing[5, 1, 0]) == pytest.approx(loss(never) - loss(-seen), rel=1e-5)
