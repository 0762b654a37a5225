"""Left-out data prefers a segmentation that a switch function can follow to one that explains as well."""

from dataclasses import replace

import pytest
import torch
from visible import task_of, visible_change

from dpmacro.discovery.alternation import Alternated
from dpmacro.discovery.candidates import FINALISTS, LEADERS, action_charges, confidence, score_candidates
from dpmacro.discovery.criteria import best_candidate, standard_error
from dpmacro.discovery.result import Discovery
from dpmacro.discovery.search import adopt

LOOSE = [(2, 1), (2, 2), (2, 3), (4, 3)]  # Q and S that the true segmentation keeps


@pytest.fixture(scope="module")
def scored():
    data, actions, lengths, truth = visible_change()
    shifted = truth.view(12, 80).roll(9, 1).flatten()
    one = torch.zeros_like(truth)
    task = task_of(actions, lengths)
    return task, truth, score_candidates(data, task, torch.stack([shifted, truth, one]))


@pytest.fixture(scope="module")
def adopted():
    """The true segmentation, scored under bounds that are more and more loose."""
    data, actions, lengths, truth = visible_change()
    return [adopt(data, task_of(actions, lengths, *bounds), truth) for bounds in LOOSE]


def by_labels(scored, labels):
    return next(one for one in scored if torch.equal(one.labels, labels))


def test_the_true_segmentation_is_run_best(scored):
    _, truth, found = scored
    right, one = by_labels(found, truth).scores, by_labels(found, torch.zeros_like(truth)).scores
    shifted = by_labels(found, truth.view(12, 80).roll(9, 1).flatten()).scores
    assert right.recognised == 1.0
    assert shifted.recognised < 0.5
    assert right.runnable and not shifted.runnable and not one.runnable
    assert right.causal_error < 0.6 * min(shifted.causal_error, one.causal_error)
    assert right.gain > 3 * standard_error(right.alone - right.causal) > 0
    assert abs(one.gain) < 1e-6  # the very classifier that it is compared with
    assert found[best_candidate([one.scores for one in found])].labels is by_labels(found, truth).labels


def test_losses_are_a_mean_over_frames_by_trajectory(scored):
    task, truth, found = scored
    right = by_labels(found, truth)
    charges = action_charges(right.left_out, task, 1.0, right.scale).gather(1, truth[:, None])[:, 0]
    torch.testing.assert_close(right.scores.hindsight, charges.view(12, 80).sum(1) / 960)


def test_many_candidates_are_screened_by_how_well_their_changes_are_recognised():
    data, actions, lengths, truth = visible_change()
    shifted = [truth.view(12, 80).roll(shift, 1).flatten() for shift in range(5, 19)]
    stages = []
    given = data, task_of(actions, lengths), torch.stack([*shifted, truth])
    found = score_candidates(*given, lambda report: stages.append(report.stage))
    assert stages.count("recognise") == 15
    assert len(found) <= FINALISTS + LEADERS
    assert torch.equal(found[0].labels, truth)
    assert {tuple(one.labels.tolist()) for one in found} >= {tuple(own.tolist()) for own in shifted[:4]}


def test_context_says_what_the_labels_are_worth_in_hindsight(scored):
    _, truth, found = scored
    right = by_labels(found, truth).scores
    assert right.context_gain == pytest.approx(right.gain, rel=0.3)


def test_labels_that_follow_the_actions_say_nothing_of_frames_without_a_voice():
    """They explain every frame as well as the truth does; the frames around a frame tell no label of it."""
    data, actions, lengths, truth = visible_change()
    task = task_of(actions, lengths, bound=79)
    found = score_candidates(data, task, torch.stack([truth, actions]))
    right, followed = (by_labels(found, labels).scores for labels in (truth, actions))
    assert float((followed.alone - followed.hindsight).sum()) > 0.4
    assert float(followed.hindsight.sum()) <= float(right.hindsight.sum()) + 1e-6
    assert followed.context_gain < 0 < 0.4 < right.context_gain


@pytest.mark.parametrize("place", range(1, len(LOOSE)))
def test_scores_of_labels_do_not_depend_on_a_bound_that_they_do_not_use(adopted, place):
    tight, loose = (adopted[k].kept.scores for k in (0, place))
    for name in ("context", "hindsight", "causal", "alone"):
        torch.testing.assert_close(getattr(loose, name), getattr(tight, name), rtol=1e-4, atol=1e-6)
    assert tight.context_gain > 0.4
    assert loose.scalars() == pytest.approx(tight.scalars(), rel=1e-4)


@pytest.mark.parametrize("place", range(1, len(LOOSE)))
def test_confidence_and_cost_by_bound_know_only_what_the_labels_use(adopted, place):
    tight, loose = (adopted[k] for k in (0, place))
    sure, other = (confidence(one.kept, one.task, one.kept.labels) for one in (tight, loose))
    torch.testing.assert_close(other, sure, rtol=1e-3, atol=1e-4)
    assert float(sure.mean()) > 0.95
    assert len(tight.cost_by_bound) == 2 * 1 + 2 + 1, "bounds up to twice the transitions used, plus two"
    torch.testing.assert_close(loose.cost_by_bound, tight.cost_by_bound)


def test_a_macro_action_without_frames_casts_no_doubt(scored):
    """As well as any other does an unused one that says what the used ones say."""
    task, truth, found = scored
    right = by_labels(found, truth)
    twin = right.left_out[torch.arange(960), truth][:, None]
    unused = replace(right, left_out=torch.cat([right.left_out, twin], 1))
    wider = replace(task, macros=3)
    torch.testing.assert_close(confidence(unused, wider, truth), confidence(right, task, truth))
    discoveries = [
        Discovery(own, Alternated(truth[None], torch.zeros(1, 1)), (one,), 0)
        for own, one in ((task, right), (wider, unused))
    ]
    torch.testing.assert_close(*(one.cost_by_bound for one in discoveries))


def test_a_single_trajectory_is_scored_in_hindsight():
    data, actions, _, truth = visible_change()
    task = task_of(actions, torch.tensor([960]), bound=23)
    scores = [one.scores for one in score_candidates(data, task, torch.stack([truth.roll(20), truth]))]
    assert not any(one.runnable for one in scores)
    assert best_candidate(scores) == min((0, 1), key=lambda k: float(scores[k].hindsight.sum()))
    for one in scores:
        assert one.causal.isinf().all() and standard_error(one.alone - one.causal) == 0
        assert standard_error(one.alone - one.context) > 0


def test_confidence_is_low_at_the_change_and_high_in_between(scored):
    task, truth, found = scored
    right = by_labels(found, truth)
    sure = confidence(right, task, truth).view(12, 80)
    assert bool((sure >= 0).all()) and bool((sure <= 1).all())
    at_change = (truth.view(12, 80).diff(dim=1) != 0).nonzero()
    near = torch.stack([sure[row, cut + 1] for row, cut in at_change.tolist()]).mean()
    assert float(near) < float(sure[:, :15].mean())
    wrong = confidence(right, task, 1 - truth)
    assert float(wrong.mean()) < 0.1


def test_a_candidate_knows_what_it_uses(scored):
    task, truth, found = scored
    one = by_labels(found, torch.zeros_like(truth))
    assert by_labels(found, truth).used.tolist() == [0, 1] and one.used.tolist() == [0]
    assert (by_labels(found, truth).transitions(task.lengths), one.transitions(task.lengths)) == (1, 0)
