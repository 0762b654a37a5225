"""Trajectories that start with different macro-actions: the first frame tells which."""

import torch
from visible import trajectories

from dpmacro.boosting.learners.base import Frames
from dpmacro.boosting.learners.stumps import StumpLearner
from dpmacro.features.levels import SortedLevels
from tests.switching.test_training import fit


def starting(told=True, seed=0, n=15):
    """Trajectories that start with 0 or 1 and change to the other; column 5 of the first frames tells."""
    learner, labels, lengths = trajectories(n, seed=seed)
    generator = torch.Generator().manual_seed(seed)
    begun = torch.randint(0, 2, (n,), generator=generator)
    begun[:2] = torch.tensor([0, 1])
    levels = learner.data.levels.clone()
    firsts = lengths.cumsum(0) - lengths
    if told:
        for later in range(3):
            levels[5, firsts + later] = (200 * begun).to(torch.uint8)
    return StumpLearner(SortedLevels.build(levels)), labels ^ begun.repeat_interleave(lengths), lengths, begun


def test_the_first_frame_tells_with_which_macro_action_a_trajectory_starts():
    learner, labels, lengths, begun = starting()
    switches = fit(learner, labels, lengths)
    assert switches.pairs == ((0, 1), (1, 0)) and switches.starts == (0, 1)
    assert switches.first.tolist() == begun.tolist()
    assert switches.scores.shape == switches.margins.shape == (len(labels), 2)
    scores = switches.classifier.scores(Frames(learner.data.levels))[:, :, 0]
    assert scores.shape[1] == 4, "one problem for every change, then one for every start"
    at_first = scores[lengths.cumsum(0) - lengths, 2:]
    assert at_first.argmax(1).tolist() == begun.tolist()


def test_the_start_is_told_by_classifiers_that_never_saw_the_trajectory():
    """Where nothing tells it they are right by chance, those that saw all of them mostly."""
    right, seen = [], []
    for seed in range(4):
        learner, labels, lengths, begun = starting(told=False, seed=seed)
        switches = fit(learner, labels, lengths, rounds=40)
        scores = switches.classifier.scores(Frames(learner.data.levels))[lengths.cumsum(0) - lengths, 2:, 0]
        right.append(float((switches.first == begun).float().mean()))
        seen.append(float((scores.argmax(1) == begun).float().mean()))
    assert sum(right) / 4 < 0.65 and sum(seen) / 4 > 0.8


def test_a_start_alone_needs_no_classifier():
    learner, labels, lengths = trajectories()
    switches = fit(learner, labels, lengths, rounds=3)
    assert switches.starts == (0,) and not switches.first.any()
    assert switches.classifier.scores(Frames(learner.data.levels)).shape[1] == 1


def test_starts_differ_where_nothing_ever_changes():
    learner, _, lengths, begun = starting()
    switches = fit(learner, begun.repeat_interleave(lengths), lengths)
    assert switches.pairs == () and switches.starts == (0, 1) and len(switches.thresholds) == 0
    assert switches.first.tolist() == begun.tolist()
    assert switches.classifier.scores(Frames(learner.data.levels)).shape[1] == 2
