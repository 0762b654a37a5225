"""Columns do not depend on how many are computed at a time, nor levels on how many frames chose the cuts."""

import pytest
import torch

from dpmacro.features import memory
from dpmacro.features.columns import prepare, with_mirror_images
from dpmacro.features.history import Recording
from dpmacro.features.kinds import make_encoder, make_features
from dpmacro.features.levels import SortedLevels
from dpmacro.features.memory import Plan
from dpmacro.features.quantising import Quantiser
from tests.features.observed import FRONT, SPECS, STATE, TASK, TOP, observe

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
    [own], [plain] = data.blocks, SortedLevels.build(data.levels).blocks
    assert torch.equal(own.order, plain.order)


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


def everything(keys=tuple(SPECS), seed=1):
    specs = {key: SPECS[key] for key in keys}
    return make_encoder(specs, "rectangles", 40, 5, 2, torch.Generator().manual_seed(seed))


@pytest.mark.parametrize("sampled", [20_000, 30])
@pytest.mark.parametrize(("values", "gathered"), [(2**26, 2**29), (900, 5000), (40, 100)])
@pytest.mark.parametrize("keys", [tuple(SPECS), (STATE,), (STATE, TASK), (FRONT, TASK)])
def test_all_kinds_of_columns_are_those_computed_all_at_once(monkeypatch, sampled, values, gathered, keys):
    lengths = torch.tensor([40, 50])
    observations = observe(90, 3)
    encoder = everything(keys)
    sample = torch.linspace(0, 89, min(sampled, 90)).round().long()
    whole = encoder.values(Recording(observations, lengths).seen(encoder))
    quantiser = Quantiser.fit(whole[:, sample])
    monkeypatch.setattr(memory, "SAMPLED", sampled)
    monkeypatch.setattr(memory, "VALUES", values)
    monkeypatch.setattr(memory, "GATHERED", gathered)
    plan, done = Plan(encoder.count, encoder.count, 0, 1.0), []
    same, cuts, data = prepare(observations, lengths, encoder, plan, torch.Generator(), done.append)
    assert same is encoder and sum(done) == encoder.count
    assert cuts.cuts.dtype == encoder.dtype and torch.equal(cuts.cuts, quantiser.cuts)
    assert torch.equal(data.levels, quantiser.levels(whole))


def test_levels_of_selected_columns_need_no_common_type():
    """A policy keeps the cuts of all parts, float64, and may use columns of one part, int32 or float32."""
    lengths, observations, encoder = torch.tensor([40, 50]), observe(90, 3), everything()
    plan = Plan(encoder.count, encoder.count, 0, 1.0)
    _, quantiser, data = prepare(observations, lengths, encoder, plan, torch.Generator())
    for columns in ([0, 3, 7], [41, 42], [56], [5, 43, 56]):
        few = encoder.select(torch.tensor(columns))
        for frames in (slice(0, 90), slice(17, 18)):
            values = few.values(Recording(observations, lengths).seen(few, frames))
            levels = quantiser.select(torch.tensor(columns)).levels(values)
            assert torch.equal(levels, data.levels[columns, frames])


def test_columns_without_pixels_are_never_left_out():
    lengths, observations, encoder = torch.tensor([40, 50]), observe(90, 3), everything()
    blind = encoder.count - 40
    plan = Plan(blind + 6, encoder.count, 5, 1.0)
    kept, _, data = prepare(observations, lengths, encoder, plan, torch.Generator().manual_seed(0))
    assert kept.count == data.n_columns == blind + 6 and int(kept.sees_pixels.sum()) == 6
    assert kept.names()[6:] == encoder.names()[40:]
    with pytest.raises(ValueError, match=f"{blind} columns look at no pixels and are kept, the plan keeps 9"):
        prepare(observations, lengths, encoder, Plan(9, encoder.count, 5, 1.0), torch.Generator())


def test_columns_of_images_are_drawn_as_ever():
    observations, lengths = example()
    features = make_features("rectangles", 12, 16, 70, torch.Generator().manual_seed(1))
    plan = Plan(20, 70, 5, 1.0)
    kept, _, _ = prepare(observations, lengths, features, plan, torch.Generator().manual_seed(2))
    drawn = torch.randperm(70, generator=torch.Generator().manual_seed(2))[:20].sort().values
    assert torch.equal(kept.first, features.first[drawn])


class Watched:
    """An encoder that tells how much it is asked for."""

    def __init__(self, encoder, asked):
        self._encoder, self._asked = encoder, asked

    def __getattr__(self, name):
        return getattr(self._encoder, name)

    def select(self, columns):
        return Watched(self._encoder.select(columns), self._asked)

    def values(self, seen):
        values = self._encoder.values(seen)
        gathered = sum(value.nbytes for one in seen.values() for value in one.values())
        self._asked.append((values.numel() * values.element_size(), gathered))
        return values


def test_neither_values_nor_copies_stand_in_memory_at_once(monkeypatch):
    monkeypatch.setattr(memory, "SAMPLED", 100)
    monkeypatch.setattr(memory, "VALUES", 2000)
    monkeypatch.setattr(memory, "GATHERED", 20_000)
    asked, encoder = [], everything()
    plan = Plan(encoder.count, encoder.count, 5, 1.0)
    lengths, observations = torch.tensor([120, 180]), observe(300, 3)
    _, quantiser, data = prepare(observations, lengths, Watched(encoder, asked), plan, torch.Generator())
    assert max(values for values, _ in asked) <= 4 * 2000 and max(copied for _, copied in asked) <= 20_000
    assert torch.equal(
        data.levels, quantiser.levels(encoder.values(Recording(observations, lengths).seen(encoder)))
    )


def test_every_camera_is_mirrored_and_nothing_else():
    lengths, observations = torch.tensor([40, 50]), observe(90, 3)
    encoder = everything((FRONT, TOP))
    plan = Plan(encoder.count, encoder.count, 0, 1.0)
    _, quantiser, data = prepare(observations, lengths, encoder, plan, torch.Generator())
    both = with_mirror_images(data, observations, lengths, encoder, quantiser)
    flipped = {key: observations[key].flip(2) for key in (FRONT, TOP)}
    values = encoder.values(Recording(flipped, lengths).seen(encoder))
    assert torch.equal(both.levels, torch.cat([data.levels, quantiser.levels(values)], 1))
    encoder = everything((FRONT, STATE))
    with pytest.raises(ValueError, match="column 'x' has no mirror image"):
        with_mirror_images(data, observations, lengths, encoder, quantiser)


def test_what_was_not_recorded_or_is_not_finite_is_named():
    lengths, observations, encoder = torch.tensor([90]), observe(90, 3), everything((STATE,))
    plan = Plan(encoder.count, encoder.count, 0, 1.0)
    with pytest.raises(ValueError, match=r"no observation\.state was recorded, only task_index"):
        prepare({TASK: observations[TASK]}, lengths, encoder, plan, torch.Generator())
    observations[STATE][7, 2] = torch.nan
    with pytest.raises(ValueError, match="not finite"):
        prepare(observations, lengths, encoder, plan, torch.Generator())
