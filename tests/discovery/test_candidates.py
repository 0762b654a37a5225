"""The selector prefers a segmentation that a switch function can follow to one that explains as well."""

import pytest
import torch
from visible import task_of, visible_change

from dpmacro.discovery.candidates import (
    FINALISTS,
    LEADERS,
    Verdict,
    best_verdict,
    confidence,
    distinct,
    judge,
)


@pytest.fixture(scope="module")
def judged():
    data, actions, lengths, truth = visible_change()
    shifted = truth.view(12, 80).roll(9, 1).flatten()
    one = torch.zeros_like(truth)
    task = task_of(actions, lengths)
    return task, truth, judge(data, task, torch.stack([shifted, truth, one]))


def by_labels(judged, labels):
    return next(rival for rival in judged if torch.equal(rival.labels, labels))


def test_the_true_segmentation_is_run_best(judged):
    _, truth, rivals = judged
    right, one = by_labels(rivals, truth).verdict, by_labels(rivals, torch.zeros_like(truth)).verdict
    shifted = by_labels(rivals, truth.view(12, 80).roll(9, 1).flatten()).verdict
    assert right.detected == 1.0
    assert shifted.detected < 0.5
    assert right.runnable and not shifted.runnable and not one.runnable
    assert right.causal_error < 0.6 * min(shifted.causal_error, one.causal_error)
    assert right.gain > 3 * right.gain_error > 0
    assert abs(one.gain) < 1e-6  # the very classifier that it is compared with
    assert rivals[best_verdict([rival.verdict for rival in rivals])].labels is by_labels(rivals, truth).labels


def test_many_rivals_are_screened_by_how_well_their_changes_are_recognised():
    data, actions, lengths, truth = visible_change()
    shifted = [truth.view(12, 80).roll(shift, 1).flatten() for shift in range(5, 19)]
    stages = []
    found = judge(
        data, task_of(actions, lengths), torch.stack([*shifted, truth]), lambda r: stages.append(r.stage)
    )
    assert stages.count("recognise") == 15
    assert len(found) <= FINALISTS + LEADERS
    assert torch.equal(found[0].labels, truth)
    assert {tuple(rival.labels.tolist()) for rival in found} >= {tuple(own.tolist()) for own in shifted[:4]}


def test_context_says_what_the_labels_are_worth_in_hindsight(judged):
    _, truth, rivals = judged
    right = by_labels(rivals, truth).verdict
    assert right.context_gain == pytest.approx(right.gain, rel=0.3)
    # Labels that follow the actions themselves explain every frame, and nothing of frames without a voice.
    data, actions, lengths, _ = visible_change()
    task = task_of(actions, lengths, bound=79)
    followed = judge(data, task, actions[None])[0].verdict
    assert followed.hindsight_loss <= right.hindsight_loss
    assert followed.context_gain < 0


def test_a_single_trajectory_is_judged_in_hindsight():
    data, actions, _, truth = visible_change()
    task = task_of(actions, torch.tensor([960]), bound=23)
    verdicts = [rival.verdict for rival in judge(data, task, torch.stack([truth.roll(20), truth]))]
    assert not any(verdict.runnable for verdict in verdicts)
    assert best_verdict(verdicts) == min((0, 1), key=lambda k: verdicts[k].hindsight_loss)
    assert all(verdict.gain_error == 0 and verdict.context_error > 0 for verdict in verdicts)


def test_confidence_is_low_at_the_change_and_high_in_between(judged):
    task, truth, rivals = judged
    right = by_labels(rivals, truth)
    sure = confidence(right, task, truth).view(12, 80)
    assert bool((sure >= 0).all()) and bool((sure <= 1).all())
    at_change = (truth.view(12, 80).diff(dim=1) != 0).nonzero()
    near = torch.stack([sure[row, cut + 1] for row, cut in at_change.tolist()]).mean()
    assert float(near) < float(sure[:, :15].mean())
    wrong = confidence(right, task, 1 - truth)
    assert float(wrong.mean()) < 0.1


def verdict(loss, detected=1.0, gain=0.1, error=0.0, hindsight=1.0):
    return Verdict(detected, loss, 0.1, hindsight, gain, error, 0.0, 0.0)


@pytest.mark.parametrize(
    ("verdicts", "best"),
    [
        ([verdict(0.5), verdict(0.4)], 1),
        ([verdict(0.41, 0.9), verdict(0.4, 0.8, error=0.02)], 0),  # within a standard error: seen best
        ([verdict(0.5, 0.9), verdict(0.4, 0.8, error=0.02)], 1),
        ([verdict(0.41, 0.8), verdict(0.4, 0.8, error=0.02)], 1),  # seen alike: least loss
        ([verdict(0.5, 0.9), verdict(0.4, 0.4)], 0),  # changes that are not recognised
        ([verdict(0.5), verdict(0.4, gain=-0.1)], 0),  # worse than a single classifier
        ([verdict(0.3, gain=-0.1, hindsight=0.6), verdict(0.4, 0.4, hindsight=0.5)], 1),  # none can be run
    ],
)
def test_the_best_verdict(verdicts, best):
    assert best_verdict(verdicts) == best


def test_distinct_keeps_the_first_of_a_group():
    base = torch.arange(200) // 100
    near = base.clone()
    near[0] = 1
    assert distinct(torch.stack([base, near, 1 - base, base])).tolist() == [0, 2]
