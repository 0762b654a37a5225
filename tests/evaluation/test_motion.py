"""Whether a run still moves at its end, and whether it goes round in circles."""

import numpy as np
import pytest

from dpmacro.evaluation.motion import END, Motion

T = np.arange(2 * END)
RNG = np.random.default_rng(0)


def period(*vectors, pictures=None):
    """Of a run with one number a vector, and pictures of one grey."""
    motion = Motion()
    for t in range(len(vectors[0])):
        shown = {"observation.state": np.array([vector[t] for vector in vectors], np.float32)}
        if pictures is not None:
            shown["observation.image"] = np.full((2, 2, 3), pictures[t], np.uint8)
        motion.see(shown)
    return motion.period()


STOPPED = np.minimum(T, 20) / 20
WAVE = np.sin(2 * np.pi * T / 8)


@pytest.mark.parametrize(
    ("vectors", "pictures", "expected"),
    [
        ([STOPPED], None, 1),
        ([STOPPED, STOPPED + 0.001 * RNG.normal(size=len(T))], None, 1),  # it trembles
        ([1 + 1e-9 * T], None, 1),  # in float32 it rounds up once
        ([T], None, 0),
        ([T**0.5], None, 0),
        ([WAVE], None, 8),
        ([STOPPED, WAVE], None, 8),
        ([WAVE, T], None, 0),
        ([np.sin(2 * np.pi * T / 40)], None, 0),  # longer than half of what is kept
        ([RNG.normal(size=len(T))], None, 0),
        ([STOPPED], T % 3, 3),
        ([STOPPED], np.minimum(T, 5), 1),
        ([STOPPED], T % 251, 0),
        ([WAVE], T % 4, 8),
        ([WAVE], T % 251, 0),
        ([np.zeros(len(T))], None, 1),
        ([STOPPED[: END - 1]], None, 0),  # too short to tell
    ],
)
def test_periods(vectors, pictures, expected):
    assert period(*vectors, pictures=pictures) == expected


def test_a_long_vector_is_compared_as_a_picture_is():
    motion, same = Motion(), Motion()
    for t in range(END):
        motion.see({"observation.state": np.full(20_000, t, np.float32)})
        same.see({"observation.state": np.full(20_000, 3, np.float32)})
    assert (motion.period(), same.period()) == (0, 1)
