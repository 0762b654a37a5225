from dataclasses import replace

import numpy as np
import pytest

from dpmacro.annotation.stages import Stages

N = 6
GOOD = Stages(
    labels=np.array([0, 0, 1, 1, 1, 0]),
    confidence=np.linspace(0, 1, N),
    idle=np.zeros(N, bool),
    corrected=np.arange(N) > 3,
    names=("reach", "carry it"),
    lengths=np.array([4, 2]),
    episodes=(7, 3),
    timestamps=np.array([0, 0.1, 0.2, 0.3, 0, 0.1]),
    fps=10.0,
)


def test_segments_count_frames_from_the_demonstrations_start():
    assert GOOD.segments == [[[0, 0, 2], [1, 2, 4]], [[1, 0, 1], [0, 1, 2]]]
    assert GOOD.trajectories == [slice(0, 4), slice(4, 6)]


def test_demonstrations_in_another_order():
    turned = GOOD.of_episodes((3, 7))
    assert turned.labels.tolist() == [1, 0, 0, 0, 1, 1]
    assert turned.lengths.tolist() == [2, 4] and turned.episodes == (3, 7)
    assert turned.corrected.tolist() == [True, True, False, False, False, False]
    assert turned.timestamps[2:].tolist() == GOOD.timestamps[:4].tolist()
    assert GOOD.of_episodes((3,)).labels.tolist() == [1, 0]


WRONG = {
    "no name": {"names": ()},
    "an empty name": {"names": ("reach", "  ")},
    "a name of two lines": {"names": ("reach", "carry\nit")},
    "a name twice": {"names": ("reach", "reach")},
    "a length of 0": {"lengths": np.array([6, 0])},
    "no demonstration": {"lengths": np.array([], np.int64), "episodes": ()},
    "an episode twice": {"episodes": (7, 7)},
    "an episode too few": {"episodes": (7,)},
    "no fps": {"fps": 0.0},
    "fps that is no number": {"fps": float("nan")},
    "a label without a name": {"labels": np.array([0, 0, 2, 1, 1, 0])},
    "a label below 0": {"labels": np.array([0, 0, -1, 1, 1, 0])},
    "confidence above 1": {"confidence": np.full(N, 1.5)},
    "confidence that is no number": {"confidence": np.full(N, np.nan)},
    "a time that is none": {"timestamps": np.full(N, np.inf)},
}


@pytest.mark.parametrize("changes", WRONG.values(), ids=WRONG)
def test_what_stages_cannot_be_is_said_in_a_line(changes):
    with pytest.raises(ValueError, match=rf"^(?:{'|'.join(changes)})\b.+: give ") as caught:
        replace(GOOD, **changes)
    assert "\n" not in str(caught.value)


def test_lengths_add_up_to_the_frames():
    with pytest.raises(ValueError, match=r"^labels have shape \[6\], lengths add up to 7: give one a frame$"):
        replace(GOOD, lengths=np.array([4, 3]))
