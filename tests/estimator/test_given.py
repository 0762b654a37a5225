"""DPBoost with labels that are given: they are kept, and what they say of the rest is heard."""

import numpy as np
import pytest
import torch
from refusals import A, L, N, X, fitted, refused

from dpmacro import DPBoost
from dpmacro.metrics import frame_accuracy
from dpmacro.segmentation.segments import follows_chain, transition_counts

TRAJECTORIES, LENGTH = 8, 60
OPTIONS = {"macros": 2, "rounds": 40, "restarts": 8, "shrinkage": 0.3, "switch_rounds": 20}
QUICK = {**OPTIONS, "rounds": 12, "restarts": 2, "switch_rounds": 6}
FREE = -1


def three_rules(vectors=False, seed=0):
    """Three rules in turn, whose two changes show themselves; where is the one that matters?"""
    rng = np.random.default_rng(seed)
    features = rng.standard_normal((TRAJECTORIES, LENGTH, 4)).astype(np.float32)
    cuts = np.stack([rng.integers(15, 22, TRAJECTORIES), rng.integers(36, 43, TRAJECTORIES)], 1)
    since = np.arange(LENGTH) - cuts[:, :, None]
    rule = (since >= 0).sum(1)
    own = np.take_along_axis(features, rule[:, :, None], 2)[:, :, 0]
    actions = np.stack([own, -own], 2).reshape(-1, 2) if vectors else (own > 0).astype(np.int64).reshape(-1)
    features[:, :, 3] += 6 * ((since >= 0) & (since < 3)).any(1)
    return features.reshape(-1, 4), actions, np.full(TRAJECTORIES, LENGTH), rule.reshape(-1)


def of_trajectories(labels, *kept):
    """These labels in the trajectories that are kept, and none in the others."""
    place = np.arange(len(labels)) // LENGTH
    return np.where(np.isin(place, kept), labels, FREE)


@pytest.mark.parametrize(("vectors", "order"), [(False, "free"), (True, "free"), (True, "chain")])
def test_one_trajectory_says_which_of_two_changes_is_meant(vectors, order):
    *data, rule = three_rules(vectors)
    early, late = (rule >= 1).astype(int), (rule >= 2).astype(int)
    options = {**OPTIONS, "order": order}
    alone = DPBoost(**options).fit(*data).labels_.numpy()
    meant, found = (late, early) if frame_accuracy(alone, early) > 0.9 else (early, late)
    assert frame_accuracy(alone, found) > 0.9 and frame_accuracy(alone, meant) < 0.75
    model = DPBoost(**options).fit(*data, given=of_trajectories(meant, 3))
    labels = model.labels_.numpy().reshape(TRAJECTORIES, LENGTH)
    meant = meant.reshape(TRAJECTORIES, LENGTH)
    assert np.array_equal(labels[3], meant[3])
    others = np.arange(TRAJECTORIES) != 3
    assert (labels[others] == meant[others]).mean() > 0.9, "macro-actions are numbered as they were given"


@pytest.mark.parametrize("vectors", [False, True])
@pytest.mark.parametrize(
    "options",
    [
        {},
        {"order": "chain"},
        {"early_stopping": True},
        {"recipe": "paper"},
        {"switch_weight": 0.0},
        {"macros": 3, "max_transitions": 3},
    ],
    ids=str,
)
def test_labels_that_no_search_would_find_are_kept_exactly(vectors, options):
    features, actions, lengths, _ = three_rules(vectors)
    macros = options.get("macros", 2)
    wanted = np.minimum(np.arange(LENGTH) * 9 // LENGTH, macros - 1)  # far from where rules change
    given = np.full(len(features), FREE)
    given[:LENGTH] = wanted
    given[5 * LENGTH + 50 : 6 * LENGTH] = macros - 1  # a part of a trajectory
    model = DPBoost(**{**QUICK, **options}).fit(features, actions, lengths, given=torch.from_numpy(given))
    held = given != FREE
    assert np.array_equal(model.labels_.numpy()[held], given[held])
    assert (model.confidence_.numpy()[held] == 1).all()
    assert ((model.confidence_ >= 0) & (model.confidence_ <= 1)).all()
    bound = options.get("max_transitions", macros - 1)
    assert int(transition_counts(model.labels_, torch.from_numpy(lengths)).max()) <= bound
    if options.get("order") == "chain":
        assert follows_chain(model.labels_, torch.from_numpy(lengths), macros)
    for candidate in model.result_.discovery.candidates:
        assert np.array_equal(candidate.labels.numpy()[held], given[held])
    for loss in (model.result_.loss, *model.result_.discovery.alternated.loss.T):
        assert (loss.diff() <= 1e-4 * loss[:-1]).all(), "the objective falls as ever"


def test_a_macro_action_without_frames_is_left_out_and_the_others_keep_their_order():
    features, actions, lengths, rule = three_rules()
    given = np.where(rule >= 1, 3, 1)  # 0 and 2 have no frames
    model = DPBoost(**{**QUICK, "macros": 4}).fit(features, actions, lengths, given=given)
    assert np.array_equal(model.labels_.numpy(), (rule >= 1).astype(int))
    assert model.result_.macros == 2


def test_no_label_in_given_is_as_nothing_given():
    features, actions, lengths, _ = three_rules()
    one = DPBoost(**QUICK).fit(features, actions, lengths)
    other = DPBoost(**QUICK).fit(features, actions, lengths, given=np.full(len(features), FREE))
    assert torch.equal(one.labels_, other.labels_) and torch.equal(one.confidence_, other.confidence_)


def test_one_macro_action_has_its_label():
    model = fitted(macros=1)
    again = DPBoost(macros=1, rounds=3).fit(X, A, L, given=np.zeros(N, int))
    assert torch.equal(model.labels_, again.labels_)


@pytest.mark.parametrize(
    ("given", "options"),
    [
        (np.zeros(N - 1, int), {}),
        (np.zeros((N, 1), int), {}),
        (np.full(N, 2), {}),
        (np.full(N, -2), {}),
        (np.full(N, 0.5), {}),
        ("labels", {}),
        (np.arange(N) % 2, {}),  # too many changes
        (np.ones(N, int), {"order": "chain"}),  # which begins with 0
        (np.zeros(N, int), {"max_transitions": 0}),
    ],
)
def test_what_cannot_be_kept_is_named(given, options):
    model = DPBoost(**{"macros": 2, "rounds": 3, "restarts": 2, "switch_rounds": 3, **options})
    refused("given", model.fit, X, A, L, given=given)
    assert not hasattr(model, "labels_")
