"""MimicGen's signals, by its rule for where a subtask ends, written again from its description."""

from pathlib import Path

import h5py
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from staged import some_stages

from dpmacro.annotation.exports.base import Labelled
from dpmacro.annotation.exports.dataset import write_labels
from dpmacro.annotation.exports.mimicgen import MimicGen
from dpmacro.data.lerobot.reader import StoredDataset

NOTHING = StoredDataset(Path(), {}, {}, [])


def subtasks(demonstration, signals):
    """First frame and end (excluded) of every subtask.

    A subtask is over at the first frame at which its signal goes from 0 to 1; this frame still belongs to it.
    The last subtask has no signal and ends with the demonstration. No subtask may be empty.
    """
    found, start = [], 0
    group = demonstration["datagen_info/subtask_term_signals"]
    for name in [*signals, None]:
        if name is None:
            end = demonstration.attrs["num_samples"]
        else:
            values = group[name][:].astype(int)
            rises = np.flatnonzero(values[1:] - values[:-1])
            assert len(rises), f"{name} never changes"
            end = int(rises[0]) + 2
        assert end > start, f"{name} is empty"
        found.append((start, end))
        start = end
    return found


def test_subtasks_are_the_segments(stored, stages, tmp_path):
    write_labels(stored, tmp_path / "out", stages, ["mimicgen"])
    with h5py.File(tmp_path / "out/mimicgen.hdf5") as file:
        assert sorted(file["data"]) == [f"demo_{episode}" for episode in range(4)]
        for episode, segments in enumerate(stages.segments):
            demonstration = file[f"data/demo_{episode}"]
            signals = demonstration["datagen_info/subtask_term_signals"]
            assert set(signals) == {"reach", "carry it"}
            assert all(set(np.unique(values)) == {0, 1} for values in signals.values())
            assert subtasks(demonstration, ["reach", "carry it"]) == [(s, e) for _, s, e in segments]


@given(st.lists(st.lists(st.integers(1, 6), min_size=3, max_size=3), min_size=1, max_size=3))
@settings(max_examples=40, deadline=None)
def test_subtasks_of_any_length(tmp_path_factory, parts):
    labels = np.concatenate([np.repeat([2, 0, 1], of_one) for of_one in parts])
    stages = some_stages([sum(of_one) for of_one in parts], ("b", "c", "a"), labels=labels)
    export = MimicGen(Labelled(NOTHING, stages, {}))
    if min(of_one[0] for of_one in parts) == 1:
        assert "has one frame, so that its signal never changes" in export.refusal()
        return
    assert export.refusal() is None
    path = tmp_path_factory.mktemp("signals") / "file.hdf5"
    export.make()["mimicgen.hdf5"](path)
    with h5py.File(path) as file:
        for episode, segments in enumerate(stages.segments):
            assert subtasks(file[f"data/demo_{episode}"], ["a", "b"]) == [(s, e) for _, s, e in segments]


@pytest.mark.parametrize(
    ("names", "message"),
    [(("a/b", "c"), "a stage is called 'a/b', which no HDF5 path can be"), ((".", "c"), "is called '.'")],
)
def test_names_that_are_no_paths(names, message):
    stages = some_stages([4, 4], names)
    assert message in MimicGen(Labelled(NOTHING, stages, {})).refusal()


def test_one_stage_has_no_signal():
    stages = some_stages([4, 4], ("all of it",), labels=np.zeros(8))
    assert "there is one stage only" in MimicGen(Labelled(NOTHING, stages, {})).refusal()
