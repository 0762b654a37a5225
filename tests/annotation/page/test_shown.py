"""Parts that do not fit together are refused in one line that names them."""

from dataclasses import replace

import numpy as np
import pytest

from dpmacro.annotation.page.shown import Curves, Shown, Truth, check
from tests.annotation.page.reading import some_stages

STAGES = some_stages()
FRAMES = len(STAGES.labels)


def test_what_fits_passes():
    check(STAGES, Shown(Truth(STAGES.labels, ("a", "b", "c")), (Curves(np.zeros((FRAMES, 2)), ("x", "y")),)))


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"lengths": np.array([], np.int64)}, "give demonstrations of one frame at least"),
        ({"lengths": np.array([60, 0, 90])}, r"lengths \[60, 0, 90\]: give demonstrations"),
        ({"lengths": np.array([60, 40, 51])}, "labels of 150 frames: the demonstrations have 151"),
        ({"episodes": (0, 1)}, "2 episodes of 3 lengths"),
        ({"names": ("a", "b", "a")}, r"stages \['a', 'b', 'a'\]: give names that are distinct"),
        ({"names": ("a", "b", " ")}, "not empty"),
        ({"names": ("a", "b")}, "labels from 0 to 2: give 0 to 1"),
        ({"labels": STAGES.labels - 1}, "labels from -1 to 1: give 0 to 2"),
        ({"confidence": np.full(FRAMES, 1.5)}, "confidence from 1.5 to 1.5: give 0 to 1"),
        ({"confidence": np.full(FRAMES, np.nan)}, "confidence from nan"),
        ({"timestamps": np.full(FRAMES, np.inf)}, "timestamps that are not finite"),
        ({"fps": 0.0}, "fps=0.0: give a positive number"),
    ],
)
def test_stages_that_contradict_themselves(changed, message):
    with pytest.raises(ValueError, match=message) as error:
        check(replace(STAGES, **changed), Shown())
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("shown", "message"),
    [
        (Shown(Truth(np.zeros(4, int), ("a",))), "truth of 4 frames: the demonstrations have 150"),
        (Shown(Truth(STAGES.labels, ("a",))), "truth from 0 to 2: give 0 to 0"),
        (Shown(curves=(Curves(np.zeros((4, 1)), ("x",)),)), "curve x of 4 frames"),
        (Shown(curves=(Curves(np.zeros((FRAMES, 2)), ("x",)),)), "curves of 2 numbers with 1 names"),
        (Shown(reasons=("only one",)), "1 reasons of 3 stages"),
    ],
)
def test_what_does_not_fit_the_stages(shown, message):
    with pytest.raises(ValueError, match=message):
        check(STAGES, shown)
