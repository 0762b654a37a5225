from dataclasses import replace

import av
import numpy as np
import pytest
from matplotlib.colors import to_rgb

from dpmacro.evaluation.videos import (
    OTHER_OUTCOME,
    STRIP,
    WIDTH,
    _action_text,
    drawn_run,
    write_run,
    write_video,
)
from dpmacro.figures import OUTCOME_COLOURS, macro_colour
from dpmacro.worlds.base import NO_PHASE, Moment


def run(steps=20, macros=(0, 1), outcome="red_first", height=240):
    for step in range(steps):
        view = np.full((height, 320, 3), 10 * step, np.uint8)
        last = step == steps - 1
        yield Moment(int(step > 5), step % 3, macros[step % len(macros)], 0.0, outcome if last else "", view)


def near(pixels, colour, tolerance=12):
    return np.abs(np.asarray(pixels, float) - 255 * np.array(to_rgb(colour))).max(-1) <= tolerance


def test_a_run_is_a_playable_video_of_its_steps_and_outcome(tmp_path):
    path = tmp_path / "run.mp4"
    assert write_run(path, run(), ["forward", "turn_left", "turn_right"], fps=10) == 35
    with av.open(str(path)) as video:
        stream = video.streams.video[0]
        frames = [frame.to_ndarray(format="rgb24") for frame in video.decode(stream)]
        assert (stream.codec_context.name, stream.codec_context.pix_fmt) == ("h264", "yuv420p")
        assert float(stream.average_rate) == 10
    assert len(frames) == 35 and frames[0].shape == (480 + STRIP, WIDTH, 3)
    assert all(abs(frames[step][100, 100].mean() - 10 * step) < 4 for step in range(20))
    assert list(tmp_path.iterdir()) == [path]


def test_the_strip_shows_the_macro_action_in_its_colour():
    frames = list(drawn_run(run(), fps=10))
    assert near(frames[4][490:500, 2:10], macro_colour(0)).all()
    assert near(frames[5][490:500, 2:10], macro_colour(1)).all()
    without = next(drawn_run(run(macros=[-1])))
    assert (without[490:500, 2:10] == 250).all()


def test_moments_without_a_picture_are_left_out_but_not_their_outcome():
    thinned = [
        replace(moment, view=moment.view if step % 3 == 0 else None)
        for step, moment in enumerate(run(steps=9))
    ]
    frames = list(drawn_run(thinned, fps=2))
    assert [round(frame[100, 100].mean()) for frame in frames] == [0, 30, 60, 60, 60, 60]
    assert near(frames[-1], OUTCOME_COLOURS["red_first"]).any()


@pytest.mark.parametrize("outcome", [*OUTCOME_COLOURS, "out_of_time"])
def test_the_outcome_fits_the_picture(outcome):
    *_, before, last = drawn_run(run(steps=1, outcome=outcome), fps=1)
    colour = OUTCOME_COLOURS.get(outcome, OTHER_OUTCOME)
    columns = np.flatnonzero(near(last, colour).any(0))
    assert before is not last
    assert columns.min() > 0 and columns.max() < WIDTH - 1


def test_the_strip_holds_the_longest_words():
    moment = Moment(1, 0, 7, 0.0, "", np.zeros((240, 320, 3), np.uint8))
    frame = next(drawn_run([moment] * 1, ["turn right by 0.6 deg"]))[480:]
    dark = (frame.max(-1) < 120).any(0)
    assert not dark[180:196].any() and not dark[290:308].any() and not dark[515:528].any()


@pytest.mark.parametrize("size", [2, 4, 9])
def test_the_strip_holds_the_numbers_of_a_vector_and_no_phase(size):
    moment = Moment(NO_PHASE, np.full(size, -10.04), 0, 0.0, "", np.zeros((240, 320, 3), np.uint8))
    frame = next(drawn_run([moment]))[480:]
    dark = (frame.max(-1) < 120).any(0)
    assert not dark[180:196].any() and dark[200:500].any() and not dark[515:528].any()


def test_numbers_that_round_to_nothing_have_no_sign_of_it():
    assert _action_text(np.array([-0.01, 0.26]), ()) == "+0.0 +0.3"


@pytest.mark.parametrize(
    ("write", "message"),
    [
        (lambda path: write_video(path, []), "no rendered frames"),
        (lambda path: write_video(path, [np.zeros((3, 4, 3), np.uint8)]), "4 x 3, both must be even"),
        (lambda path: write_run(path, [Moment(0, 0, 0, 0.0, "", None)]), "no rendered frames"),
    ],
)
def test_bad_input_leaves_no_file(write, message, tmp_path):
    with pytest.raises(ValueError, match=message):
        write(tmp_path / "run.mp4")
    assert not list(tmp_path.iterdir())
