"""Features against plain sums, and the same numbers however frames are batched."""

import numpy as np
import pytest
import torch

from dpmacro.features.base import frames_before
from dpmacro.features.encoders.pixels import Pixels
from dpmacro.features.encoders.rectangles import Rectangles
from dpmacro.features.kinds import FEATURES, encoder_from, make_features
from dpmacro.features.levels import LEVELS
from dpmacro.features.quantising import Quantiser

CAMERA = "observation.image"


def pairs(images, previous):
    return {0: {CAMERA: images}, 1: {CAMERA: previous}}


@pytest.fixture
def images():
    return torch.randint(
        0, 256, (70, 12, 16, 3), dtype=torch.uint8, generator=torch.Generator().manual_seed(0)
    )


def channels(now: np.ndarray, before: np.ndarray) -> np.ndarray:
    """[8, height, width] of one frame, as the docstring names them."""
    now, before = now.astype(int), before.astype(int)
    red, green, blue = np.moveaxis(now, -1, 0)
    difference = np.moveaxis(now - before, -1, 0)
    return np.stack([red, green, blue, *difference, red - green, 2 * blue - red - green])


def test_rectangles_are_plain_sums(images):
    features = Rectangles.draw(CAMERA, 12, 16, 200, torch.Generator().manual_seed(1))
    previous = images[frames_before(torch.tensor([30, 40]))]
    values = features.values(pairs(images, previous))
    assert (features.second[:100, 3:] == 0).all()
    assert (features.second[100:, 3:] > 0).all(), "half of them are differences"
    for n in (0, 29, 30, 69):
        planes = channels(images[n].numpy(), previous[n].numpy())
        for k in range(200):
            total = 0
            for (c, top, left, tall, wide), sign in ((features.first[k], 1), (features.second[k], -1)):
                total += sign * planes[c, top : top + tall, left : left + wide].sum()
            assert values[k, n] == total


def test_pixels_are_colours_then_differences(images):
    previous = images[frames_before(torch.tensor([70]))]
    values = Pixels.all(CAMERA, 12, 16).values(pairs(images, previous))
    assert values.shape == (6 * 12 * 16, 70)
    expected = torch.cat([images.int(), images.int() - previous.int()], 3).permute(3, 1, 2, 0)
    assert torch.equal(values, expected.reshape(-1, 70))


def test_the_papers_features_are_18432():
    assert Pixels.all(CAMERA, 48, 64).count == 18432


def test_the_first_frame_of_a_trajectory_is_its_own_predecessor(images):
    previous = images[frames_before(torch.tensor([1, 30, 39]))]
    for n in range(70):
        assert torch.equal(previous[n], images[n if n in (0, 1, 31) else n - 1])


@pytest.mark.parametrize("kind", FEATURES)
def test_selection_batches_and_files_change_no_value(images, kind):
    features = make_features(kind, 12, 16, 300, torch.Generator().manual_seed(2))
    previous = images[frames_before(torch.tensor([70]))]
    values = features.values(pairs(images, previous))
    columns = torch.randperm(features.count, generator=torch.Generator().manual_seed(3))[:50]
    few = features.select(columns)
    read = encoder_from(few.spec(), few.tensors())
    quantiser = Quantiser.fit(values)
    levels = quantiser.levels(values)
    for n in (0, 33, 69):
        single = read.values(pairs(images[n : n + 1], previous[n : n + 1]))
        assert torch.equal(single[:, 0], values[columns, n])
        assert torch.equal(quantiser.select(columns).levels(single)[:, 0], levels[columns, n])


def test_rectangles_of_a_large_white_picture_are_exact():
    """Their sums exceed what 24 bits hold."""
    features = Rectangles(
        CAMERA,
        300,
        400,
        torch.tensor([[7, 0, 0, 300, 400], [0, 0, 0, 300, 399], [2, 1, 1, 299, 399]], dtype=torch.int32),
        torch.tensor([[7, 0, 0, 0, 0], [0, 0, 1, 300, 399], [2, 0, 0, 0, 0]], dtype=torch.int32),
    )
    image = torch.full((1, 300, 400, 3), 255, dtype=torch.uint8)
    image[0, 299, 399] = torch.tensor([254, 0, 253])
    values = features.values(pairs(image, image))
    assert values[:, 0].tolist() == [2 * 253 - 254, 1, 255 * 299 * 399 - 2]


@pytest.mark.parametrize("kind", FEATURES)
def test_no_column_at_all(images, kind):
    features = make_features(kind, 12, 16, 300, torch.Generator().manual_seed(2))
    none = torch.zeros(0, dtype=torch.int64)
    values = features.select(none).values(pairs(images, images))
    quantiser = Quantiser.fit(features.values(pairs(images, images))).select(none)
    assert values.shape == (0, 70)
    assert quantiser.levels(values).shape == (0, 70)
    assert Quantiser.fit(values).cuts.shape == (0, LEVELS - 1)


@pytest.mark.parametrize(
    ("kind", "count", "message"), [("hog", 10, "'hog'"), ("rectangles", 0, "number of rectangles is 0")]
)
def test_bad_feature_options_are_named(kind, count, message):
    with pytest.raises(ValueError, match=message):
        make_features(kind, 48, 64, count, torch.Generator())


@pytest.mark.parametrize("kind", FEATURES)
def test_a_footprint_spreads_weights_evenly_over_the_pixels_of_a_column(kind):
    generator = torch.Generator().manual_seed(4)
    features = make_features(kind, 4, 5, 60, generator)
    weights = torch.rand(2, features.count, generator=generator)
    expected = torch.zeros(2, 4, 5, dtype=torch.float64)
    for column in range(features.count):
        one = features.select(torch.tensor([column]))
        counts = torch.zeros(4, 5, dtype=torch.float64)
        if kind == "pixels":
            counts.view(-1)[one.places % 20] = 1
        else:
            for _, top, left, tall, wide in (*one.first.tolist(), *one.second.tolist()):
                counts[top : top + tall, left : left + wide] += 1
        expected += weights[:, column, None, None] * counts / counts.sum()
    torch.testing.assert_close(features.footprint(weights)[CAMERA], expected)
    torch.testing.assert_close(features.footprint(weights)[CAMERA].sum((1, 2)), weights.double().sum(1))


@pytest.mark.parametrize("kind", FEATURES)
def test_outside_its_footprint_a_column_sees_nothing(kind):
    generator = torch.Generator().manual_seed(5)
    features = make_features(kind, 6, 7, 20, generator)
    images, previous = torch.randint(0, 256, (2, 1, 6, 7, 3), dtype=torch.uint8, generator=generator)
    for column in range(features.count):
        one = features.select(torch.tensor([column]))
        seen = one.footprint(torch.ones(1, 1))[CAMERA][0] > 1e-12
        noise = torch.randint(0, 256, (2, 6, 7, 3), dtype=torch.uint8, generator=generator)
        other = [
            torch.where(seen[..., None], image[0], change)[None]
            for image, change in zip((images, previous), noise, strict=True)
        ]
        assert torch.equal(one.values(pairs(*other)), one.values(pairs(images, previous)))
