from itertools import combinations

import matplotlib.image
import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgb
from matplotlib.text import Text

from dpmacro.figures import (
    OUTCOME_COLOURS,
    curves,
    macro_colour,
    save,
    success_chart,
    timeline,
    timelines,
    to_image,
)


def demonstration(frames, change):
    labels = (np.arange(frames) >= change).astype(np.int64)
    images = np.broadcast_to(
        np.linspace(0, 255, frames).astype(np.uint8)[:, None, None, None], (frames, 48, 64, 3)
    )
    return images, labels, np.arange(frames) % 3, (np.arange(frames) >= frames // 2).astype(np.int64)


def long_timeline():
    images, labels, actions, truth = demonstration(900, 300)
    return timeline(images, labels, actions, truth, "Demonstration 3", ["forward", "turn left", "turn right"])


def many_timelines():
    lengths = np.array([900, 30, 400] * 8)
    labels = np.concatenate([demonstration(int(length), 20)[1] for length in lengths])
    return timelines(labels, lengths, labels[::-1].copy(), "24 demonstrations")


OUTCOMES = {
    "baseline": {"success": 10, "red_first": 30, "red_never_reached": 10},
    "DPBoost, 2 macro-actions": {"success": 0, "blue_never_reached": 1},
    "teacher": {"success": 3},
}
PICTURES = {
    "timeline": long_timeline,
    "short timeline": lambda: timeline(*demonstration(3, 1)[:3]),
    "one frame": lambda: timeline(*demonstration(1, 1)),
    "timelines": many_timelines,
    "timelines without truth": lambda: timelines(np.array([0, 1, 1]), np.array([2, 1])),
    "curves": lambda: curves(
        {q: {"baseline": [3.0, 2.0], "DPBoost": [1.0]} for q in ["loss", "accuracy", "changes", "x"]}
    ),
    "one curve": lambda: curves({"loss": {"DPBoost": [1.0, 0.5]}}, "Training"),
    "success": lambda: success_chart(OUTCOMES, "TwoFlags-v0, random flags"),
}


def coloured(image, colour):
    return np.abs(image.astype(int) - np.round(255 * np.array(to_rgb(colour)))).max(-1) <= 2


def drawn_texts(figure):
    """Every text that is drawn: matplotlib also keeps labels of ticks beyond the axes, and hidden ones."""
    axes = [axis for axis in figure.axes if axis.get_visible()]
    ticks = set()
    for direction in [direction for axis in axes for direction in (axis.xaxis, axis.yaxis)]:
        low, high = sorted(direction.get_view_interval())
        for place, tick in zip(direction.get_majorticklocs(), direction.get_major_ticks(), strict=False):
            if low <= place <= high and tick.label1.get_visible():
                ticks.add(tick.label1)
    all_ticks = {
        label
        for axis in figure.axes
        for direction in (axis.xaxis, axis.yaxis)
        for tick in [*direction.get_major_ticks(), *direction.get_minor_ticks()]
        for label in (tick.label1, tick.label2)
    }
    free = [text for text in figure.findobj(Text) if text not in all_ticks and text.get_visible()]
    return [text for text in [*free, *ticks] if text.get_text() and (text.axes is None or text.axes in axes)]


@pytest.mark.parametrize("picture", PICTURES)
def test_no_text_overlaps_another_or_leaves_the_picture(picture):
    figure = PICTURES[picture]()
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    boxes = [(text.get_text(), text.get_window_extent()) for text in drawn_texts(figure)]
    assert boxes
    for text, box in boxes:
        assert figure.bbox.x0 - 1 <= box.x0 and box.x1 <= figure.bbox.x1 + 1, text
        assert figure.bbox.y0 - 1 <= box.y0 and box.y1 <= figure.bbox.y1 + 1, text
    for (first, one), (second, other) in combinations(boxes, 2):
        assert not one.overlaps(other), f"{first!r} over {second!r}"


def test_a_timeline_shows_macro_actions_over_their_frames():
    image = to_image(long_timeline())
    first, second = (coloured(image, macro_colour(macro)).sum() for macro in (0, 1))
    assert second / (first + second) == pytest.approx(2 / 3, abs=0.02)
    only = to_image(timeline(*demonstration(900, 900)[:3]))
    assert coloured(only, macro_colour(0)).any() and not coloured(only, macro_colour(1)).any()


def test_timelines_draw_every_demonstration_at_its_length():
    image = to_image(timelines(np.zeros(300, np.int64), np.array([200, 100])))
    widths = coloured(image, macro_colour(0)).sum(1)
    assert {200 * int(width) // widths.max() // 5 * 5 for width in widths if width > 50} == {100, 200}


def test_curves_draw_every_line():
    image = to_image(curves({"loss": {"baseline": [3.0, 2.0, 1.5], "DPBoost": [3.0, 1.0, 0.2]}}))
    assert all(coloured(image, macro_colour(line)).sum() > 200 for line in (0, 1))


def test_a_success_chart_splits_runs_by_outcome():
    image = to_image(success_chart({"baseline": {"success": 10, "red_first": 30}}))
    row = image[:, : image.shape[1] * 3 // 4]
    success, red_first = (coloured(row, OUTCOME_COLOURS[kind]).sum() for kind in ("success", "red_first"))
    assert red_first / success == pytest.approx(3, abs=0.3)


@pytest.mark.parametrize("suffix", [".png", ".svg", ".pdf"])
def test_save_writes_the_format_of_the_suffix(suffix, tmp_path):
    path = tmp_path / "pictures" / f"success{suffix}"
    save(success_chart(OUTCOMES), path)
    assert list(path.parent.iterdir()) == [path]
    start = {".png": b"\x89PNG", ".svg": b"<?xml", ".pdf": b"%PDF"}[suffix]
    assert path.read_bytes().startswith(start)
    if suffix == ".png":
        assert matplotlib.image.imread(path).std() > 0.05
