"""Parts that do not fit together are refused in one line that names them."""

import numpy as np
import pytest

from dpmacro.annotation.page.shown import Curves, Shown, Truth, check
from tests.annotation.page.reading import some_stages

STAGES = some_stages()
FRAMES = len(STAGES.labels)


def test_what_fits_passes():
    check(STAGES, Shown(Truth(STAGES.labels, ("a", "b", "c")), (Curves(np.zeros((FRAMES, 2)), ("x", "y")),)))


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
