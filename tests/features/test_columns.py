"""Columns do not depend on how many are computed at a time, nor levels on how many frames chose the cuts."""

import pytest
import torch

from dpmacro.features import memory
from dpmacro.features.columns import prepare, with_mirror_images
from dpmacro.features.history import Recording
from dpmacro.features.kinds import make_features
from dpmacro.features.levels import SortedLevels
from dpmacro.features.memory import Plan
from dpmacro.features.quantising import Quantiser

CAMERA = "observation.image"


def example(n_frames=90):
    generator = torch.Generator().manual_seed(0)
    images = torch.randint(0, 256, (n_frames, 12, 16, 3), dtype=torch.uint8, generator=generator)
    return {CAMERA: images}, torch.tensor([40, n_frames - 40])


@pytest.mark.parametrize("kind", ["pixels", "rectangles"])
@pytest.mark.parametrize("at_a_time", [2**26, 1000])
def test_columns_are_those_computed_all_at_once(monkeypatch, kind, at_a_time):
    observations, lengths = example()
    features = make_features(kind, 12, 16, 70, torch.Generator().manual_seed(1))
    values = features.values(Recording(observations, lengths).seen(features))
    quantiser = Quantiser.fit(values)
    monkeypatch.setattr(memory, "VALUES", at_a_time)
    done = []
    same, cuts, data = prepare(
        observations,
        lengths,
        features,
        Plan(features.count, features.count, 0, 1.0),
        torch.Generator(),
        done.append,
    )
    assert same is features and sum(done) == features.count
    assert torch.equal(cuts.cuts, quantiser.cuts)
    assert torch.equal(data.levels, quantiser.levels(values))
    assert torch.equal(data.order, SortedLevels.build(data.levels).order)


def test_a_sample_of_many_frames_chooses_the_cuts(monkeypatch):
    observations, lengths = example()
    features = make_features("rectangles", 12, 16, 70, torch.Generator().manual_seed(1))
    values = features.values(Recording(observations, lengths).seen(features))
    monkeypatch.setattr(memory, "SAMPLED", 30)
    monkeypatch.setattr(memory, "VALUES", 700)
    _, quantiser, data = prepare(observations, lengths, features, Plan(70, 70, 20, 1.0), torch.Generator())
    assert torch.equal(data.levels, quantiser.levels(values))
    assert not torch.equal(quantiser.cuts, Quantiser.fit(values).cuts)
    assert len(data.columns) == 0


def test_columns_that_do_not_fit_are_left_out_at_random():
    observations, lengths = example()
    features = make_features("rectangles", 12, 16, 70, torch.Generator().manual_seed(1))
    kept, quantiser, data = prepare(
        observations, lengths, features, Plan(20, 70, 5, 1.0), torch.Generator().manual_seed(2)
    )
    assert kept.count == len(quantiser.cuts) == data.n_columns == 20
    rows = {tuple(box) for box in features.first.tolist()}
    assert all(tuple(box) in rows for box in kept.first.tolist())


@pytest.mark.parametrize("kind", ["pixels", "rectangles"])
@pytest.mark.parametrize("at_a_time", [2**26, 1000])
def test_mirror_images_come_after_the_frames(monkeypatch, kind, at_a_time):
    observations, lengths = example()
    features = make_features(kind, 12, 16, 70, torch.Generator().manual_seed(1))
    plan = Plan(features.count, features.count, 0, 1.0)
    _, quantiser, data = prepare(observations, lengths, features, plan, torch.Generator())
    monkeypatch.setattr(memory, "VALUES", at_a_time)
    both = with_mirror_images(data, observations, lengths, features, quantiser)
    flipped = {CAMERA: observations[CAMERA].flip(2)}
    values = features.values(Recording(flipped, lengths).seen(features))
    assert torch.equal(both.levels, torch.cat([data.levels, quantiser.levels(values)], 1))
    assert not torch.equal(both.levels[:, :90], both.levels[:, 90:]) and len(both.columns) == 0
