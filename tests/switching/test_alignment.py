"""Changes that are late in a few trajectories, told by the others."""

from functools import partial

import torch
from visible import trajectories

from dpmacro.switching.alignment import aligned, realigned
from dpmacro.switching.functions import SwitchFunctions
from dpmacro.switching.training import SwitchSettings, fit_switches


def test_changes_move_to_where_switch_functions_fire():
    learner, labels, lengths = trajectories()
    late = torch.cat(
        [
            (torch.arange(len(part)) >= int(part.argmax()) + 4 * (place < 3)).long()
            for place, part in enumerate(labels.split(lengths.tolist()))
        ]
    )

    def fit(given):
        settings = SwitchSettings(rounds=10)
        return fit_switches(learner, given, lengths, torch.Generator().manual_seed(0), settings)

    switches = fit(late)
    assert switches.detected.tolist() == [0.75]
    assert torch.equal(aligned(switches, late, lengths), labels)
    assert torch.equal(realigned(fit, late, lengths), labels)


def test_changes_stay_where_moving_them_helps_no_switch_function():
    lengths, labels = torch.tensor([4, 4]), torch.tensor([0, 0, 1, 1, 0, 0, 1, 1])
    scores = torch.tensor([-1.0, 2, -1, -1, -1, -1, 2, -1])[:, None]
    asked = []

    def fit(given):
        asked.append(given.tolist())
        return SwitchFunctions([(0, 1)], torch.zeros(1), torch.tensor([0.5]), scores, None)

    found = realigned(fit, labels, lengths)
    assert asked == [labels.tolist(), [0, 1, 1, 1, 0, 0, 1, 1]] and torch.equal(found, labels)


def test_changes_stay_where_nothing_was_left_out():
    lengths, labels = torch.tensor([4]), torch.tensor([0, 0, 1, 1])
    scores = torch.tensor([-1.0, 2, -1, -1])[:, None]

    def fit(left_out, given):
        share = torch.tensor([float(given[1])])  # more is recognised once it is moved
        return SwitchFunctions([(0, 1)], torch.zeros(1), share, scores, None, left_out=left_out)

    assert realigned(partial(fit, True), labels, lengths).tolist() == [0, 1, 1, 1]
    assert realigned(partial(fit, False), labels, lengths).tolist() == [0, 0, 1, 1]


def test_trajectories_with_other_changes_stay_as_they_are():
    lengths, labels = torch.tensor([4, 4, 4]), torch.tensor([0, 0, 1, 1, 0, 0, 0, 1, 1, 1, 1, 1])
    scores = torch.tensor([-1.0, 2, -1, -1, -1, -1, -1, -1, 2, -1, -1, -1])[:, None]
    switches = SwitchFunctions([(0, 1)], torch.zeros(1), torch.ones(1), scores, None)
    # The first change is moved, the second is never recognised, the third trajectory has none.
    assert aligned(switches, labels, lengths).tolist() == [0, 1, 1, 1, 0, 0, 0, 1, 1, 1, 1, 1]
