"""Switch functions on trajectories whose change can be seen, and on some where it cannot."""

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from visible import trajectories

from dpmacro.boosting import MARGIN_LIMIT
from dpmacro.learners import Frames
from dpmacro.learners.sorting import SortedLevels
from dpmacro.learners.stumps import StumpLearner
from dpmacro.switching import (
    causal_labels,
    cued,
    fit_switches,
    macro_segments,
    starting_macro,
)


def test_a_visible_change_is_recognised_when_it_comes():
    learner, labels, lengths = trajectories()
    switches = fit_switches(learner, labels, lengths, torch.Generator().manual_seed(0), rounds=10)
    assert switches.pairs == [(0, 1)]
    assert switches.detected.tolist() == [1.0]
    causal = causal_labels(switches.held_out, switches.thresholds, switches.pairs, lengths, 0)
    assert torch.equal(causal, labels)


def test_copies_of_the_frames_are_examples_too():
    learner, labels, lengths = trajectories()
    twice = StumpLearner(SortedLevels.build(learner.data.levels.repeat(1, 2)))
    once, again = (
        fit_switches(own, labels, lengths, torch.Generator().manual_seed(0), rounds=10)
        for own in (learner, twice)
    )
    assert again.held_out.shape == once.held_out.shape == (len(labels), 1)
    assert again.detected.tolist() == once.detected.tolist() == [1.0]
    assert torch.equal(again.held_out > again.thresholds, once.held_out > once.thresholds)
    # A change that only the copies show is learned from them.
    dark = learner.data.levels.clone()
    dark[0] = 0
    shown = StumpLearner(SortedLevels.build(torch.cat([dark, learner.data.levels], 1)))
    found = fit_switches(shown, labels, lengths, torch.Generator().manual_seed(0), rounds=10)
    scores = found.classifier.scores(Frames(learner.data.levels))[:, 0, 0]
    change = labels.diff(prepend=labels[:1]) > 0
    assert float(scores[change].min()) > float(scores[labels == 0].max())


def test_a_learner_of_other_frames_is_refused():
    learner, labels, lengths = trajectories()
    with pytest.raises(ValueError, match=r"frames and \d+ are labelled"):
        fit_switches(learner, labels[:-7], lengths, torch.Generator())


def test_a_switch_function_may_fire_after_what_came_before_its_changes():
    learner, labels, lengths = trajectories()
    generator = torch.Generator().manual_seed(1)
    actions = torch.randint(0, 3, labels.shape, generator=generator)
    change = (labels.diff(prepend=labels[:1]) > 0).nonzero()[:, 0]
    actions[change - 1] = torch.arange(len(change)) % 2 + 1  # 1 and 2, never 0
    parts = learner, labels, lengths
    free = fit_switches(*parts, torch.Generator().manual_seed(0), rounds=10)
    bound = fit_switches(*parts, torch.Generator().manual_seed(0), rounds=10, actions=actions)
    assert free.cues == ()
    assert bound.cues == ((1, 2),)
    starts = lengths.cumsum(0) - lengths
    before = actions.roll(1)
    before[starts] = 0
    may_fire = before > 0  # 1 and 2 come before six changes each
    unfocused = fit_switches(
        *parts, torch.Generator().manual_seed(0), rounds=10, actions=actions, focused=False
    )
    assert unfocused.cues == bound.cues
    assert torch.equal(unfocused.held_out[may_fire], free.held_out[may_fire])
    for found in (bound, unfocused):
        assert (found.held_out[~may_fire] == -MARGIN_LIMIT).all()
    assert bound.detected.tolist() == [1.0]


def test_frames_that_no_cue_precedes_are_no_examples():
    """What looks like a change there, or would tell changes from the rest, is not learned from."""
    learner, labels, lengths = trajectories()
    change = labels.diff(prepend=labels[:1]) > 0
    actions = change.roll(-1).long()  # 1 before a change
    actions[(lengths.cumsum(0) - 7)[:, None] + torch.arange(6)] = 1  # and late in a trajectory
    asked = cued(actions, lengths, [(1,)])[:, 0]
    generator = torch.Generator().manual_seed(2)
    levels = learner.data.levels.clone()
    noise = torch.randint(0, 256, levels.shape, generator=generator, dtype=torch.int64).to(levels.dtype)
    found = []
    for other in (
        levels,
        torch.where(asked, levels, noise),
        torch.where(asked, levels, levels[:, change][:, :1]),
    ):
        other = StumpLearner(SortedLevels.build(other))
        parts = other, labels, lengths, torch.Generator().manual_seed(0)
        found.append(fit_switches(*parts, rounds=10, actions=actions))
    for switches in found[1:]:
        assert torch.equal(switches.held_out[asked], found[0].held_out[asked])
        assert torch.equal(switches.thresholds, found[0].thresholds)


def test_a_change_that_always_follows_its_cue_and_nothing_else_does_is_made_there():
    learner, labels, lengths = trajectories()
    change = labels.diff(prepend=labels[:1]) > 0
    actions = change.roll(-1).long()
    found = fit_switches(
        learner, labels, lengths, torch.Generator().manual_seed(0), rounds=10, actions=actions
    )
    assert torch.equal(found.held_out[:, 0] > found.thresholds, change)
    assert found.detected.tolist() == [1.0]


def test_what_came_before_few_changes_is_no_cue():
    learner, labels, lengths = trajectories()
    change = (labels.diff(prepend=labels[:1]) > 0).nonzero()[:, 0]
    actions = torch.zeros_like(labels)
    for before, cues in (
        ([1] * 9 + [2] * 3, (1,)),
        ([1] * 8 + [2] * 4, (1, 2)),
        ([0, 1, 2, 3] * 3, (0, 1, 2)),
    ):
        actions[change - 1] = torch.tensor(before)
        generator = torch.Generator().manual_seed(0)
        assert fit_switches(learner, labels, lengths, generator, rounds=1, actions=actions).cues == (cues,)


def test_a_high_score_that_no_cue_precedes_does_not_move_the_threshold():
    learner, labels, lengths = trajectories()
    change = (labels.diff(prepend=labels[:1]) > 0).nonzero()[:, 0]
    levels = learner.data.levels.clone()
    levels[0, change - 6] = 200  # looks like the change
    learner = StumpLearner(SortedLevels.build(levels))
    actions = torch.zeros_like(labels)
    actions[change - 1] = 1
    free, bound = (
        fit_switches(learner, labels, lengths, torch.Generator().manual_seed(0), actions=known)
        for known in (None, actions)
    )
    assert float(free.detected) < float(bound.detected) == 1.0


@settings(deadline=None)
@given(st.lists(st.lists(st.integers(0, 3), min_size=1, max_size=6), min_size=1, max_size=5))
def test_cues_do_not_reach_over_the_end_of_a_trajectory(parts):
    lengths = torch.tensor([len(part) for part in parts])
    actions = torch.tensor([action for part in parts for action in part])
    found = cued(actions, lengths, ((0, 2), (1,))).tolist()
    wanted = [
        [place > 0 and part[place - 1] in own for own in ((0, 2), (1,))]
        for part in parts
        for place in range(len(part))
    ]
    assert found == wanted


def test_an_invisible_change_is_not():
    learner, labels, lengths = trajectories(visible=False)
    switches = fit_switches(learner, labels, lengths, torch.Generator().manual_seed(0), rounds=10)
    assert float(switches.detected[0]) < 0.5


def test_held_out_scores_never_saw_their_trajectory():
    learner, labels, lengths = trajectories(visible=False)
    switches = fit_switches(learner, labels, lengths, torch.Generator().manual_seed(0), rounds=40)
    fitted = switches.classifier.scores(Frames(learner.data.levels))[:, 0, 0]
    change = labels.diff(prepend=labels[:1]) > 0
    assert float(fitted[change].min()) > float(switches.held_out[change, 0].mean())


def test_early_stopping_keeps_the_rounds_that_left_out_trajectories_want():
    learner, labels, lengths = trajectories(visible=False)
    reports = []
    switches = fit_switches(
        learner,
        labels,
        lengths,
        torch.Generator().manual_seed(0),
        rounds=60,
        early_stopping=True,
        on_round=reports.append,
    )
    used = switches.classifier.tensors()["votes"]
    assert len(used) < len(reports) < 60, "noise is given up on, and later rounds are not kept"
    full = fit_switches(learner, labels, lengths, torch.Generator().manual_seed(0), rounds=len(used))
    torch.testing.assert_close(switches.held_out, full.held_out)
    frames = Frames(learner.data.levels)
    torch.testing.assert_close(switches.classifier.scores(frames), full.classifier.scores(frames))


def test_every_observed_change_gets_a_switch_function():
    learner, _, _ = trajectories(n=1)
    labels = torch.arange(learner.n_frames) // 10 % 3
    switches = fit_switches(learner, labels, torch.tensor([learner.n_frames]), torch.Generator(), rounds=3)
    assert switches.pairs == [(0, 1), (1, 2), (2, 0)]
    assert switches.held_out.shape == (learner.n_frames, 3)
    assert len(switches.thresholds) == len(switches.detected) == 3


def test_without_a_change_there_is_no_switch_function():
    learner, labels, lengths = trajectories()
    switches = fit_switches(learner, torch.zeros_like(labels), lengths, torch.Generator(), rounds=3)
    assert switches.pairs == [] and switches.classifier is None


def test_segments_know_what_follows():
    events = macro_segments(torch.tensor([0, 0, 1, 1, 1, 0, 2, 2]), torch.tensor([5, 3]))
    seen = [(e.trajectory, e.macro, e.start, e.stop, e.following, e.following_stop) for e in events]
    assert seen == [
        (0, 0, 0, 2, 1, 5),
        (0, 1, 2, 5, None, 5),
        (1, 0, 5, 6, 2, 8),
        (1, 2, 6, 8, None, 8),
    ]


def test_causal_labels_take_the_first_firing_and_the_strongest_of_several():
    scores = torch.tensor([[0.0, 0, 0], [1, 2, 0], [0, 0, 5], [0, 0, 5], [0, 0, 0]])
    labels = causal_labels(
        scores, torch.tensor([0.5, 0.5, 0.5]), [(0, 1), (0, 2), (2, 0)], torch.tensor([3, 2]), 0
    )
    assert labels.tolist() == [0, 2, 0, 0, 0]


def test_the_starting_macro_is_the_most_common_first_label():
    assert starting_macro(torch.tensor([1, 0, 1, 2, 2, 0]), torch.tensor([2, 1, 3])) == 1


@pytest.mark.parametrize(("window", "rounds", "message"), [(0, 5, "window is 0"), (3, 0, "rounds 0")])
def test_bad_arguments_are_named(window, rounds, message):
    learner, labels, lengths = trajectories(n=2)
    with pytest.raises(ValueError, match=message):
        fit_switches(learner, labels, lengths, torch.Generator(), window=window, rounds=rounds)
