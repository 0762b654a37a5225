"""The final fit of vectors: switch functions have no say where they make labels explain less."""

from dataclasses import replace

import pytest
import torch

from dpmacro.boosting.learners.stumps import StumpLearner
from dpmacro.boosting.losses.vectors import HuberLoss
from dpmacro.discovery.search import adopt
from dpmacro.discovery.task import Task
from dpmacro.estimator import final
from dpmacro.estimator.settling import FinalFit
from dpmacro.features.levels import SortedLevels
from dpmacro.switching.settings import SwitchSettings


def changing_rule(n=10, length=40):
    """Column 1 decides before a change that column 0 shows, column 2 after it; and the true labels."""
    generator = torch.Generator().manual_seed(0)
    levels = torch.randint(0, 120, (4, n * length), dtype=torch.uint8, generator=generator)
    truth = (torch.arange(length) >= length // 2).long().repeat(n)
    levels[0, truth > 0] = 250
    actions = levels.float()[1 + truth, torch.arange(n * length), None] / 60 - 1
    return SortedLevels.build(levels), actions, torch.full((n,), length), truth


@pytest.mark.parametrize("worse", [True, False])
def test_a_joint_fit_that_explains_less_is_done_again_without_switch_functions(monkeypatch, worse):
    data, actions, lengths, truth = changing_rule()
    task = Task(actions, lengths, torch.arange(len(lengths)), HuberLoss(1), 2, 1, seed=0)
    discovery = adopt(data, task, truth)
    assert discovery.kept.scores.runnable
    weights, settle = [], final.settle

    def settled(fit, *given):
        weights.append(fit.weight)
        found = settle(fit, *given)
        return replace(found, labels=found.labels.roll(12)) if worse and fit.weight > 0 else found

    monkeypatch.setattr(final, "settle", settled)
    learner = StumpLearner(data)
    fit = FinalFit(learner, learner, 20, 0.3, False, SwitchSettings(rounds=10), 1.0)
    found = final.finished(data, task, discovery, fit)
    assert weights[0] > 0 and weights[1:] == ([0.0] if worse else [])
    assert float((found.labels == truth).float().mean()) > 0.95
