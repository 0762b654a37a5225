"""DPBoost on vectors: rules that change unseen, alone and in a fixed order; what it refuses."""

import numpy as np
import pytest
import torch
from refusals import refused

from dpmacro import DPBoost
from dpmacro.metrics import frame_accuracy
from dpmacro.segmentation.segments import follows_chain

QUICK = {"rounds": 60, "restarts": 8, "switch_rounds": 40}


def stages(n_stages=3, trajectories=16, length=60, seed=0):
    """Which columns the action follows changes from stage to stage; a signal shows each change."""
    rng = np.random.default_rng(seed)
    lengths = np.full(trajectories, length)
    spread = length // n_stages
    cuts = np.stack(
        [rng.integers(k * spread - 4, k * spread + 5, trajectories) for k in range(1, n_stages)], 1
    )
    frames = np.arange(length)
    truth = (frames[None, :, None] >= cuts[:, None]).sum(2)
    features = rng.standard_normal((trajectories, length, n_stages + 1)).astype(np.float32)
    for k in range(n_stages - 1):
        since = frames[None] - cuts[:, k, None]
        features[:, :, -1] += 6 * ((since >= 0) & (since < 3))
    first = np.take_along_axis(features, truth[:, :, None], 2)[:, :, 0]
    second = np.take_along_axis(features, ((truth + 1) % n_stages)[:, :, None], 2)[:, :, 0]
    actions = np.stack([10 + first, -5 * second, np.full_like(first, 7)], 2)
    return features.reshape(-1, n_stages + 1), actions.reshape(-1, 3), lengths, truth.reshape(-1)


@pytest.fixture(scope="module")
def data():
    return stages()


@pytest.fixture(scope="module", params=["free", "chain"])
def fitted(request, data):
    features, actions, lengths, _ = data
    return DPBoost(macros=3, order=request.param, **QUICK).fit(features, actions, lengths), request.param


def test_hidden_stages_of_vectors_are_found(fitted, data):
    model, order = fitted
    features, actions, lengths, truth = data
    assert frame_accuracy(model.labels_.numpy(), truth) > 0.95
    assert model.score(features, actions, lengths) > 0.3
    if order == "chain":
        assert (model.labels_.numpy() == truth).mean() > 0.95, "stages are numbered as they come"
        assert follows_chain(model.labels_, torch.from_numpy(lengths), 3)
        assert model.result_.order == "chain" and model.result_.max_transitions == 2


def test_hindsight_says_of_the_training_data_what_the_fit_said(fitted, data):
    model, _ = fitted
    assert torch.equal(model.segment(*data[:3]), model.labels_)
    assert (model.confidence_ >= 0).all() and (model.confidence_ <= 1).all()


def test_new_data_in_any_unit_of_the_training(fitted):
    model, _ = fitted
    features, actions, lengths, truth = stages(seed=1)
    assert frame_accuracy(model.segment(features, actions, lengths).numpy(), truth) > 0.9


def test_units_change_nothing(fitted, data):
    model, order = fitted
    features, actions, lengths, _ = data
    other = actions * [1e3, 1e-3, 1] + [5, 0, 2]
    again = DPBoost(macros=3, order=order, **QUICK).fit(features, other, lengths)
    assert float((model.labels_ == again.labels_).float().mean()) > 0.98


def test_what_is_no_vector_is_named(data):
    features, actions, lengths, _ = data
    for wrong in (
        np.where(actions == actions[3, 1], np.nan, actions),
        np.full_like(actions, np.inf),
        actions[:-1],
        actions[:, :, None],
        actions.astype(np.int64),
        np.eye(3)[np.arange(len(actions)) % 3],
        actions[:, :0],
    ):
        refused("actions", DPBoost(macros=2, **QUICK).fit, features, wrong, lengths)


def test_new_vectors_are_those_of_fit(fitted, data):
    model, _ = fitted
    features, actions, lengths, _ = data
    for wrong in (actions[:, :2], np.zeros(len(actions), np.int64)):
        refused("actions", model.segment, features, wrong, lengths)
        refused("actions", model.score, features, wrong, lengths)


def test_a_chain_needs_as_many_frames_as_macro_actions_and_has_no_other_bound(data):
    features, actions, _, _ = data
    short = np.array([2, len(actions) - 2])
    refused("macros", DPBoost(macros=3, order="chain", **QUICK).fit, features, actions, short)
    refused("max_transitions", DPBoost, macros=3, order="chain", max_transitions=4)
    refused("order", DPBoost, order="line")
    refused("loss", DPBoost, loss="absolute")
