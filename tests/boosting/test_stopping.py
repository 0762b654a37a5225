"""Early stopping: the round that left-out trajectories want."""

import pytest
import torch

from dpmacro.boosting.learners.stumps import StumpLearner
from dpmacro.boosting.losses.classes import ExponentialLoss
from dpmacro.boosting.stopping import BestRound, validated_rounds
from dpmacro.features.levels import SortedLevels


def test_the_best_round_is_the_first_of_least_loss_problem_by_problem():
    stopping = BestRound(rounds=10)
    losses = torch.tensor([[3.0, 1.0], [2.0, 1.0], [2.5, 2.0], [2.0, 3.0]])
    assert not any(stopping.exhausted(row) for row in losses)
    assert stopping.best.tolist() == [2, 1]


def test_patience_ends_when_no_problem_improves_any_more():
    stopping = BestRound(rounds=50)
    assert stopping.patience == 10
    ended = [stopping.exhausted(torch.tensor([float(k == 0), -min(k, 4.0)])) for k in range(20)]
    assert ended.index(True) == 14


def data(noise, seed=0, n=12, length=60):
    """Column 0 tells the action in all but `noise` of the frames; the others are random."""
    generator = torch.Generator().manual_seed(seed)
    actions = torch.randint(0, 2, (n * length,), generator=generator)
    levels = torch.randint(0, 256, (400, n * length), dtype=torch.uint8, generator=generator)
    flipped = torch.rand(n * length, generator=generator) < noise
    levels[0] = (actions ^ flipped).to(torch.uint8) * 100
    return StumpLearner(SortedLevels.build(levels)), actions, torch.full((n,), length)


def validate(noise, rounds=60, on_round=lambda _: None):
    learner, actions, lengths = data(noise)
    labels = torch.zeros_like(actions)
    generator = torch.Generator().manual_seed(0)
    return validated_rounds(
        learner,
        labels,
        actions,
        lengths,
        rounds,
        0.5,
        ExponentialLoss(int(actions.max()) + 1),
        generator,
        on_round=on_round,
    )


def test_noise_stops_early_and_reports_every_round():
    reports = []
    best = validate(0.3, on_round=reports.append)
    assert best < 20
    assert [report.number for report in reports] == list(range(1, len(reports) + 1))
    assert len(reports) < 60 and {report.stage for report in reports} == {"validate"}
    assert max(report.accuracy for report in reports) == reports[best - 1].accuracy


def test_the_same_seed_stops_at_the_same_round():
    assert validate(0.3) == validate(0.3)


def test_a_single_trajectory_cannot_be_left_out():
    learner, actions, _ = data(0.1)
    with pytest.raises(ValueError, match="1 trajectory: early stopping leaves trajectories out"):
        validated_rounds(
            learner,
            torch.zeros_like(actions),
            actions,
            torch.tensor([720]),
            5,
            0.5,
            ExponentialLoss(3),
            torch.Generator(),
        )
