"""State columns against loops over frames, dimensions and lags."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from dpmacro.features.encoders.state import State
from dpmacro.features.history import Recording
from dpmacro.features.kinds import encoder_from

KEY = "observation.state"


def expected(state, lengths, kept, window):
    """By name, every column with all pairs: plain loops, one subtraction of two float32 each."""
    columns = {}
    firsts = np.repeat(np.cumsum(lengths) - lengths, lengths)
    for i in kept:
        rows = np.empty((3, len(state)), np.float32)
        for n, first in enumerate(firsts):
            rows[0, n] = state[n, i]
            rows[1, n] = state[n, i] - state[max(n - 1, first), i]
            rows[2, n] = state[n, i] - state[max(n - window, first), i]
        columns[f"d{i}"], columns[f"d{i}, change over 1 frame"] = rows[0], rows[1]
        columns[f"d{i}, change over {window} frames"] = rows[2]
        for j in kept:
            if i < j:
                columns[f"d{i} - d{j}"] = state[:, i] - state[:, j]
    return columns


@settings(max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 2**16),
    lengths=st.lists(st.integers(1, 12), min_size=1, max_size=4),
    size=st.integers(1, 6),
    window=st.integers(2, 9),
    pairs=st.integers(0, 20),
    chunk=st.sampled_from([1, 40, 2**20]),
    data=st.data(),
)
def test_columns_are_values_changes_and_differences(seed, lengths, size, window, pairs, chunk, data):
    kept = data.draw(st.lists(st.integers(0, size - 1), unique=True).map(sorted))
    random = np.random.default_rng(seed)
    scale = 10.0 ** random.integers(-6, 7, size)
    state = (scale * random.standard_normal((sum(lengths), size))).astype(np.float32)
    generator = torch.Generator().manual_seed(seed)
    encoder = State.make(KEY, [f"d{i}" for i in range(size)], window, pairs, generator, kept)
    names, possible = encoder.names(), len(kept) * (len(kept) - 1) // 2
    assert encoder.count == len(names) == len(set(names)) == 3 * len(kept) + min(pairs, possible)
    recording = Recording({KEY: torch.from_numpy(state)}, torch.tensor(lengths))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("dpmacro.features.encoders.state.CHUNK_VALUES", chunk)
        values = encoder.values(recording.seen(encoder))
    wanted = expected(state, lengths, kept, window)
    assert set(names) <= set(wanted)
    assert values.dtype == encoder.dtype == torch.float32 and values.shape == (len(names), len(state))
    for name, column in zip(names, values.numpy(), strict=True):
        np.testing.assert_array_equal(column, wanted[name], name)
    columns = torch.randperm(encoder.count, generator=generator)[: data.draw(st.integers(0, 5))]
    few = encoder.select(columns)
    few = encoder_from(few.spec(), few.tensors())
    assert few.names() == [names[k] for k in columns]
    assert torch.equal(few.values(recording.seen(few)), values[columns])
    assert set(few.lags) == {0} | {lag for name in few.names() for lag in (1, window) if f"r {lag} f" in name}


def test_columns_are_named_as_the_dataset_names_dimensions():
    encoder = State.make(KEY, ["pan", "lift"], 8, 1, torch.Generator())
    assert encoder.names() == [
        "pan",
        "lift",
        "pan, change over 1 frame",
        "lift, change over 1 frame",
        "pan, change over 8 frames",
        "lift, change over 8 frames",
        "pan - lift",
    ]
    assert encoder.keys == (KEY,) and encoder.lags == (0, 1, 8) and encoder.needs == {KEY: (0, 1, 8)}
    assert encoder.footprint(torch.ones(2, 7)) == {} and not encoder.sees_pixels.any()


def test_pairs_are_drawn_only_where_there_are_more():
    def draw(pairs, seed):
        generator = torch.Generator().manual_seed(seed)
        names = State.make(KEY, [str(i) for i in range(10)], 2, pairs, generator).names()[30:]
        return names, torch.equal(generator.get_state(), torch.Generator().manual_seed(seed).get_state())

    (all_pairs, untouched), (few, drawn) = draw(45, 0), draw(20, 0)
    assert untouched and not drawn and len(all_pairs) == 45
    assert few == [name for name in all_pairs if name in set(few)] and len(few) == 20
    assert draw(20, 0)[0] == few != draw(20, 1)[0]


def test_states_of_other_types_are_taken_as_float32():
    encoder = State.make(KEY, ["x"], 2, 0, torch.Generator()).select(torch.tensor([0]))
    seen = {0: {KEY: torch.tensor([[1.1], [2.2]], dtype=torch.float64)}}
    assert torch.equal(encoder.values(seen), torch.tensor([[1.1, 2.2]]))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"window": 1}, "window is 1"),
        ({"pairs": -1}, "number of pairs is -1"),
        ({"kept": [0, 2]}, r"no dimension 2: it has 0\.\.1"),
    ],
)
def test_bad_options_are_named(options, message):
    with pytest.raises(ValueError, match=message):
        State.make(KEY, ["x", "y"], **{"window": 2, "pairs": 1, "generator": torch.Generator(), **options})


def test_another_size_is_named():
    encoder = State.make(KEY, ["x", "y"], 2, 1, torch.Generator())
    seen = {lag: {KEY: torch.zeros(4, 3)} for lag in (0, 1, 2)}
    with pytest.raises(ValueError, match=r"observation\.state is 3: the columns are for 2"):
        encoder.values(seen)
    with pytest.raises(ValueError, match=r"observation\.state of 2 frames back is missing: there is none"):
        encoder.values({lag: {KEY: torch.zeros(4, 2)} for lag in (0, 1)})
