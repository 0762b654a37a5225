"""Rivals made of rivals: cut again, and with fewer macro-actions."""

import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from visible import task_of, visible_change

from dpmacro.discovery.candidates import best_verdict, judge
from dpmacro.discovery.refinement import merged, recut, simplified


def best(judged):
    return judged[best_verdict([rival.verdict for rival in judged])]


@settings(deadline=None)
@given(st.lists(st.integers(0, 4), min_size=1, max_size=30))
def test_merging_makes_two_macro_actions_one_and_keeps_the_others_apart(labels):
    labels = torch.tensor(labels)
    n_used = len(labels.unique())
    found = merged(labels)
    assert len(found) == (n_used * (n_used - 1) // 2 if n_used > 2 else 0)
    for other in found:
        assert other.unique().tolist() == list(range(n_used - 1))
        # Frames that shared a macro-action still do, and just one pair of macro-actions has become one.
        pairs = {(int(old), int(new)) for old, new in zip(labels, other, strict=True)}
        assert len(pairs) == n_used
    assert len({tuple(other.tolist()) for other in found}) == len(found)


def test_a_macro_action_that_does_not_pay_is_merged_away():
    data, actions, lengths, truth = visible_change()
    place = torch.arange(80).repeat(12)
    idle = torch.where(
        (truth == 1) & (place > 65), 2, truth
    )  # the rule after the change, cut in two by the clock
    task = task_of(actions, lengths, macros=3, bound=2)
    judged = judge(data, task, idle[None])
    found = simplified(judged, data, task)
    assert torch.equal(best(found).labels, truth)
    assert found[0] is judged[0]


def test_macro_actions_that_pay_stay():
    data, actions, lengths, truth = visible_change()
    task = task_of(actions, lengths)
    judged = judge(data, task, truth[None])
    assert simplified(judged, data, task) == judged


def test_cutting_again_adds_rivals_that_are_no_worse():
    data, actions, lengths, truth = visible_change()
    task = task_of(actions, lengths)
    shift = torch.randint(-6, 7, (12,), generator=torch.Generator().manual_seed(0))
    cuts = truth.view(12, 80).argmax(1) + shift
    moved = (torch.arange(80) >= cuts[:, None]).long().flatten()
    judged = judge(data, task, moved[None])
    found = recut(judged, data, task, 1.0)
    assert found[0] is judged[0]
    assert len({tuple(rival.labels.tolist()) for rival in found}) == len(found) > 1
    assert float((best(found).labels == truth).float().mean()) > float((moved == truth).float().mean())
    assert best(found).verdict.causal_loss < judged[0].verdict.causal_loss
