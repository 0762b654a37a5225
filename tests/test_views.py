import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from dpmacro.views import mirrored, other_views, shifted


def images(width=7):
    return torch.arange(2 * 3 * width * 3, dtype=torch.uint8).view(2, 3, width, 3)


def test_a_mirror_exchanges_left_and_right():
    assert torch.equal(mirrored(images())[:, :, 0], images()[:, :, -1])
    assert torch.equal(mirrored(mirrored(images())), images())


@given(st.integers(1, 9), st.integers(-12, 12))
def test_a_shift_moves_every_pixel_and_repeats_the_edge(width, pixels):
    moved = shifted(images(width), pixels)
    for column in range(width):
        origin = min(max(column - pixels, 0), width - 1)
        assert torch.equal(moved[:, :, column], images(width)[:, :, origin])


@pytest.mark.parametrize(
    ("mirror", "pixels", "count"), [(True, 2, 3), (True, 0, 1), (False, 2, 2), (False, 0, 0)]
)
def test_which_views_there_are(mirror, pixels, count):
    views = [view(images()) for view in other_views(mirror, pixels)]
    assert len(views) == count and all(view.shape == images().shape for view in views)
    assert len({view.numpy().tobytes() for view in [images(), *views]}) == 1 + count
