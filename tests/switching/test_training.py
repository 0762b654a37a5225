"""Switch functions fitted to trajectories whose change can be seen, and to some where it cannot."""

from collections import Counter
from itertools import chain

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from visible import trajectories

from dpmacro.boosting.learners.base import Frames
from dpmacro.boosting.learners.stumps import StumpLearner
from dpmacro.boosting.losses.classes import MARGIN_LIMIT
from dpmacro.features.levels import SortedLevels
from dpmacro.segmentation.segments import macro_segments
from dpmacro.switching.examples import examples
from dpmacro.switching.functions import causal_labels, cued
from dpmacro.switching.settings import SwitchSettings
from dpmacro.switching.training import fit_switches


def fit(learner, labels, lengths, rounds=10, actions=None, on_round=lambda _: None, **settings):
    settings = SwitchSettings(rounds=rounds, **settings)
    generator = torch.Generator().manual_seed(0)
    given = learner, labels[None], lengths, generator, settings
    [found] = fit_switches(*given, actions=actions, on_round=on_round)
    return found


def test_a_visible_change_is_recognised_when_it_comes():
    learner, labels, lengths = trajectories()
    switches = fit(learner, labels, lengths)
    assert switches.pairs == ((0, 1),)
    assert switches.recognised.tolist() == [1.0]
    causal = causal_labels(switches.margins, switches.pairs, lengths, switches.first)
    assert torch.equal(causal, labels)


def test_copies_of_the_frames_are_examples_too():
    learner, labels, lengths = trajectories()
    twice = StumpLearner(SortedLevels.build(learner.data.levels.repeat(1, 2)))
    once, again = (fit(own, labels, lengths) for own in (learner, twice))
    assert again.scores.shape == once.scores.shape == (len(labels), 1)
    assert again.recognised.tolist() == once.recognised.tolist() == [1.0]
    assert torch.equal(again.scores > again.thresholds, once.scores > once.thresholds)
    # A change that only the copies show is learned from them.
    dark = learner.data.levels.clone()
    dark[0] = 0
    shown = StumpLearner(SortedLevels.build(torch.cat([dark, learner.data.levels], 1)))
    found = fit(shown, labels, lengths)
    scores = found.classifier.scores(Frames(learner.data.levels))[:, 0, 0]
    change = labels.diff(prepend=labels[:1]) > 0
    assert float(scores[change].min()) > float(scores[labels == 0].max())


def test_a_learner_of_other_frames_is_refused():
    learner, labels, lengths = trajectories()
    for count in (7, len(labels) - 1):  # too few, and more than the learner holds
        with pytest.raises(ValueError, match=r"frames and \d+ are labelled"):
            fit(learner, labels[:-7] if count == 7 else labels.repeat(2), lengths)


def test_a_switch_function_may_fire_after_what_came_before_its_changes():
    learner, labels, lengths = trajectories()
    generator = torch.Generator().manual_seed(1)
    actions = torch.randint(0, 3, labels.shape, generator=generator)
    change = (labels.diff(prepend=labels[:1]) > 0).nonzero()[:, 0]
    actions[change - 1] = torch.arange(len(change)) % 2 + 1  # 1 and 2, never 0
    parts = learner, labels, lengths
    free = fit(*parts)
    bound = fit(*parts, actions=actions)
    assert free.cues == ()
    assert bound.cues == ((1, 2),)
    starts = lengths.cumsum(0) - lengths
    before = actions.roll(1)
    before[starts] = 0
    may_fire = before > 0  # 1 and 2 come before six changes each
    unfocused = fit(*parts, actions=actions, focused=False)
    assert unfocused.cues == bound.cues
    assert torch.equal(unfocused.scores[may_fire], free.scores[may_fire])
    for found in (bound, unfocused):
        assert (found.scores[~may_fire] == -MARGIN_LIMIT).all()
    assert bound.recognised.tolist() == [1.0]


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
        found.append(fit(other, labels, lengths, actions=actions))
    for switches in found[1:]:
        assert torch.equal(switches.scores[asked], found[0].scores[asked])
        assert torch.equal(switches.thresholds, found[0].thresholds)


def test_a_change_that_always_follows_its_cue_and_nothing_else_does_is_made_there():
    learner, labels, lengths = trajectories()
    change = labels.diff(prepend=labels[:1]) > 0
    actions = change.roll(-1).long()
    found = fit(learner, labels, lengths, actions=actions)
    assert torch.equal(found.scores[:, 0] > found.thresholds, change)
    assert found.recognised.tolist() == [1.0]


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
        assert fit(learner, labels, lengths, rounds=1, actions=actions).cues == (cues,)


def test_a_high_score_that_no_cue_precedes_does_not_move_the_threshold():
    learner, labels, lengths = trajectories()
    change = (labels.diff(prepend=labels[:1]) > 0).nonzero()[:, 0]
    levels = learner.data.levels.clone()
    levels[0, change - 6] = 200  # looks like the change
    learner = StumpLearner(SortedLevels.build(levels))
    actions = torch.zeros_like(labels)
    actions[change - 1] = 1
    free, bound = (fit(learner, labels, lengths, actions=known, rounds=60) for known in (None, actions))
    assert float(free.recognised) < float(bound.recognised) == 1.0


def test_an_invisible_change_is_not():
    learner, labels, lengths = trajectories(visible=False)
    switches = fit(learner, labels, lengths)
    assert float(switches.recognised[0]) < 0.5


def test_scores_scores_never_saw_their_trajectory():
    learner, labels, lengths = trajectories(visible=False)
    switches = fit(learner, labels, lengths, rounds=40)
    fitted = switches.classifier.scores(Frames(learner.data.levels))[:, 0, 0]
    change = labels.diff(prepend=labels[:1]) > 0
    assert float(fitted[change].min()) > float(switches.scores[change, 0].mean())


def test_trajectories_of_a_group_are_left_out_together():
    learner, labels, lengths = trajectories(visible=False)
    twice = StumpLearner(SortedLevels.build(learner.data.levels.repeat(1, 2)))
    groups = torch.arange(len(lengths)).repeat(2)
    together, apart = (
        fit_switches(
            twice,
            labels.repeat(2)[None],
            lengths.repeat(2),
            torch.Generator().manual_seed(0),
            SwitchSettings(rounds=40),
            groups=own,
        )[0]
        for own in (groups, None)
    )
    twins = [found.scores.chunk(2) for found in (together, apart)]
    assert torch.equal(*twins[0]), "the same function scores a trajectory and its twin"
    assert not torch.equal(*twins[1])


def test_early_stopping_keeps_the_rounds_that_left_out_trajectories_want():
    learner, labels, lengths = trajectories(visible=False)
    reports = []
    switches = fit(learner, labels, lengths, rounds=60, early_stopping=True, on_round=reports.append)
    used = switches.classifier.tensors()["votes"]
    assert len(used) < len(reports) < 60, "noise is given up on, and later rounds are not kept"
    full = fit(learner, labels, lengths, rounds=len(used))
    torch.testing.assert_close(switches.scores, full.scores)
    frames = Frames(learner.data.levels)
    torch.testing.assert_close(switches.classifier.scores(frames), full.classifier.scores(frames))


def test_every_observed_change_gets_a_switch_function():
    learner, _, _ = trajectories(n=1)
    labels = torch.arange(learner.n_frames) // 10 % 3
    switches = fit(learner, labels, torch.tensor([learner.n_frames]), rounds=3)
    assert switches.pairs == ((0, 1), (1, 2), (2, 0))
    assert switches.scores.shape == (learner.n_frames, 3)
    assert len(switches.thresholds) == len(switches.recognised) == 3


def test_without_a_change_there_is_no_switch_function():
    learner, labels, lengths = trajectories()
    switches = fit(learner, torch.zeros_like(labels), lengths, rounds=3)
    assert switches.pairs == () and switches.classifier is None


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"rounds": 5, "window": 0}, "window is 0"),
        ({"rounds": 0}, "rounds 0"),
        ({"rounds": 5, "folds": 1}, "folds is 1"),
        ({"rounds": 5, "shrinkage": 5.0}, "shrinkage is 5"),
        ({"rounds": 5, "shrinkage": 0.0}, "shrinkage is 0.0"),
    ],
)
def test_bad_settings_are_named(options, message):
    with pytest.raises(ValueError, match=message):
        SwitchSettings(**options)


def test_a_single_trajectory_is_judged_by_what_learned_from_it_and_said_so():
    learner, labels, lengths = trajectories()
    alone = fit(
        StumpLearner(SortedLevels.build(learner.data.levels[:, : lengths[0]])),
        labels[: lengths[0]],
        lengths[:1],
    )
    scores = alone.classifier.scores(Frames(learner.data.levels[:, : lengths[0]]))[:, :, 0]
    assert not alone.left_out
    torch.testing.assert_close(alone.scores, scores)
    assert fit(learner, labels, lengths).left_out


PARTS = st.lists(st.lists(st.integers(0, 2), min_size=1, max_size=12), min_size=1, max_size=4)


@pytest.mark.parametrize("whole_past", [False, True])
@given(data=st.data())
def test_examples_are_the_frames_from_a_change_on_and_those_before_it(data, whole_past):
    """Frame by frame: shown, of no trajectory left out, J positive ones at most, none beyond its segment.

    Negative are the frames of macro-action 0; of the whole past all before a change from 0 to 1.
    """
    parts = data.draw(PARTS)
    window, n_frames = data.draw(st.integers(1, 5)), sum(map(len, parts))
    left_out = data.draw(st.lists(st.booleans(), min_size=len(parts), max_size=len(parts)))
    shown = data.draw(st.lists(st.booleans(), min_size=n_frames, max_size=n_frames))
    side = []
    for part, out in zip(parts, left_out, strict=True):
        last = max((n for n in range(1, len(part)) if part[n - 1 : n + 1] == [0, 1]), default=0)
        for frame, macro in enumerate(part):
            since = next((k for k in range(frame, 0, -1) if part[k - 1] != part[k]), 0)  # its segment's start
            positive = since > 0 and (part[since - 1], macro) == (0, 1) and frame - since < window
            negative = frame < last if whole_past else macro == 0
            after = since > 0 and part[since - 1] == 0 and frame - since < window
            kind = (
                "positive" if positive else "negative" if negative else "rival" * (after and not whole_past)
            )
            side.append("" if out or not shown[len(side)] else kind)
    labels, lengths = torch.tensor([*chain(*parts)]), torch.tensor([len(part) for part in parts])
    segments = macro_segments(labels, lengths)
    given = segments, torch.tensor(left_out), torch.tensor(shown), window, whole_past, lengths
    weights, targets = examples((0, 1), *given)
    counts = Counter(side)
    shares = {
        "positive": 2 * counts["positive"],
        "negative": 2 * counts["negative"],
        "rival": 2 * counts["rival"],
    }
    if counts["negative"] and counts["rival"]:  # a quarter each
        shares = {name: share * (1 if name == "positive" else 2) for name, share in shares.items()}
    expected = torch.tensor([1 / shares[name] if name else 0.0 for name in side])
    torch.testing.assert_close(weights, expected)
    assert targets.tolist() == [name == "positive" for name in side] or not all(shown)


def test_without_left_out_scores_thresholds_and_cues_are_not_chosen():
    learner, labels, lengths = trajectories()
    actions = (labels.diff(prepend=labels[:1]) > 0).roll(-1).long()
    off = fit(learner, labels, lengths, actions=None, calibrated=False)
    assert off.thresholds.tolist() == [0.0] and off.cues == ()
    torch.testing.assert_close(off.margins, off.scores)
    on = fit(learner, labels, lengths, actions=actions)
    assert on.thresholds.tolist() != [0.0] and on.cues == ((1,),)


def test_segmentations_side_by_side_get_the_functions_that_each_gets_alone():
    learner, labels, lengths = trajectories()
    halves = torch.cat([torch.arange(n) >= n // 2 for n in lengths.tolist()]).long()
    without = torch.zeros_like(labels)
    settings = SwitchSettings(rounds=8)
    every = torch.stack([labels, without, halves, 1 - labels])
    together = fit_switches(learner, every, lengths, torch.Generator().manual_seed(3), settings)
    for own, found in zip(every, together, strict=True):
        [alone] = fit_switches(learner, own[None], lengths, torch.Generator().manual_seed(3), settings)
        assert (found.pairs, found.starts, found.cues) == (alone.pairs, alone.starts, alone.cues)
        for name in ("thresholds", "recognised", "scores", "margins"):
            torch.testing.assert_close(getattr(found, name), getattr(alone, name))
        if alone.classifier is None:
            assert found.classifier is None
        else:
            assert torch.equal(found.classifier.columns[:, :1], alone.classifier.columns[:, :1])


def test_changes_to_several_macro_actions_are_told_apart():
    """Where macro-action 0 ends is seen in column 0, and which one follows in column 1, from the start."""
    lengths, generator = torch.full((12,), 20), torch.Generator().manual_seed(0)
    change = torch.randint(6, 14, (12,), generator=generator)
    over = torch.cat([torch.arange(20) >= one for one in change.tolist()])
    side = (torch.arange(12) % 3 == 0).repeat_interleave(lengths)
    labels = torch.where(over, torch.where(side, 2, 1), 0)
    noise = torch.randint(0, 256, (4, len(labels)), dtype=torch.uint8, generator=generator)
    levels = torch.cat([torch.stack([over, side]).to(torch.uint8) * 200, noise])
    switches = fit(StumpLearner(SortedLevels.build(levels)), labels, lengths)
    assert switches.pairs == ((0, 1), (0, 2))
    assert torch.equal(causal_labels(switches.margins, switches.pairs, lengths, switches.first), labels)
