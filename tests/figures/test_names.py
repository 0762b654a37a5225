"""Names from datasets in pictures: any text is shown as it is written, and a picture that fails is a line."""

import warnings

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from matplotlib.figure import Figure
from matplotlib.text import Text

from dpmacro.figures import (
    Line,
    column_bars,
    curves,
    heat_maps,
    learning_curve,
    save,
    success_chart,
    surviving,
    timeline,
    timelines,
    to_image,
)

LABELS = np.repeat([0, 1], 20)
ODD = (r"$\nope{$", "$$ two\nlines\t$ nul\0\x1b[1m \ud800 ^_\\ {x}%s")


def drawn(name):
    """A picture of every kind that shows names, each with this one."""
    names = (name, "other")
    images = np.zeros((2, 4, 5, 3), np.uint8)
    flat = np.zeros(40)
    yield timeline(
        {name: np.zeros((40, 4, 5, 3), np.uint8)}, LABELS, LABELS, LABELS, name, names, name, names
    )
    yield timeline({}, LABELS, [Line(name, flat)], None, name)
    yield timelines(LABELS, np.array([40]), LABELS, name, name, names)
    yield column_bars([{name: 1.0}, {}], names, name)
    yield heat_maps(images, np.ones((2, 4, 5)), names, name)
    yield curves({name: {name: [1.0, 2.0]}}, name)
    yield success_chart({name: {"success": 1}}, name)
    yield learning_curve({name: {5: (1, 2)}}, {name: (1, 2)}, name)


@pytest.mark.parametrize("name", ODD, ids=range(len(ODD)))
def test_a_picture_takes_any_name(name):
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph")  # the font lacks it
        for figure in drawn(name):
            assert to_image(figure).ndim == 3


@settings(max_examples=8, deadline=None)
@given(st.text(alphabet=st.characters() | st.sampled_from("$\\_^{}"), min_size=1, max_size=12))
def test_a_legend_takes_any_text(name):
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph")
        to_image(timelines(LABELS, np.array([40]), LABELS, name, name, (name, "other")))


def test_dollar_signs_are_shown_as_they_are_written(tmp_path):
    figure = curves({"a$^2$": {"x$_1$": [1.0, 2.0]}}, "cost in $")
    save(figure, tmp_path / "a.svg")
    assert {"a$^2$", "x$_1$", "cost in $"} <= {text.get_text() for text in figure.findobj(Text)}
    assert not any(text.get_parse_math() for text in figure.findobj(Text) if "$" in text.get_text())


def test_a_picture_that_fails_is_a_warning_and_no_more(tmp_path):
    told = r"^the picture one could not be made \(ValueError: a b\); nothing else depends on it$"
    with pytest.warns(UserWarning, match=told), surviving("one"):
        raise ValueError("a\n  b")
    with pytest.raises(KeyboardInterrupt), surviving("one"):
        raise KeyboardInterrupt
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with surviving("two"):
            save(Figure(), tmp_path / "two.png")
