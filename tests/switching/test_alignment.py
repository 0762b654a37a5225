"""Changes that are late in a few trajectories, told by the others."""

from functools import partial

import pytest
import torch
from visible import functions_of, trajectories

from dpmacro.switching.alignment import aligned, realigned
from dpmacro.switching.settings import SwitchSettings
from dpmacro.switching.training import fit_switches


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
        return fit_switches(learner, given[None], lengths, torch.Generator().manual_seed(0), settings)[0]

    switches = fit(late)
    assert switches.recognised.tolist() == [0.75]
    assert torch.equal(aligned(switches, late, lengths), labels)
    assert torch.equal(realigned(fit, late, lengths), labels)


def test_changes_stay_where_moving_them_helps_no_switch_function():
    lengths, labels = torch.tensor([4, 4]), torch.tensor([0, 0, 1, 1, 0, 0, 1, 1])
    scores = torch.tensor([-1.0, 2, -1, -1, -1, -1, 2, -1])[:, None]
    asked = []

    def fit(given):
        asked.append(given.tolist())
        return functions_of(scores, recognised=torch.tensor([0.5]))

    found = realigned(fit, labels, lengths)
    assert asked == [labels.tolist(), [0, 1, 1, 1, 0, 0, 1, 1]] and torch.equal(found, labels)


def test_changes_stay_where_nothing_was_left_out():
    lengths, labels = torch.tensor([4]), torch.tensor([0, 0, 1, 1])
    scores = torch.tensor([-1.0, 2, -1, -1])[:, None]

    def fit(left_out, given):
        share = torch.tensor([float(given[1])])  # more is recognised once it is moved
        return functions_of(scores, recognised=share, left_out=left_out)

    assert realigned(partial(fit, True), labels, lengths).tolist() == [0, 1, 1, 1]
    assert realigned(partial(fit, False), labels, lengths).tolist() == [0, 0, 1, 1]


def test_trajectories_with_other_changes_stay_as_they_are():
    lengths, labels = torch.tensor([4, 4, 4]), torch.tensor([0, 0, 1, 1, 0, 0, 0, 1, 1, 1, 1, 1])
    scores = torch.tensor([-1.0, 2, -1, -1, -1, -1, -1, -1, 2, -1, -1, -1])[:, None]
    # The first change is moved, the second is never recognised, the third trajectory has none.
    assert aligned(functions_of(scores), labels, lengths).tolist() == [0, 1, 1, 1, 0, 0, 0, 1, 1, 1, 1, 1]


@pytest.mark.parametrize(("margin", "moved"), [(0.5, [0, 1, 1, 1]), (-0.5, [0, 0, 1, 1])])
def test_what_fires_is_the_margin_and_not_the_score(margin, moved):
    margins = torch.tensor([-1.0, margin, 1, -1])[:, None]
    switches = functions_of(torch.full((4, 1), 9.0), margins=margins)
    assert aligned(switches, torch.tensor([0, 0, 1, 1]), torch.tensor([4])).tolist() == moved


def test_a_trajectory_is_told_from_the_macro_action_that_it_starts_with():
    """The second starts with 1 and changes to 0; its change is moved by the function of that pair."""
    labels, lengths = torch.tensor([0, 0, 0, 1, 1, 1, 1, 0]), torch.tensor([4, 4])
    margins = torch.full((8, 2), -1.0)
    margins[2, 0] = margins[5, 1] = 1.0
    switches = functions_of(margins, ((0, 1), (1, 0)), first=torch.tensor([0, 0]))
    assert aligned(switches, labels, lengths).tolist() == [0, 0, 1, 1, 1, 0, 0, 0]
