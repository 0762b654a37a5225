"""Switch costs against a plain loop over frames, and a change that only the switch functions can place."""

import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from dpmacro.discovery.candidates import Judged, Task, Verdict, judge
from dpmacro.discovery.joint import MARGIN, resegmented, switch_costs
from dpmacro.features.levels import SortedLevels
from dpmacro.segmentation.recursion import cost_of, segment, transition_counts
from dpmacro.switching.functions import SwitchFunctions

VERDICT = Verdict(1.0, 0.5, 0.1, 0.5, 0.1, 0.01, 0.1, 0.01)


def made_up(labels, lengths, macros, held_out=None, scores=None, bound=99, seed=0):
    """A rival with the switch functions that its changes ask for, scores random unless given."""
    generator = torch.Generator().manual_seed(seed)
    labels, lengths = torch.tensor(labels), torch.tensor(lengths)
    ends = set((lengths.cumsum(0) - 1).tolist())
    steps = [(n, n + 1) for n in range(len(labels) - 1) if n not in ends and labels[n] != labels[n + 1]]
    pairs = sorted({(int(labels[a]), int(labels[b])) for a, b in steps})
    if held_out is None:
        held_out = 3 * torch.randn(len(labels), len(pairs), generator=generator)
    if scores is None:
        scores = torch.randn(len(labels), macros, 2, generator=generator)
    actions = torch.randint(0, 2, (len(labels),), generator=generator)
    task = Task(actions, lengths, torch.arange(len(lengths)), 2, macros, bound, seed=0)
    zeros = torch.zeros(len(pairs))
    return Judged(labels, VERDICT, scores, SwitchFunctions(pairs, zeros, zeros, held_out, None)), task


def told_by_hand(judged, task):
    """H_q^r(x_n) with half the log odds of the change, as nested lists."""
    parts = judged.labels.split(task.lengths.tolist())
    held = judged.switches.held_out.clamp(-MARGIN, MARGIN).tolist()
    told = []
    for n in range(len(judged.labels)):
        rows = []
        for q in range(task.macros):
            frames = int((judged.labels == q).sum())
            row = []
            for r in range(task.macros):
                times = sum(int(((part[:-1] == q) & (part[1:] == r)).sum()) for part in parts)
                score = 0.5 * math.log((times + 1) / (frames + 1))
                if (q, r) in judged.switches.pairs:
                    score += held[n][judged.switches.pairs.index((q, r))]
                row.append(score)
            rows.append(row)
        told.append(rows)
    return told


def loss(score):
    return math.log1p(math.exp(-2 * score))


def charged_by_hand(labels, told, lengths, macros):
    """Every frame but a first asks the switch functions of the macro-action before it."""
    total, n = 0.0, 0
    for length in lengths.tolist():
        for place in range(length):
            if place > 0:
                before, now = int(labels[n - 1]), int(labels[n])
                for other in range(macros):
                    if other != before:
                        score = told[n][before][other]
                        total += loss(score) if other == now else loss(-score)
            n += 1
    return total


@settings(max_examples=60, deadline=None)
@given(
    st.data(), st.integers(2, 4), st.lists(st.integers(1, 7), min_size=1, max_size=4), st.integers(0, 2**16)
)
def test_what_labels_pay_is_what_every_frame_is_asked(data, macros, lengths, seed):
    some = st.lists(st.integers(0, macros - 1), min_size=sum(lengths), max_size=sum(lengths))
    judged, task = made_up(data.draw(some), lengths, macros, seed=seed)
    extra = switch_costs(judged, task)
    labels = torch.tensor(data.draw(some))  # any labels, changes among them that were never seen
    paid = cost_of(labels, extra.staying, task.lengths, extra.changing)
    asked = charged_by_hand(labels, told_by_hand(judged, task), task.lengths, macros)
    assert float(paid) == pytest.approx(asked, rel=1e-5, abs=1e-5)
    starts = task.lengths.cumsum(0) - task.lengths
    assert not extra.staying[starts].any(), "nothing is asked at a first frame"
    assert extra.staying.dtype == extra.changing.dtype == torch.float64


@pytest.mark.parametrize("weight", [0.0, 0.5, 3.0])
def test_a_weight_scales_all_costs(weight):
    judged, task = made_up([0, 0, 1, 1, 2, 0, 1, 1], [5, 3], 3)
    once, scaled = switch_costs(judged, task), switch_costs(judged, task, weight)
    torch.testing.assert_close(scaled.staying, weight * once.staying)
    torch.testing.assert_close(scaled.changing, weight * once.changing)


def test_a_change_never_seen_is_dear_and_a_confident_score_is_bounded():
    judged, task = made_up([0] * 20 + [1] * 20, [40], 2, held_out=torch.full((40, 1), 50.0))
    changing = switch_costs(judged, task).changing
    never = 0.5 * math.log(1 / 21)
    assert float(switch_costs(judged, task).staying[5, 1]) == pytest.approx(loss(-never))
    seen = 0.5 * math.log(2 / 21) + MARGIN
    wanted = loss(seen) - loss(-never)  # what is asked of 0, less what would have been asked of 1
    assert float(changing[5, 0, 1]) == pytest.approx(wanted, rel=1e-5)
    assert float(changing[5, 1, 0]) == pytest.approx(loss(never) - loss(-seen), rel=1e-5)


def misplaced():
    """Actions say nothing within 8 frames of a change at 20, labels place it at 20, 20, 20, 25 and 15."""
    truth = torch.tensor([0] * 20 + [1] * 20).repeat(5)
    labels = torch.cat([(torch.arange(40) >= cut).long() for cut in (20, 20, 20, 25, 15)])
    frame = torch.arange(200) % 40
    held_out = torch.where(frame == 20, 2.0, -2.0)[:, None]
    judged, task = made_up(labels.tolist(), [40] * 5, 2, held_out, bound=1)
    sides = torch.nn.functional.one_hot(task.actions, 2) * 2.0 - 1
    telling = ((frame < 12) | (frame >= 28)).float()
    noise = 0.2 * torch.randn(200, 2, 1, generator=torch.Generator().manual_seed(1))
    own = torch.nn.functional.one_hot(truth, 2)[:, :, None] * 2.0 - 1
    scores = sides[:, None] * (own * telling[:, None, None] + noise)
    return Judged(labels, VERDICT, scores, judged.switches), task, truth


def deviances_by_hand(judged, task):
    """Bounded deviances by their formula."""
    right = torch.nn.functional.one_hot(task.actions, 2).bool()[:, None]
    margins = torch.where(right, judged.scores, -judged.scores).clamp(-MARGIN, MARGIN).double()
    return torch.log1p((-2 * margins).exp()).sum(2)


def test_a_visible_change_that_actions_place_badly_is_placed_by_the_switch_functions():
    judged, task, truth = misplaced()
    alone = resegmented(judged, task, weight=0.0)
    assert torch.equal(alone, segment(deviances_by_hand(judged, task), task.lengths, 1).labels)
    assert 0 < int((alone != truth).sum()) <= 5 * 8, "the actions say roughly where"
    assert torch.equal(resegmented(judged, task), truth)


@settings(max_examples=30, deadline=None)
@given(st.integers(2, 4), st.integers(0, 3), st.integers(0, 2**16))
def test_the_bound_is_kept(macros, bound, seed):
    generator = torch.Generator().manual_seed(seed)
    labels = torch.randint(0, macros, (30,), generator=generator).tolist()
    judged, task = made_up(labels, [12, 1, 17], macros, bound=bound, seed=seed)
    found = resegmented(judged, task)
    assert bool((transition_counts(found, task.lengths) <= bound).all())
    assert found.shape == (30,) and int(found.min()) >= 0 and int(found.max()) < macros


def test_a_few_misplaced_changes_are_corrected_by_what_was_learned_from_the_others():
    """Column 0 shows the change; columns 1 and 2 decide the action, before and after; near it alike."""
    n, length, misplaced = 12, 60, [3, 8]
    generator = torch.Generator().manual_seed(0)
    levels = torch.randint(0, 120, (6, n, length), dtype=torch.uint8, generator=generator)
    frames = torch.arange(length)
    cuts = torch.randint(20, 40, (n, 1), generator=generator)
    truth = (frames >= cuts).long()
    near = (frames - cuts).abs() < 7
    levels[2, near] = levels[1, near]
    levels[0, (frames >= cuts) & (frames < cuts + 3)] = 250
    cuts[misplaced] += 5
    labels = (frames >= cuts).long()
    actions = (torch.where(truth == 0, levels[1], levels[2]) > 60).long()
    task = Task(actions.flatten(), torch.full((n,), length), torch.arange(n), 2, 2, 1, seed=0)
    (judged,) = judge(SortedLevels.build(levels.flatten(1)), task, labels.flatten()[None])
    alone, found = (resegmented(judged, task, weight).view(n, length) for weight in (0.0, 1.0))
    assert int((alone != truth).sum()) > 40
    assert torch.equal(found[misplaced], truth[misplaced])
    assert int((found != truth).sum()) <= 5
