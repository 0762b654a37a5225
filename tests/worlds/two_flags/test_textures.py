"""The texture set: many, distinct, the same each time, and never mistaken for a flag."""

from itertools import combinations

import numpy as np

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


def test_none_is_black_or_flat():
    for number, texture in enumerate(textures()):
        assert texture.mean() > 50, number
        assert texture.std() > 5, number
