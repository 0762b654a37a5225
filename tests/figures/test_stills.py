from itertools import combinations

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg

from dpmacro.figures import Still, Strip, film_strips, macro_colour, to_image
from dpmacro.figures.style import DPI, GREYS
from tests.figures.test_figures import coloured, drawn_texts


def still(macro=0, shade=128, what="blue touched", when="step 2999", size=(240, 320)):
    state = f"macro-action {macro}, phase 1"
    return Still(np.full((*size, 3), shade, np.uint8), what, when, state, macro)


NAMES = ("changed early", "change missed", "red in the way", "out of time", "pressed")


def page(title=""):
    note = "200 of 1200 failures\nseed 10199\nafter 3000 steps:\nblue never reached"
    return film_strips([Strip(name, note, [still(column) for column in range(5)]) for name in NAMES], title)


@pytest.mark.parametrize(
    "figure",
    [
        page,
        lambda: page("Why runs fail"),
        lambda: film_strips([Strip("walked into the other flag", "seed 1", [still()])]),
        lambda: film_strips([Strip("dithers", "seed 1", []), Strip("spins", "seed 2", [still(), still()])]),
    ],
)
def test_no_text_overlaps_another_or_a_picture_or_leaves_the_page(figure):
    drawn = figure()
    FigureCanvasAgg(drawn).draw()
    boxes = [(text.get_text(), text.get_window_extent()) for text in drawn_texts(drawn)]
    boxes += [("a picture", axis.get_window_extent()) for axis in drawn.axes]
    for text, box in boxes:
        assert drawn.bbox.x0 <= box.x0 and box.x1 <= drawn.bbox.x1, text
        assert drawn.bbox.y0 <= box.y0 and box.y1 <= drawn.bbox.y1, text
    for (first, one), (second, other) in combinations(boxes, 2):
        assert not one.overlaps(other), f"{first!r} over {second!r}"


def test_five_pictures_fill_a_readme():
    assert page().get_figwidth() * DPI == pytest.approx(1200, abs=20)


def test_a_frame_has_the_colour_of_its_macro_action():
    image = to_image(film_strips([Strip("spins", "", [still(0), still(1), still(1), still(-1)])]))
    one, two, grey = (coloured(image, c).sum() for c in (macro_colour(0), macro_colour(1), GREYS[2]))
    assert two == pytest.approx(2 * one, rel=0.05) and grey == pytest.approx(one, rel=0.05) and one > 500


def test_rows_and_pictures_stand_in_their_order():
    shades = [[40, 90], [150, 220]]
    strips = [Strip(str(row), "", [still(0, shade) for shade in line]) for row, line in enumerate(shades)]
    image = to_image(film_strips(strips))
    places = [np.median(np.argwhere((image == shade).all(-1)), 0) for line in shades for shade in line]
    (first, second), (third, fourth) = places[:2], places[2:]
    assert first[0] == second[0] < third[0] == fourth[0]
    assert first[1] == third[1] < second[1] == fourth[1]


def test_pictures_keep_their_shape():
    for size in ((240, 320), (48, 48)):
        box = film_strips([Strip("spins", "", [still(size=size)])]).axes[0].get_window_extent()
        assert box.width / box.height == pytest.approx(size[1] / size[0])


@pytest.mark.parametrize("strips", [[], [Strip("spins", "", [])]])
def test_a_page_needs_a_picture(strips):
    with pytest.raises(ValueError, match=f"^{len(strips)} rows without a picture"):
        film_strips(strips)
