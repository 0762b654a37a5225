"""The texture set: many, distinct, the same each time, and never mistaken for a flag."""

import colorsys
from itertools import combinations

import numpy as np
import pytest

from dpmacro.worlds.two_flags.textures import SIZE, textures


def test_there_are_at_least_24_distinct_ones():
    made = textures()
    assert len(made) >= 24
    for one, other in combinations(made, 2):
        assert np.abs(one.astype(int) - other).mean() > 5


def test_the_set_never_changes():
    for one, other in zip(textures(), textures(), strict=True):
        assert one.dtype == np.uint8 and one.shape == (SIZE, SIZE, 3)
        assert np.array_equal(one, other)


def test_none_has_a_flags_colour():
    for number, texture in enumerate(textures()):
        red, green, blue = texture.astype(float).reshape(-1, 3).T
        assert (red <= 1.8 * np.maximum(green, blue)).all(), number
        assert (blue <= 1.8 * np.maximum(red, green)).all(), number


@pytest.mark.parametrize("count", range(3, 7))
def test_none_has_the_colour_of_one_of_more_flags(count):
    hues = (2 / 3, 0.0, 1 / 3, 1 / 6, 5 / 6, 1 / 2)[:count]
    own = [np.array(colorsys.hsv_to_rgb(hue, 1, 1)) > 0.5 for hue in hues]
    for number, texture in enumerate(textures(hues)):
        colours = texture.astype(float).reshape(-1, 3)
        for channels in own:
            assert (colours[:, channels].min(-1) <= 2 * colours[:, ~channels].max(-1)).all(), number


def test_the_patterns_are_the_same_for_more_flags():
    for two, six in zip(textures(), textures((0.0, 1 / 6, 1 / 3, 1 / 2, 2 / 3, 5 / 6)), strict=True):
        brightness = two.max(-1).astype(int), six.max(-1)  # a greyer colour keeps its greatest channel
        assert np.abs(brightness[0] - brightness[1]).mean() < 4


def test_none_is_black_or_flat():
    for number, texture in enumerate(textures()):
        assert texture.mean() > 50, number
        assert texture.std() > 5, number
