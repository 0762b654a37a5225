"""Pictures show the frames that they say, and keep within their budget."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dpmacro.annotation.page.sprites import BUDGET, MOST, ON_A_SHEET, chosen_frames, sprites
from tests.annotation.page.reading import coloured, picture


def letters(made):
    return sum(len(sheet.source) for sheets in made for sheet in sheets)


def noise(shape):
    def images(frames):
        rng = np.random.default_rng(0)
        return (rng.integers(0, 256, (*shape, 3), np.uint8) for _ in frames)

    return images


@given(
    lengths=st.lists(st.integers(1, 3000), min_size=1, max_size=6),
    cameras=st.integers(0, 4),
    frames=st.none() | st.integers(0, 4000),
)
def test_chosen_frames_are_spread_from_first_to_last(lengths, cameras, frames):
    chosen = chosen_frames(np.array(lengths), 30.0, cameras, frames)
    for length, own in zip(lengths, chosen, strict=True):
        most = MOST if frames is None else min(frames, MOST)
        assert len(own) <= min(length, most) and (np.diff(own) > 0).all()
        if frames == 0:
            assert not len(own)
        elif len(own) > 1:
            assert own[0] == 0 and own[-1] == length - 1
            assert np.diff(own).max() - np.diff(own).min() <= 1
        else:
            assert len(own) == 1 or cameras * len(lengths) > 1


def test_longer_demonstrations_get_more_frames_and_a_small_budget_fewer():
    lengths = np.array([50, 300, 9000])
    assert [len(own) for own in chosen_frames(lengths, 30.0, 1)] == [50, 100, 600]
    assert [len(own) for own in chosen_frames(lengths, 30.0, 1, 20)] == [20, 20, 20]
    few = chosen_frames(lengths, 30.0, 2, budget=100_000)
    assert 80 <= sum(map(len, few)) <= 100
    with pytest.raises(ValueError, match="frames=-1: give 0 or more"):
        chosen_frames(lengths, 30.0, 1, -1)


def test_every_picture_is_of_its_frame():
    lengths = np.array([130, 7])
    chosen = chosen_frames(lengths, 1.0, 1, 130)
    made = sprites(coloured, lengths, chosen, 1_000_000)
    assert [len(sheets) for sheets in made] == [2, 1] and len(made[0][0].frames) == ON_A_SHEET
    for start, length, sheets in zip((0, 130), lengths.tolist(), made, strict=True):
        assert [frame for sheet in sheets for frame in sheet.frames] == list(range(length))
        for sheet in map(vars, sheets):
            assert (sheet["width"], sheet["height"]) == (32, 24), "small images are not enlarged"
            for place, frame in enumerate(sheet["frames"]):
                (wanted,) = coloured(np.array([start + frame]))
                difference = picture(sheet, place).astype(int) - wanted
                assert np.abs(difference.mean((0, 1))).max() < 6


@settings(max_examples=12, deadline=None)
@given(
    lengths=st.lists(st.integers(1, 90), min_size=1, max_size=4),
    shape=st.sampled_from([(48, 64), (200, 60), (3, 400)]),
    budget=st.sampled_from([0, 300, 3000, 30_000, 300_000]),
)
def test_no_image_breaks_the_budget(lengths, shape, budget):
    lengths = np.array(lengths)
    chosen = chosen_frames(lengths, 10.0, 1, budget=max(budget, 1))
    made = sprites(noise(shape), lengths, chosen, budget)
    assert letters(made) <= budget
    for own, sheets in zip(chosen, made, strict=True):
        shown = [frame for sheet in sheets for frame in sheet.frames]
        assert set(shown) <= set(own.tolist()) and shown == sorted(shown)
        assert shown or budget < 300_000, "noise, too, is shown where there is room"


def test_every_demonstration_gets_its_share_of_a_small_budget():
    lengths = np.array([40] * 6)
    made = sprites(noise((48, 64)), lengths, chosen_frames(lengths, 10.0, 1), 60_000)
    shown = [sum(len(sheet.frames) for sheet in sheets) for sheets in made]
    assert 0 < min(shown) < 40 and max(shown) <= 2 * min(shown)
    assert max(letters([sheets]) for sheets in made) <= 20_000


def test_a_larger_budget_gives_larger_pictures():
    lengths = np.array([40])
    chosen = chosen_frames(lengths, 10.0, 1)
    widths = [
        sprites(noise((240, 320)), lengths, chosen, budget)[0][0].width for budget in (25_000, 60_000, BUDGET)
    ]
    assert widths == [64, 128, 192]


@pytest.mark.parametrize(
    ("images", "message"),
    [
        ([np.zeros((4, 4, 3), np.float32)], r"top has an image float32\[4, 4, 3\]: give RGB of bytes"),
        ([np.zeros((4, 4), np.uint8)], r"uint8\[4, 4\]"),
        ([np.zeros((0, 4, 3), np.uint8)], r"uint8\[0, 4, 3\]"),
        ([np.zeros((4, 4, 3), np.uint8), np.zeros((4, 5, 3), np.uint8)], "give one size"),
        ([np.zeros((4, 4, 3), np.uint8)] * 2, "top has 2 of the 3 images asked for"),
    ],
)
def test_images_that_are_none_are_refused(images, message):
    lengths = np.array([3])
    with pytest.raises(ValueError, match=message):
        sprites(lambda frames: iter(images), lengths, [np.arange(3)], 10_000, "top")
