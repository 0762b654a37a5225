"""A trajectory encoded frame by frame has the columns of one encoded at once."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from dpmacro.features.base import frame_bytes, frames_before, frames_lagged
from dpmacro.features.history import History, Recording
from dpmacro.features.kinds import make_encoder
from tests.features.observed import FRONT, SPECS, STATE, TASK, observe


@given(lengths=st.lists(st.integers(1, 7), max_size=5), lag=st.integers(0, 9))
def test_lagged_frames_stay_in_their_trajectory(lengths, lag):
    expected = []
    for length in lengths:
        start = len(expected)
        expected += [start + max(n - lag, 0) for n in range(length)]
    assert frames_lagged(torch.tensor(lengths, dtype=torch.int64), lag).tolist() == expected
    if lag == 1:
        assert frames_before(torch.tensor(lengths, dtype=torch.int64)).tolist() == expected


@settings(max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 2**16),
    keys=st.lists(st.sampled_from(list(SPECS)), min_size=1, unique=True),
    rows=st.lists(st.lists(st.integers(1, 9), min_size=1, max_size=4), min_size=1, max_size=4),
    window=st.integers(2, 6),
    some=st.booleans(),
)
def test_frame_by_frame_is_all_at_once(seed, keys, rows, window, some):
    """Rows of a batch hold trajectories one after another, which end at different times."""
    generator = torch.Generator().manual_seed(seed)
    encoder = make_encoder({key: SPECS[key] for key in keys}, "rectangles", 9, window, 1, generator)
    if some:
        encoder = encoder.select(torch.randperm(encoder.count, generator=generator)[:4].sort().values)
    steps = min(map(sum, rows))
    recorded, wanted = [], []
    for row, lengths in enumerate(rows):
        observations = observe(sum(lengths), seed + row, keys)
        recorded.append(observations)
        recording = Recording(observations, torch.tensor(lengths))
        wanted.append(encoder.values(recording.seen(encoder))[:, :steps])
    firsts = [set(np.cumsum(lengths).tolist()) for lengths in rows]
    history = History.start(encoder, len(rows))
    for step in range(steps):
        which = torch.tensor([step in first for first in firsts])
        if which.any():
            history = history.restart(which)
        now = {key: torch.stack([one[key][step] for one in recorded]) for key in keys}
        seen, history = history.push(now)
        assert set(seen) == set(encoder.lags)
        values = encoder.values(seen)
        assert torch.equal(values, torch.stack([one[:, step] for one in wanted], 1))
        for value in now.values():
            value.fill_(1)  # the caller may write to what it gave


def test_no_more_is_remembered_than_is_needed():
    encoder = make_encoder(SPECS, "rectangles", 9, 5, 1, torch.Generator())
    history = History.start(encoder, 2)
    for step in range(8):
        _, history = history.push(observe(2, step))
    assert {key: len(past) for key, past in history.past.items()} == {
        key: 1 if "images" in key else 5 for key in SPECS if key != TASK
    }


def test_a_history_is_not_changed_by_what_comes_after():
    encoder = make_encoder({STATE: SPECS[STATE]}, "pixels", 0, 2, 1, torch.Generator())
    first, second, third = (observe(2, seed, (STATE,)) for seed in range(3))
    _, early = History.start(encoder, 2).push(first)
    late = early.restart(torch.tensor([True, False]))
    late.restart(torch.tensor([False, True]))
    seen, _ = early.push(second)
    assert torch.equal(seen[1][STATE], first[STATE])
    seen, _ = late.push(third)
    assert torch.equal(seen[2][STATE][0], third[STATE][0]) and torch.equal(seen[2][STATE][1], first[STATE][1])
    which = torch.tensor([False, False])
    waiting = early.restart(which)
    which[:] = True
    seen, _ = waiting.push(second)
    assert torch.equal(seen[1][STATE], first[STATE])


def test_a_restart_before_the_first_frame_and_two_in_one_frame():
    encoder = make_encoder({STATE: SPECS[STATE]}, "pixels", 0, 2, 1, torch.Generator())
    first, second = observe(2, 0, (STATE,)), observe(2, 1, (STATE,))
    _, history = History.start(encoder, 2).restart(torch.tensor([True, False])).push(first)
    twice = history.restart(torch.tensor([True, False])).restart(torch.tensor([False, True]))
    seen, _ = twice.push(second)
    assert torch.equal(seen[1][STATE], second[STATE])


def test_what_is_missing_is_named():
    encoder = make_encoder({STATE: SPECS[STATE]}, "pixels", 0, 2, 1, torch.Generator())
    with pytest.raises(ValueError, match=r"no observation\.state, only task_index"):
        History.start(encoder, 2).push(observe(2, 0, (TASK,)))
    with pytest.raises(ValueError, match=r"observation\.state has 3 rows: the policy was started with 2"):
        History.start(encoder, 2).push(observe(3, 0, (STATE,)))
    with pytest.raises(ValueError, match=r"task_index has 3 frames, the trajectories have 4"):
        Recording(observe(3, 0, (TASK,)), torch.tensor([1, 3]))
    with pytest.raises(ValueError, match=r"no observation\.state was recorded, only task_index"):
        Recording(observe(3, 0, (TASK,)), torch.tensor([3])).seen(encoder)


def test_the_bytes_of_a_frame_are_those_of_all_keys():
    assert frame_bytes(observe(3, 0, (FRONT, STATE, TASK))) == 6 * 8 * 3 + 3 * 4 + 8
