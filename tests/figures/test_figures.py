import io
from collections import Counter
from itertools import combinations, pairwise

import matplotlib.image
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgb
from matplotlib.text import Text

from dpmacro.discovery.model_order import Point
from dpmacro.figures import (
    OUTCOME_COLOURS,
    Line,
    column_bars,
    curves,
    edge_counts,
    elbow,
    heat_maps,
    learning_curve,
    macro_colour,
    save,
    selection_chart,
    success_chart,
    timeline,
    timelines,
    to_image,
    to_png,
    transition_graph,
)
from dpmacro.figures.style import GREYS, PALETTE, faded, shortened
from dpmacro.metrics.success import wilson_interval


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


def busy_timeline():
    images, _, actions, _ = demonstration(60, 1)
    classes = np.repeat(np.arange(15), 4)
    names = [f"subgoal number {number}" for number in range(15)]
    confidence = np.linspace(0, 1, 60, dtype=np.float32)
    return timeline(images, classes % 7, actions, classes, "Busy", (), "subgoal", names, confidence)


def sure_timelines():
    lengths = np.array([90, 30, 40])
    labels, confidence = np.arange(160) // 40, np.linspace(0, 1, 160)
    return timelines(labels, lengths, labels, "", "subgoal", ("open", "go"), confidence, [7, 123, 9])


def lines(frames, count, labels=None):
    """Walks at random, the first of them a gripper that opens and closes with every macro-action."""
    values = np.cumsum(np.random.default_rng(0).normal(size=(frames, count)), 0) / frames**0.5
    if labels is not None:
        values[:, 0] = labels % 2 * 2.0 - 1
    names = ["gripper", *(f"left_arm_joint_with_a_long_name_{k}.pos" for k in range(1, count))]
    return [Line(name, values[:, k], k == 0) for k, name in enumerate(names)]


def vectors(frames=5000, macros=12, count=8, cameras=("front", "wrist_left")):
    images, _, _, _ = demonstration(frames, 1)
    labels = np.arange(frames) * macros // frames
    names, confidence = [f"stage {number}" for number in range(macros)], np.linspace(0, 1, frames)
    seen = {camera: images[:, : 48 - 12 * place] for place, camera in enumerate(cameras)}
    truth = labels[::-1].copy() if cameras else None
    return timeline(
        seen, labels, lines(frames, count, labels), truth, "Vectors", (), "stage", names, confidence
    )


def bars(macros):
    rng = np.random.default_rng(macros)
    names = [f"left_arm_joint_{k}.pos - right_arm_joint_{k}.pos, change over 15 frames" for k in range(9)]
    weights = [
        dict(zip([*names, "camera front"], rng.random(10).tolist(), strict=True)) for _ in range(macros)
    ]
    return column_bars(weights, [f"macro-action {q}, 12% of frames" for q in range(macros)], "Columns")


def points(bounds):
    return [
        Point(q, s, 0.03 * q - 0.01 * (q - 2) ** 2 * s, 0.008 * s, s % 2 > 0, 0.8 * s)
        for q in (2, 3, 4)
        for s in bounds(q)
    ]


def random_graph(macros):
    labels = np.random.default_rng(0).integers(0, macros, 300)
    return transition_graph(labels, np.full(60, 5), "Transitions")


def random_heat(macros):
    rng = np.random.default_rng(0)
    return heat_maps(
        rng.integers(0, 256, (macros, 6, 8, 3), np.uint8), rng.random((macros, 6, 8)), (), "Heat"
    )


OUTCOMES = {
    "baseline": {"success": 10, "red_first": 30, "red_never_reached": 10},
    "DPBoost, 2 macro-actions": {"success": 0, "blue_never_reached": 1},
    "teacher": {"success": 3},
}
CURVE = {
    "baseline, one classifier": {20: (24, 100), 5: (10, 100), 10: (0, 100), 50: (30, 100), 100: (33, 100)},
    "DPBoost, 2 macro-actions": {5: (40, 100), 10: (55, 100), 20: (100, 100), 50: (70, 100)},
    "DPBoost, 4 macro-actions": {20: (1, 2)},
}
PICTURES = {
    "timeline": long_timeline,
    "short timeline": lambda: timeline(*demonstration(3, 1)[:3]),
    "one frame": lambda: timeline(*demonstration(1, 1)),
    "vectors, two cameras": vectors,
    "vectors, no camera": lambda: vectors(300, 2, 3, ()),
    "one frame of a vector": lambda: timeline({}, np.array([0]), [Line("x", np.array([0.5]))]),
    "no camera, no number": lambda: timeline({}, np.array([0, 1]), []),
    "classes without a camera": lambda: timeline({}, *demonstration(900, 300)[1:]),
    "bars of one": lambda: bars(1),
    "bars of three": lambda: bars(3),
    "bars of twelve": lambda: bars(12),
    "bars of nothing": lambda: column_bars([{}, {"x": 0.0}, {"x": 1.0}]),
    "timelines": many_timelines,
    "two timelines of twelve": lambda: timelines(
        np.tile(np.arange(12), 4),
        np.array([24, 24]),
        np.arange(48) % 12,
        "Two",
        "stage",
        list("abcdefghijkl"),
    ),
    "timelines without truth": lambda: timelines(np.array([0, 1, 1]), np.array([2, 1])),
    "curves": lambda: curves(
        {q: {"baseline": [3.0, 2.0], "DPBoost": [1.0]} for q in ["loss", "accuracy", "changes", "x"]}
    ),
    "one curve": lambda: curves({"loss": {"DPBoost": [1.0, 0.5]}}, "Training"),
    "success": lambda: success_chart(OUTCOMES, "TwoFlags-v0, random flags"),
    "busy timeline": busy_timeline,
    "sure timelines": sure_timelines,
    "selection by bound": lambda: selection_chart(points(lambda q: range(1, 6)), 4, "Which Q and S"),
    "selection by macros": lambda: selection_chart(points(lambda q: [q]), 1, "Which Q"),
    "one macro-action chosen": lambda: selection_chart(points(lambda q: [q - 1, 2 * q - 2])),
    "one point": lambda: selection_chart(points(lambda q: [1])[:1], 0),
    "learning curve": lambda: learning_curve(CURVE, {"teacher": (88, 100)}, "Random flags"),
    "one point of a curve": lambda: learning_curve({"baseline": {1: (0, 1)}}),
    "elbow": lambda: elbow(np.array([3.0, 1.0, 0.9]), 1, "Cost"),
    "steep elbow": lambda: elbow(np.array([80.0, 1.0, 0.9]), 2),
    "one bound": lambda: elbow(np.array([3.0])),
    "graph of one": lambda: random_graph(1),
    "graph of two": lambda: random_graph(2),
    "graph of eight": lambda: random_graph(8),
    "heat of one": lambda: random_heat(1),
    "heat of five": lambda: random_heat(5),
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


def test_a_timeline_has_a_row_for_every_camera_and_number():
    texts = [axis.get_ylabel() for axis in vectors().axes]
    assert texts[:5] == ["front", "wrist_left", "true stage", "macro-action", "gripper"] and len(texts) == 12
    assert texts[5] == "left_arm_jo…name_1.pos"
    assert [axis.get_ylabel() for axis in vectors(300, 2, 2, ()).axes][:2] == ["macro-action", "gripper"]
    heights = [axis.get_position().height for axis in vectors().axes]
    assert heights[4] == pytest.approx(2 * heights[5], rel=0.05)
    assert heights[0] == pytest.approx(4 / 3 * heights[1], rel=0.05)  # 48 and 36 pixels tall


def test_a_line_lies_where_its_numbers_are_over_its_macro_actions():
    labels = np.repeat([0, 1], 50)
    values = np.repeat([-1.0, 3.0], 50)
    figure = timeline({}, labels, [Line("gripper", values)])
    axis = figure.axes[1]
    drawn, zero = axis.lines[1].get_ydata(), axis.lines[0].get_ydata()[0]
    assert drawn[:50] == pytest.approx(0.08) and drawn[50:] == pytest.approx(0.92)
    assert (zero - 0.08) / 0.84 == pytest.approx(1 / 4)
    strip = strip_of(figure, 1)
    for half, macro in ((strip[:, :500], 0), (strip[:, -500:], 1)):
        shade = faded(np.array(to_rgb(macro_colour(macro))), np.array(0.22))
        assert coloured(half, shade).mean() > 0.6


@pytest.mark.parametrize(("values", "top"), [([0.1, -0.1], 0.5 + 0.042), ([0.0, 9.0], 0.92)])
def test_a_tremor_does_not_fill_a_row_and_what_is_far_off_is_cut(values, top):
    figure = timeline({}, np.array([0, 0]), [Line("x", np.array(values))])
    assert max(figure.axes[1].lines[1].get_ydata()) == pytest.approx(top)


def test_a_part_of_a_line_is_that_of_its_frames():
    part = Line("x", np.arange(5.0), True).part(slice(2, 4))
    assert part.values.tolist() == [2, 3] and (part.name, part.tall) == ("x", True)


def test_twelve_macro_actions_have_colours_of_their_own():
    shades = np.array([to_rgb(macro_colour(macro)) for macro in range(12)])
    assert len(PALETTE) == 12
    assert min(np.abs(one - other).sum() for one, other in combinations(shades, 2)) > 0.3


def test_bars_are_shares_of_all_columns_the_largest_first():
    weights = [{"a": 1.0, "b": 6.0, "c": 0.0, "d": 3.0}, {"a": 0.0}]
    figure = column_bars(weights, most=2)
    first, second = figure.axes
    assert [bar.get_width() for bar in first.patches] == pytest.approx([0.6, 0.3])
    assert [text.get_text() for text in first.texts] == ["b", "60%", "d", "30%"]
    assert not second.patches and [text.get_text() for text in second.texts] == ["none"]
    assert [axis.get_title(loc="left") for axis in figure.axes] == ["macro-action 0", "macro-action 1"]
    assert first.get_ylim()[0] > first.get_ylim()[1]
    with pytest.raises(ValueError, match=r"^there are no weights: "):
        column_bars([])


@given(st.text(max_size=40), st.integers(3, 30))
def test_a_shortened_text_keeps_its_ends(text, letters):
    short = shortened(text, letters)
    assert len(short) <= letters and short[0:1] == text[0:1] and short[-1:] == text[-1:]
    assert short == text or (len(short) == letters and "…" in short)


def test_timelines_draw_every_demonstration_at_its_length():
    image = to_image(timelines(np.zeros(300, np.int64), np.array([200, 100])))
    widths = coloured(image, macro_colour(0)).sum(1)
    assert {200 * int(width) // widths.max() // 5 * 5 for width in widths if width > 50} == {100, 200}


@pytest.mark.parametrize("count", [1, 2, 30])
def test_rows_are_named_by_the_numbers_of_their_demonstrations(count):
    numbers = [100 + row for row in range(count)]
    figure = timelines(np.zeros(50 * count, np.int64), np.full(count, 50), numbers=numbers)
    to_image(figure)
    named = {label.get_text() for label in figure.axes[0].get_yticklabels()} - {""}
    assert named and named <= {str(number) for number in numbers}


def test_curves_draw_every_line():
    image = to_image(curves({"loss": {"baseline": [3.0, 2.0, 1.5], "DPBoost": [3.0, 1.0, 0.2]}}))
    assert all(coloured(image, macro_colour(line)).sum() > 200 for line in (0, 1))


def test_a_success_chart_splits_runs_by_outcome():
    image = to_image(success_chart({"baseline": {"success": 10, "red_first": 30}}))
    row = image[:, : image.shape[1] * 3 // 4]
    success, red_first = (coloured(row, OUTCOME_COLOURS[kind]).sum() for kind in ("success", "red_first"))
    assert red_first / success == pytest.approx(3, abs=0.3)
    image = to_image(success_chart({"four": {"success": 10, "green_first": 20}, "two": {"red_first": 30}}))
    row = image[: image.shape[0] // 2, : image.shape[1] * 3 // 4]
    success, green_first = (coloured(row, shade).sum() for shade in (OUTCOME_COLOURS["success"], GREYS[1]))
    assert green_first / success == pytest.approx(2, abs=0.3), "outcomes of other worlds are drawn, too"


@pytest.mark.parametrize("suffix", [".png", ".svg", ".pdf"])
def test_save_writes_the_format_of_the_suffix(suffix, tmp_path):
    path = tmp_path / "pictures" / f"success{suffix}"
    save(success_chart(OUTCOMES), path)
    assert list(path.parent.iterdir()) == [path]
    start = {".png": b"\x89PNG", ".svg": b"<?xml", ".pdf": b"%PDF"}[suffix]
    assert path.read_bytes().startswith(start)
    if suffix == ".png":
        assert matplotlib.image.imread(path).std() > 0.05


def strip_of(figure, row):
    """The pixels of a row of a timeline."""
    image = to_image(figure)
    box = figure.axes[row].get_window_extent()
    return image[
        len(image) - int(box.y1) + 2 : len(image) - int(box.y0) - 2, int(box.x0) + 2 : int(box.x1) - 2
    ]


def test_confidence_fades_a_colour_to_white():
    images, labels, actions, _ = demonstration(900, 900)
    for sure, colour in (
        (1.0, macro_colour(0)),
        (0.0, "white"),
        (0.5, faded(np.array(to_rgb(macro_colour(0))), np.array(0.5))),
    ):
        figure = timeline(images, labels, actions, confidence=np.full(900, sure, np.float32))
        assert coloured(strip_of(figure, 1), colour).mean() > 0.9


def test_confidence_is_drawn_where_it_is():
    confidence = (np.arange(900) < 300).astype(np.float32)
    strip = strip_of(timeline(*demonstration(900, 900)[:3], confidence=confidence), 1)
    sure = coloured(strip, macro_colour(0)).mean(0) > 0.5
    assert sure.mean() == pytest.approx(1 / 3, abs=0.03) and sure[: len(sure) // 4].all()
    page = to_image(timelines(np.zeros(900, np.int64), np.array([600, 300]), confidence=confidence))
    widths = coloured(page, macro_colour(0)).sum(1)
    assert (widths > 200).any() and not coloured(page[len(page) // 2 : -60], macro_colour(0)).any()


@given(st.floats(0, 1), st.lists(st.floats(0, 1), min_size=3, max_size=3))
def test_fading_goes_from_white_to_the_colour(confidence, colour):
    rgb = np.array(colour)
    result = faded(rgb[None], np.array([confidence]))[0]
    assert np.allclose(result, confidence * rgb + (1 - confidence))
    assert (faded(rgb[None], np.array([0.0])) == 1).all()


def test_true_classes_are_named_where_there_is_room_and_in_the_legend():
    images, labels, actions, truth = demonstration(900, 300)
    texts = [text.get_text() for text in drawn_texts(timeline(images, labels, actions, truth))]
    assert "true class" in texts and "0" in texts
    names = ("before blue", "after blue")
    figure = timeline(images, labels, actions, truth, "", (), "phase", names)
    texts = [text.get_text() for text in drawn_texts(figure)]
    assert (
        "true phase" in texts
        and set(names) <= set(texts)
        and {"0: before blue", "1: after blue"} <= set(texts)
    )
    figure = sure_timelines()
    to_image(figure)
    texts = [text.get_text() for text in drawn_texts(figure)]
    assert {"true: open", "true: go", "true subgoal 2", "7", "123", "9", "pale: unsure"} <= set(texts)


@given(st.lists(st.lists(st.integers(0, 3), min_size=1, max_size=8), min_size=1, max_size=5))
def test_edges_are_the_changes_between_stretches(trajectories):
    expected = Counter()
    for trajectory in trajectories:
        expected["start", str(trajectory[0])] += 1
        expected[str(trajectory[-1]), "end"] += 1
        expected.update((str(a), str(b)) for a, b in pairwise(trajectory) if a != b)
    lengths = np.array([len(trajectory) for trajectory in trajectories])
    assert edge_counts(np.concatenate([np.array(part) for part in trajectories]), lengths) == expected


def test_a_graph_shows_counts_and_shares():
    labels = np.array([0, 0, 0, 1] * 3 + [0, 1, 0, 0])
    texts = {text.get_text() for text in drawn_texts(transition_graph(labels, np.full(4, 4)))}
    assert {"0\n75%", "1\n25%", "start", "end"} <= texts and {"4", "3", "1"} <= texts


def test_heat_lies_on_the_weighted_pixel():
    weights = np.zeros((2, 6, 8))
    weights[0, 1, 6] = 5.0
    figure = heat_maps(np.full((2, 6, 8, 3), 128, np.uint8), weights)
    assert "macro-action 0" in [text.get_text() for text in drawn_texts(figure)]
    hot = [figure.axes[place].images[-1].get_array() for place in (2, 3)]
    assert hot[0][1, 6, 3] == 1 and hot[0][..., 3].sum() == 1 and not hot[1][..., 3].any()
    red = hot[0][1, 6]
    assert red[0] > 2 * red[1]


def marks(axis):
    return [line for line in axis.lines if line.get_markersize() == 15]


def test_a_selection_has_a_line_for_every_number_of_macro_actions_and_marks_the_chosen():
    rows = points(lambda q: range(1, 6))
    gains, changes = selection_chart(rows, 7).axes
    assert len(gains.containers) == len(changes.lines) - 1 == 3
    for axis, value in ((gains, rows[7].gain), (changes, rows[7].changes)):
        (marked,) = marks(axis)
        assert marked.get_ydata() == [value] and marked.get_xdata()[0] == pytest.approx(3, abs=0.2)
    for number, container in enumerate(gains.containers):
        own = rows[5 * number : 5 * number + 5]
        whiskers = np.array(container.lines[2][0].get_segments())[:, :, 1]
        wanted = [[row.gain - row.error, row.gain + row.error] for row in own]
        assert whiskers == pytest.approx(np.array(wanted))
        assert container.lines[0].get_ydata() == pytest.approx([row.gain for row in own])
        assert changes.lines[number].get_ydata() == pytest.approx([row.changes for row in own])
    assert gains.get_xlabel() == "bound S on transitions" and gains.get_title(loc="left").endswith("chosen)")


def test_a_selection_with_one_bound_for_every_number_has_one_line_over_the_numbers():
    rows = points(lambda q: [q])[::-1]  # in any order
    gains, changes = selection_chart(rows, 1).axes
    (container,) = gains.containers
    assert container.lines[0].get_xdata() == pytest.approx([2, 3, 4])
    assert container.lines[0].get_ydata() == pytest.approx([row.gain for row in rows[::-1]])
    assert [marks(axis)[0].get_xdata() for axis in (gains, changes)] == [[3.0], [3.0]]
    assert gains.get_xlabel() == changes.get_xlabel() == "macro-actions Q"


def test_a_selection_of_one_macro_action_marks_the_line_at_no_gain():
    def zero(axis):
        (line,) = [line for line in axis.lines if list(line.get_ydata()) == [0, 0]]
        return line.get_linewidth()

    rows = points(lambda q: [q, q + 1])
    one, other = selection_chart(rows).axes[0], selection_chart(rows, 0).axes[0]
    assert zero(one) > 2 * zero(other)
    assert not marks(one) and len(marks(other)) == 1
    assert one.get_ylim()[0] <= 0 <= one.get_ylim()[1]
    with pytest.raises(ValueError, match="no points"):
        selection_chart([])


def test_a_selection_of_one_point_counts_in_whole_numbers():
    figure = selection_chart(points(lambda q: [1])[:1], 0)
    to_image(figure)
    for axis in figure.axes:
        low, high = axis.get_xlim()
        shown = [tick for tick in axis.get_xticks() if low <= tick <= high]
        assert shown == [round(tick) for tick in shown]


def test_a_learning_curve_has_every_point_with_its_interval():
    figure = learning_curve(CURVE, {"teacher": (88, 100)})
    [axis] = figure.axes
    curves_drawn = [container for container in axis.containers if container.has_yerr]
    for counts, drawn in zip(CURVE.values(), curves_drawn, strict=True):
        line, _, [bars] = drawn.lines
        numbers = sorted(counts)
        assert line.get_xdata() == pytest.approx(numbers, rel=0.1)
        assert line.get_ydata() == pytest.approx([counts[n][0] / counts[n][1] for n in numbers])
        ends = [tuple(segment[:, 1]) for segment in bars.get_segments()]
        assert ends == [pytest.approx(wilson_interval(*counts[n])) for n in numbers]
    assert [line.get_ydata()[0] for line in axis.lines if line.get_linestyle() == "--"] == [0.88]
    [band] = axis.patches
    assert (band.get_y(), band.get_y() + band.get_height()) == pytest.approx(wilson_interval(88, 100))
    FigureCanvasAgg(figure).draw()
    assert [label.get_text() for label in axis.get_xticklabels()] == ["5", "10", "20", "50", "100"]


@pytest.mark.parametrize("counts", [{}, {0: (1, 2), 5: (1, 2)}])
def test_a_learning_curve_needs_demonstrations(counts):
    with pytest.raises(ValueError, match=r"^teacher has points at \["):
        learning_curve({"teacher": counts})


def test_an_elbow_marks_its_bound():
    axis = elbow(np.array([3.0, 1.0, 0.9]), 1).axes[0]
    line, marked = axis.lines
    assert line.get_ydata().tolist() == [3, 1, 0.9] and (marked.get_xdata(), marked.get_ydata()) == (
        [1],
        [1.0],
    )


def test_a_png_is_what_save_writes(tmp_path):
    figure = elbow(np.array([3.0, 1.0]))
    save(figure, tmp_path / "elbow.png")
    pixels = [matplotlib.image.imread(file) for file in (tmp_path / "elbow.png", io.BytesIO(to_png(figure)))]
    assert np.array_equal(*pixels)
