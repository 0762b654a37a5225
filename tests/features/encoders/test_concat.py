"""Columns side by side against those of every part by itself."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from dpmacro.features.encoders.concat import Concat
from dpmacro.features.encoders.pixels import Pixels
from dpmacro.features.encoders.rectangles import Rectangles
from dpmacro.features.encoders.state import State
from dpmacro.features.encoders.task import Task
from dpmacro.features.history import Recording
from dpmacro.features.kinds import StateSpec, blank_observation, encoder_from, make_encoder
from tests.features.observed import FRONT, OTHER, SPECS, STATE, TASK, TOP, observe


def parts_of(seed):
    generator = torch.Generator().manual_seed(seed)
    return [
        Rectangles.draw(FRONT, 6, 8, 7, generator),
        Pixels.all(TOP, 5, 4).select(torch.arange(0, 120, 11)),
        Rectangles.draw(TOP, 5, 4, 3, generator),
        State.make(STATE, "xyz", 3, 2, generator),
        State.make(OTHER, "xw", 2, 1, generator),
        Task.all(3),
    ]


@settings(max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 2**16),
    chosen=st.lists(st.integers(0, 5), min_size=1, unique=True),
    lengths=st.lists(st.integers(1, 6), min_size=1, max_size=3),
    data=st.data(),
)
def test_columns_of_every_part_stand_side_by_side(seed, chosen, lengths, data):
    parts = [parts_of(seed)[number] for number in chosen]
    recording = Recording(observe(sum(lengths), seed), torch.tensor(lengths))
    whole = Concat.of(parts)
    alone = [part.values(recording.seen(part)).numpy() for part in parts]
    rows = [(p, k) for p, part in enumerate(parts) for k in range(part.count)]
    columns = data.draw(st.lists(st.integers(0, len(rows) - 1), max_size=12))
    if data.draw(st.booleans()):
        columns = sorted(set(columns))
    picked = whole.select(torch.tensor(columns, dtype=torch.int64))
    for encoder, numbers in ((whole, range(len(rows))), (picked, columns)):
        encoder = encoder_from(encoder.spec(), encoder.tensors())
        values = encoder.values(recording.seen(encoder))
        used = [p for p, part in enumerate(parts) if any(rows[n][0] == p for n in numbers)]
        floats = [p for p in used if parts[p].kind == "state"]
        wanted = torch.int32 if not floats else torch.float32 if len(used) == 1 else torch.float64
        assert encoder.count == len(numbers) and values.shape == (len(numbers), sum(lengths))
        if used:
            assert values.dtype == encoder.dtype
            assert values.dtype == wanted or (
                wanted == torch.float32 and len(encoder.spec().get("parts", "")) > 1
            )
            assert {key for p in used for key in parts[p].keys} == set(encoder.keys)
        for row, number in zip(values.numpy(), numbers, strict=True):
            part, column = rows[number]
            np.testing.assert_array_equal(row.astype(np.float64), alone[part][column].astype(np.float64))
            assert bool(encoder.sees_pixels[list(numbers).index(number)]) == (
                parts[part].kind in ("rectangles", "pixels")
            )


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 2**16))
def test_weights_fall_on_the_camera_of_their_column(seed):
    parts = parts_of(seed)
    whole = Concat.of(parts)
    weights = torch.rand(2, whole.count, generator=torch.Generator().manual_seed(seed))
    found, expected, start = whole.footprint(weights), {}, 0
    for part in parts:
        for camera, added in part.footprint(weights[:, start : start + part.count]).items():
            expected[camera] = expected.get(camera, 0) + added
        start += part.count
    assert list(found) == [FRONT, TOP]
    for camera, footprint in found.items():
        torch.testing.assert_close(footprint, expected[camera], rtol=0, atol=0)
    total = sum(footprint.sum((1, 2)) for footprint in found.values())
    torch.testing.assert_close(total, weights[:, : 7 + 11 + 3].double().sum(1))


def test_a_part_without_columns_disappears_and_a_single_one_stays_itself():
    parts = parts_of(0)
    whole = Concat.of(parts)
    assert whole.keys == (FRONT, TOP, STATE, OTHER, TASK) and whole.lags == (0, 1, 2, 3)
    assert whole.needs == {FRONT: (0, 1), TOP: (0, 1), STATE: (0, 1, 3), OTHER: (0, 1, 2), TASK: (0,)}
    state = whole.select(torch.tensor([21, 22]))
    assert isinstance(state, State) and state.names() == ["x", "y"] and state.needs == {STATE: (0,)}
    two = whole.select(torch.tensor([0, 22]))
    assert [part.kind for part in two.parts] == ["rectangles", "state"] and two.keys == (FRONT, STATE)
    none = whole.select(torch.tensor([], dtype=torch.int64))
    assert none.count == 0 and none.keys == (FRONT,)
    assert none.values({lag: observe(4, 0) for lag in (0, 1)}).shape == (0, 4)
    assert Concat.of([Concat.of(parts[:2]), parts[3]]).parts == (parts[0], parts[1], parts[3])
    assert Concat.of([parts[3]]) is parts[3]
    with pytest.raises(ValueError, match="no encoder"):
        Concat.of([])


def test_a_name_that_two_parts_share_says_which():
    names = Concat.of(parts_of(0)).names()
    assert len(names) == len(set(names))
    assert names[21:24] == ["x of state", "y", "z"] and "x of environment_state" in names
    assert names[-3:] == ["task 0", "task 1", "task 2"]
    assert names[0].startswith("rectangle in front: ") and names[7] == "pixel in top: R at (0, 0)"
    assert names[20].count(" at (") == 2 and " minus at (" in names[20], "a difference of two rectangles"


def test_float64_holds_large_sums_and_small_states_exactly():
    sums = Rectangles(
        FRONT,
        400,
        400,
        torch.tensor([[0, 0, 0, 400, 400]], dtype=torch.int32),
        torch.zeros(1, 5, dtype=torch.int32),
    )
    image = torch.full((1, 400, 400, 3), 255, dtype=torch.uint8)
    image[0, 0, 0] = 254
    state = State.make(STATE, ["x"], 2, 0, torch.Generator()).select(torch.tensor([0]))
    seen = {lag: {FRONT: image, STATE: torch.tensor([[0.1]])} for lag in (0, 1)}
    values = Concat.of([sums, state]).values(seen)
    assert values[:, 0].tolist() == [255 * 400 * 400 - 1, torch.tensor(0.1).double().item()]


def test_a_blank_observation_is_all_that_is_looked_at():
    whole = Concat.of(parts_of(0))
    for encoder in (whole, whole.parts[0]):
        blank = blank_observation(encoder, 2)
        assert {key: (value.shape, value.dtype) for key, value in blank.items()} == {
            key: (value.shape, value.dtype) for key, value in observe(2, 0, encoder.keys).items()
        }
        assert encoder.values(dict.fromkeys(encoder.lags, blank)).shape == (encoder.count, 2)


def test_rectangles_of_one_camera_are_drawn_as_without_anything_else():
    def draw(keys):
        specs = {key: SPECS[key] for key in keys}
        return make_encoder(specs, "rectangles", 20, 4, 2, torch.Generator().manual_seed(5))

    alone, among = draw([FRONT]), draw([STATE, FRONT, TASK])
    expected = Rectangles.draw(FRONT, 6, 8, 20, torch.Generator().manual_seed(5))
    for encoder in (alone, among.parts[0]):
        assert torch.equal(encoder.first, expected.first) and torch.equal(encoder.second, expected.second)
    assert [part.kind for part in among.parts] == ["rectangles", "state", "task"]


def test_rectangles_are_divided_among_cameras():
    encoder = make_encoder(SPECS, "rectangles", 7, 4, 1, torch.Generator().manual_seed(0))
    assert [(part.keys, part.count) for part in encoder.parts] == [
        ((FRONT,), 4),
        ((TOP,), 3),
        ((STATE,), 2 * 3 + 1),
        ((OTHER,), 2 * 3 + 1),
        ((TASK,), 3),
    ]
    pixels = make_encoder(SPECS, "pixels", 0, 4, 1, torch.Generator())
    assert [part.count for part in pixels.parts[:2]] == [6 * 6 * 8, 6 * 5 * 4]


@pytest.mark.parametrize(
    ("keys", "kind", "rectangles", "message"),
    [
        ([], "rectangles", 5, "nothing is seen"),
        (["still"], "rectangles", 5, "nothing varies in still"),
        ([STATE], "hog", 5, "'hog'"),
        ([FRONT], "rectangles", 0, "is 0: draw 1 at least"),
        ([FRONT, TOP], "rectangles", 1, "is 1: draw 2 at least, one for each camera"),
    ],
)
def test_what_cannot_be_made_is_named(keys, kind, rectangles, message):
    with pytest.raises(ValueError, match=message):
        specs = {**SPECS, "still": StateSpec(("x",), ())}
        make_encoder({key: specs[key] for key in keys}, kind, rectangles, 4, 2, torch.Generator())


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"kind": "hog"}, "'hog'"),
        ({"kind": None}, "None"),
        ({"width": "8", "depth": 3}, "rectangles cannot be made of"),
    ],
)
def test_a_spec_that_is_none_is_named(change, message):
    part = parts_of(0)[0]
    with pytest.raises(ValueError, match=message):
        encoder_from({**part.spec(), **change}, part.tensors())
    whole = Concat.of(parts_of(0))
    with pytest.raises(ValueError, match=r"tensor '6\.first' is of no part: there are 6"):
        encoder_from(whole.spec(), {**whole.tensors(), "6.first": torch.zeros(1)})
