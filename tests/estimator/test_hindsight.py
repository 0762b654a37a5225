"""What fitted functions charge frames whose actions are known, against their formulas."""

import pytest
import torch

from dpmacro.boosting.learners.base import Frames
from dpmacro.boosting.learners.stumps import StumpClassifier
from dpmacro.boosting.losses.classes import MARGIN_LIMIT, ExponentialLoss
from dpmacro.estimator.hindsight import SwitchTerms, action_costs, switch_terms_costs
from dpmacro.switching.costs import charges_of
from dpmacro.switching.functions import cued

LENGTHS = torch.tensor([9, 4, 11])
FRAMES = int(LENGTHS.sum())
PAIRS = ((0, 1), (1, 0))


def stumps(problems, classes, seed=0):
    generator = torch.Generator().manual_seed(seed)
    return StumpClassifier(
        torch.randint(5, (8, problems), generator=generator),
        torch.randint(256, (8, problems), generator=generator).to(torch.uint8),
        torch.randn(8, problems, 2, classes, generator=generator),
    )


@pytest.fixture
def levels():
    return torch.randint(0, 256, (5, FRAMES), dtype=torch.uint8, generator=torch.Generator().manual_seed(1))


def chunks(levels, size=7):
    return [Frames(part) for part in levels.split(size, 1)]


def test_costs_of_actions_are_exponential_losses(levels):
    classifiers, actions = stumps(3, 2), torch.arange(FRAMES) % 2
    scores = classifiers.scores(Frames(levels)).double()
    right = torch.nn.functional.one_hot(actions, 2).bool()[:, None]
    wanted = torch.where(right, -scores, scores).exp().sum(2)
    found = action_costs(chunks(levels), classifiers, actions, ExponentialLoss(2))
    assert found.dtype == torch.float64
    torch.testing.assert_close(found, wanted, rtol=1e-5, atol=1e-6)


def test_an_action_that_the_classifiers_do_not_know_adds_nothing(levels):
    """The frame pays for the known actions that were not taken, nothing for the one that was."""
    classifiers, actions = stumps(2, 2), torch.arange(FRAMES) % 3
    found = action_costs(chunks(levels), classifiers, actions, ExponentialLoss(2))
    unknown = actions == 2
    wanted = classifiers.scores(Frames(levels)).double().exp().sum(2)[unknown]
    torch.testing.assert_close(found[unknown], wanted, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("cues", [(), ((0,), (0, 1))])
def test_a_switch_function_that_may_not_fire_says_no_as_surely_as_can_be(levels, cues):
    switcher, actions = stumps(2, 1), torch.arange(FRAMES) % 3
    terms = SwitchTerms(PAIRS, cues, torch.tensor([[0.0, -2], [-3, 0]]), 0.5)
    scores = switcher.scores(Frames(levels))[:, :, 0]
    if cues:
        scores = scores.masked_fill(~cued(actions, LENGTHS, cues), -MARGIN_LIMIT)
    wanted = charges_of(scores, PAIRS, terms.log_odds, LENGTHS, 0.5)
    found = switch_terms_costs(chunks(levels), switcher, terms, actions, LENGTHS)
    torch.testing.assert_close(found.staying, wanted.staying)
    torch.testing.assert_close(found.changing, wanted.changing)


def test_classifiers_of_the_start_have_no_say_in_the_changes(levels):
    """They are the switcher's problems after those of the changes."""
    switcher, actions = stumps(4, 1), torch.arange(FRAMES) % 3
    terms = SwitchTerms(PAIRS, (), torch.zeros(2, 2), 1.0)
    alone = switcher.select(torch.arange(2))
    both = [switch_terms_costs(chunks(levels), one, terms, actions, LENGTHS) for one in (switcher, alone)]
    torch.testing.assert_close(both[0].staying, both[1].staying, rtol=1e-5, atol=1e-5)
    torch.testing.assert_close(both[0].changing, both[1].changing, rtol=1e-5, atol=1e-5)
