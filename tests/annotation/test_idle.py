"""Idle stretches of signals that are made to stand still, and what must not change them."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from refusals import refused
from segmented import FRONT, IMAGE, STATE, random_demonstrations

from dpmacro.annotation.idle import idle_frames, moving_columns

FPS = 20


def ramp(*pieces):
    """A column that stands still for so many frames or, where negative, moves 1 a second."""
    steps = np.concatenate([np.full(abs(piece), (piece < 0) / FPS) for piece in pieces])
    return np.cumsum(steps)


def noisy(values, deviation, seed=0):
    return values + np.random.default_rng(seed).normal(size=values.shape) * deviation


def idle(values, lengths=None, fps=FPS, **more):
    values = values if values.ndim == 2 else values[:, None]
    return idle_frames(values, np.array([len(values)] if lengths is None else lengths), fps, **more)


def runs(marked):
    """First frame and end of every stretch."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], marked.astype(int), [0]])))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))


def test_it_stands_still_between_two_motions():
    assert runs(idle(ramp(-100, 60, -100))) == [(99, 160)]
    assert runs(idle(ramp(-100, 15, -100))) == [], "less than a second"
    assert runs(idle(ramp(-100, 15, -100), seconds=0.5)) == [(99, 115)]
    assert runs(idle(ramp(40, -100, 40))) == [(0, 40), (139, 180)]


@pytest.mark.parametrize("fps", [10, 29.97, 50])
@pytest.mark.parametrize("deviation", [0, 1e-6, 1e-3, 0.02])
def test_noise_of_any_size_is_no_motion(fps, deviation):
    still, moving = round(5 * fps), round(8 * fps)
    steps = np.concatenate([np.zeros(still), np.full(moving, 1 / fps), np.zeros(still)])
    marked = idle(noisy(np.column_stack([np.cumsum(steps), 0 * steps]), deviation), fps=fps)
    assert marked[:still].mean() > 0.9 and marked[-still:].mean() > 0.9
    assert marked[still + 2 : -still - 2].mean() < 0.05


@pytest.mark.parametrize("fps", [10, 30, 60])
def test_a_demonstration_of_nothing_but_noise_is_idle_as_a_whole(fps):
    assert idle(noisy(np.zeros((2000, 4)), 1), fps=fps).mean() > 0.99
    assert idle(np.full((50, 3), 7.0), fps=fps).all()


def test_what_never_rests_is_never_idle():
    time = np.arange(600) / FPS
    circle = np.column_stack([np.sin(time), np.cos(time)])
    for deviation in (0, 1e-4, 5e-3):
        assert not idle(noisy(circle, deviation)).any()
    walk = np.random.default_rng(0).normal(size=(2000, 3)).cumsum(0)
    assert idle(walk).mean() < 0.01


def test_slow_motion_is_motion():
    values = np.concatenate([ramp(-200), 10 + np.arange(200) * 0.02 / FPS])
    assert not idle(values)[200:].any(), "a fiftieth of the fastest"
    assert not idle(noisy(values, 1e-4))[200:].any()


def test_every_column_has_to_rest():
    values = np.column_stack([ramp(-100, 100, -100), ramp(-150, 150)])
    assert runs(idle(values)) == [(149, 200)]


def test_a_gripper_that_closes_while_the_arm_stands_still_ends_the_rest():
    gripper = np.repeat([0.0, 1], [160, 140])
    assert runs(idle(np.column_stack([ramp(-100, 100, -100), gripper]))) == [(99, 159), (161, 200)]
    gripper = np.repeat([0.0, 1], [110, 190])
    assert runs(idle(np.column_stack([ramp(-100, 100, -100), gripper]))) == [(110, 200)]


def test_a_glitch_and_a_flickering_digit_are_no_motion():
    arm, wrist = ramp(-100, 100, -100), np.zeros(300)
    wrist[np.random.default_rng(0).choice(300, 12, replace=False)] = 0.1  # an encoder's last digit
    arm[150] += 5
    [(start, end)] = runs(idle(np.column_stack([arm, wrist])))
    assert abs(start - 99) <= 3 and abs(end - 200) <= 3


def test_what_is_missing_says_nothing():
    values = np.column_stack([ramp(-100, 100, -100), ramp(-300)])
    values[:, 1] = np.nan
    values[120:125, 0] = np.inf
    marked = idle(values)
    assert runs(marked) == [(99, 120), (125, 200)], "frames without any number are not idle"
    assert not idle(np.full((50, 2), np.nan)).any()


def test_short_demonstrations_are_idle_as_a_whole_or_not_at_all():
    values = np.concatenate([ramp(-100), np.full(7, 3.0), ramp(-7), [5.0]])
    marked = idle(values, [100, 7, 7, 1])
    assert marked.tolist() == [False] * 100 + [True] * 7 + [False] * 8


SIGNALS = st.lists(st.integers(-40, 40).filter(bool), min_size=1, max_size=8)


@st.composite
def recordings(draw):
    """Columns that rest now and then, some with noise, and the lengths of demonstrations."""
    size = draw(st.integers(2, 200))
    columns = []
    for seed in range(draw(st.integers(1, 3))):
        column = np.resize(ramp(*draw(SIGNALS)), size)
        columns.append(noisy(column, draw(st.sampled_from([0, 0, 1e-4, 0.05])), seed))
    cuts = sorted(draw(st.sets(st.integers(1, size - 1), max_size=3)))
    values = np.round(np.column_stack(columns) * 2**20) / 2**20  # sums with whole numbers are exact
    return values, np.diff([0, *cuts, size]), draw(st.sampled_from([5, 10, 20, 30.0062]))


@settings(max_examples=150, deadline=None)
@given(recordings(), st.integers(-1000, 1000), st.integers(-20, 20), st.booleans(), st.randoms())
def test_units_and_the_order_of_columns_and_demonstrations_change_nothing(
    problem, shift, power, sign, random
):
    values, lengths, fps = problem
    marked = idle(values, lengths, fps)
    assert np.array_equal(idle((values + shift) * (2.0**power * (-1) ** sign), lengths, fps), marked)
    assert np.array_equal(idle(np.repeat(values, 2, 1)[:, ::-1], lengths, fps), marked)
    order = random.sample(range(len(lengths)), len(lengths))
    parts, labels = (np.split(one, np.cumsum(lengths)[:-1]) for one in (values, marked))
    mixed = idle(np.concatenate([parts[k] for k in order]), lengths[order], fps)
    assert np.array_equal(mixed, np.concatenate([labels[k] for k in order]))


@settings(max_examples=150, deadline=None)
@given(recordings(), st.sampled_from([0.3, 1.0, 2.0]))
def test_a_stretch_lasts_as_long_as_it_must_or_a_whole_demonstration(problem, seconds):
    values, lengths, fps = problem
    for part in np.split(idle(values, lengths, fps, seconds=seconds), np.cumsum(lengths)[:-1]):
        least = min(max(2, math.ceil(seconds * fps)), len(part))
        assert all(end - start >= least for start, end in runs(part))


def test_the_last_digit_of_float32_is_no_motion():
    values = np.repeat(np.float32([1e4, np.nextafter(np.float32(1e4), np.float32(2e4))]), [100, 100])
    assert idle(values).all()
    assert not idle(values.astype(np.float64)).all()
    seen = random_demonstrations(keys=(STATE, IMAGE), vector=True)
    assert moving_columns(seen).dtype == np.float32


def test_states_and_actions_are_looked_at_or_else_images():
    assert moving_columns(random_demonstrations(keys=(STATE, IMAGE), vector=True)).shape == (28, 8)
    assert moving_columns(random_demonstrations(keys=(STATE, IMAGE))).shape == (28, 4)
    assert moving_columns(random_demonstrations(vector=True)).shape == (28, 4)
    seen = random_demonstrations(keys=(IMAGE, FRONT))
    columns = moving_columns(seen)
    assert columns.shape == (28, 32)
    image = seen.observations[FRONT][5]
    assert columns[5, 16] == pytest.approx(image[:3, :4].mean()), "a corner of the second camera"
    assert columns[5, 31] == pytest.approx(image[-3:, -4:].mean())
    blind = replace(seen, observations={"task_index": np.zeros(28, np.int64)})
    assert moving_columns(blind).shape == (28, 0)
    assert not idle_frames(moving_columns(blind), blind.lengths, 10).any()


def test_images_of_a_still_scene_are_idle():
    rng = np.random.default_rng(0)
    images = np.repeat(rng.integers(0, 200, (1, 24, 32, 3)), 90, 0) + rng.integers(0, 9, (90, 24, 32, 3))
    for frame in range(30, 60):
        images[frame, 8:16, frame - 30 : frame - 24] = 255
    seen = replace(
        random_demonstrations(),
        observations={IMAGE: images.astype(np.uint8)},
        actions=np.zeros(90, np.int64),
        truth=None,
        lengths=np.array([90]),
    )
    marked = idle_frames(moving_columns(seen), seen.lengths, FPS)
    assert marked[:28].all() and marked[62:].all() and not marked[32:56].any()


def test_what_makes_no_sense_is_refused():
    refused("lengths", idle_frames, np.zeros((5, 1)), np.array([4]), 10)
    refused("fps", idle_frames, np.zeros((5, 1)), np.array([5]), 0)
    refused("fps", idle_frames, np.zeros((5, 1)), np.array([5]), math.nan)
    refused("seconds", idle_frames, np.zeros((5, 1)), np.array([5]), 10, -1)
