"""DPBoost on data whose macro-actions are known."""

import numpy as np
import pytest
import torch

from dpmacro.boosting.crossfit import OWN_ROUNDS, SHARED_ROUNDS
from dpmacro.discovery.candidates import FINALISTS, LEADERS
from dpmacro.discovery.dpboost import DPBoost
from dpmacro.features.levels import SortedLevels
from dpmacro.features.quantising import Quantiser
from dpmacro.metrics import frame_accuracy
from dpmacro.segmentation.recursion import transition_counts

DEVICES = ["cpu", *(["cuda"] if torch.cuda.is_available() else [])]


def hidden_rule(seed, n=6, length=120):
    """Two features decide the action, one before a hidden change and the other after it."""
    rng = np.random.default_rng(seed)
    features, actions, truth = [], [], []
    for _ in range(n):
        x = rng.normal(size=(length, 5))
        rule = (np.arange(length) >= rng.integers(30, 90)).astype(int)
        features.append(x)
        actions.append((x[np.arange(length), rule] > 0).astype(int))
        truth.append(rule)
    return np.concatenate(features), np.concatenate(actions), np.full(n, length), np.concatenate(truth)


@pytest.fixture(scope="module")
def fitted():
    features, actions, lengths, truth = hidden_rule(0)
    reports = []
    result = DPBoost(2, rounds=60, restarts=8, shrinkage=0.3).fit(features, actions, lengths, reports.append)
    return features, actions, lengths, truth, result, reports


def test_finds_the_hidden_rule(fitted):
    features, actions, _, truth, result, _ = fitted
    assert frame_accuracy(result.labels.numpy(), truth) > 0.95
    scores = result.scores(torch.tensor(features))
    chosen = scores[torch.arange(len(actions)), result.labels].argmax(1)
    assert float((chosen.numpy() == actions).mean()) > 0.95


def test_keeps_the_bound_and_never_lets_the_objective_rise(fitted):
    _, _, lengths, _, result, _ = fitted
    lengths = torch.tensor(lengths)
    for labels in (result.labels, *result.search.candidates.labels):
        assert (transition_counts(labels, lengths) <= 1).all()
    for loss in (result.loss, *result.search.candidates.loss.T):
        assert (loss.diff() <= 1e-4 * loss[:-1]).all()


def test_reports_every_round(fitted):
    *_, result, reports = fitted
    stages = [report.stage for report in reports]
    assert stages[:80] == ["discover"] * 80
    assert stages[-60:] == ["fit"] * 60
    between = stages[80:-60]
    screened = between.count("recognise")
    assert between[:screened] == ["recognise"] * screened and screened > FINALISTS + LEADERS
    assert set(between[screened:]) == {"judge"}
    assert stages.count("judge") % (SHARED_ROUNDS + OWN_ROUNDS) == 0
    assert [report.number for report in reports[-60:]] == list(range(1, 61))
    assert [report.loss for report in reports[-60:]] == pytest.approx(result.loss.tolist())
    assert reports[-1].accuracy > 0.95


@pytest.mark.parametrize("device", DEVICES)
def test_a_seed_repeats_and_leaves_the_global_generator_alone(device):
    features, actions, lengths, _ = hidden_rule(1, n=3, length=40)
    before = torch.random.get_rng_state()
    fits = [
        DPBoost(2, rounds=8, restarts=4, discovery_rounds=40, seed=5, device=device).fit(
            torch.tensor(features, device=device), actions, lengths
        )
        for _ in range(2)
    ]
    assert torch.equal(fits[0].labels, fits[1].labels)
    assert torch.equal(fits[0].loss, fits[1].loss)
    assert torch.equal(before, torch.random.get_rng_state())


def test_one_macro_action_is_the_baseline():
    features, actions, lengths, _ = hidden_rule(2, n=2, length=40)
    result = DPBoost(1, rounds=10).fit(features, actions, lengths)
    assert result.search is None
    assert (result.labels == 0).all()
    assert float(result.loss[-1]) < float(result.loss[0])


def test_levels_can_be_given_sorted_already():
    features, actions, lengths, _ = hidden_rule(3, n=2, length=40)
    columns = torch.tensor(features.T).contiguous()
    data = SortedLevels.build(Quantiser.fit(columns).levels(columns))
    options = {"rounds": 5, "restarts": 4, "discovery_rounds": 35}
    given, raw = (DPBoost(2, **options).fit(x, actions, lengths) for x in (data, features))
    assert torch.equal(given.labels, raw.labels)
    assert given.quantiser is None


@pytest.mark.parametrize("rule", ["parity", "five_or_more"])
def test_recovers_the_rule_of_a_sequence_of_digits(rule):
    """Labels are parity or digit >= 5, the rule changing at 19 hidden points; `rule` comes first."""
    from sklearn.datasets import load_digits

    images, digits = load_digits(return_X_y=True)
    rng = np.random.default_rng(0 if rule == "parity" else 1)
    order = rng.permutation(len(digits))
    images, digits = images[order], digits[order]
    cuts = np.cumsum(rng.multinomial(len(digits) - 20 * 45, np.full(20, 1 / 20)) + 45)[:-1]
    truth = (np.searchsorted(cuts, np.arange(len(digits)), side="right") + (rule != "parity")) % 2
    labels = np.where(truth == 0, digits % 2, digits >= 5).astype(np.int64)
    result = DPBoost(macros=2, max_transitions=19).fit(images, labels, [len(digits)])
    assert frame_accuracy(result.labels.numpy(), truth) >= 0.97


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"macros": 0}, "macros is 0"),
        ({"macros": 2, "max_transitions": -1}, "max_transitions is -1"),
        ({"macros": 2, "rounds": 0}, "rounds is 0"),
        ({"macros": 2, "restarts": 0}, "restarts is 0"),
        ({"macros": 2, "shrinkage": 2.0}, "shrinkage is 2.0"),
        ({"macros": 99}, "macros is 99 but there are only 20 frames"),
    ],
)
def test_bad_arguments_are_named(arguments, message):
    with pytest.raises(ValueError, match=message):
        DPBoost(**arguments).fit(np.zeros((20, 2)), np.zeros(20, np.int64), [10, 10])


@pytest.mark.parametrize(
    ("features", "actions", "lengths", "message"),
    [
        (np.array([[0.0], [np.nan]]), [0, 1], [2], "feature 0 of frame 1 is nan"),
        (np.zeros((3, 1)), [0, 1], [2], "3 frames and actions 2"),
        (np.zeros((2, 1)), [0, -1], [2], "an action is -1"),
        (np.zeros((2, 1)), [0, 1], [1], "must be positive and add up to 2"),
    ],
)
def test_bad_data_is_named(features, actions, lengths, message):
    with pytest.raises(ValueError, match=message):
        DPBoost(1, rounds=1).fit(features, np.array(actions), lengths)
