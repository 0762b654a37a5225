"""Runs of a recording that was stopped are there again, each number as it was."""

import shutil

import numpy as np
import pyarrow as pa
import pytest
from noise import as_run, random_episodes

from dpmacro.evaluation import kept_recording
from dpmacro.evaluation.kept_recording import KeptRuns, keeping_runs
from dpmacro.evaluation.recording import Run

ABOUT = {"world": {"id": "Room-v0"}, "seed": 3}


def several():
    """Runs of classes and of vectors, with and without views; names out of their alphabetical order."""
    yield as_run(**next(random_episodes((4,))), views=np.zeros((4, 6, 8, 3), np.uint8))
    yield None
    yield Run(
        {"z": np.ones((3, 2), np.float32), "a": np.zeros((3, 4, 4, 3), np.uint8)},
        np.arange(6, dtype=np.float32).reshape(3, 2),
        {"y": np.arange(3), "b": np.arange(3)},
        np.ones(3, np.float32),
        "",
        success=False,
    )


def same(one, other):
    if one is None or other is None:
        return one is other
    assert (one.task, one.success, list(one.observations)) == (
        other.task,
        other.success,
        list(other.observations),
    )
    assert list(one.truth) == list(other.truth) and (one.views is None) == (other.views is None)
    pairs = [(one.actions, other.actions), (one.rewards, other.rewards)]
    pairs += [(one.observations[key], other.observations[key]) for key in one.observations]
    pairs += [(one.truth[name], other.truth[name]) for name in one.truth]
    pairs += [] if one.views is None else [(one.views, other.views)]
    return all(a.dtype == b.dtype and np.array_equal(a, b) for a, b in pairs)


def stopped(root, runs):
    """A recording that is stopped after these runs."""
    with pytest.raises(KeyboardInterrupt), keeping_runs(root, ABOUT) as kept:
        for run in runs:
            kept.add(run)
        raise KeyboardInterrupt


def test_runs_come_back_in_order_and_as_they_were(tmp_path):
    stopped(tmp_path / "d", several())
    assert [path.name for path in tmp_path.iterdir()] == [".d.recording"]
    with keeping_runs(tmp_path / "d", ABOUT) as kept:
        assert (kept.tried, kept.episodes) == (3, 2)
        for one, other in zip(several(), kept.runs(), strict=True):
            assert same(one, other)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("runs", [[], [None, None]])
def test_where_no_run_succeeded_nothing_is_left(tmp_path, runs):
    stopped(tmp_path / "d", runs)
    assert list(tmp_path.iterdir()) == []


def test_other_recordings_are_refused_and_the_runs_stay(tmp_path):
    stopped(tmp_path / "d", several())
    with (
        pytest.raises(ValueError, match=r"begun with seed 3, and now it is 4; run .*remove the folder"),
        keeping_runs(tmp_path / "d", {**ABOUT, "seed": 4}),
    ):
        pass
    assert KeptRuns(tmp_path / ".d.recording", ABOUT).tried == 3


def test_a_file_without_its_line_is_written_again(tmp_path):
    """The process was killed between the two."""
    stopped(tmp_path / "d", several())
    folder = tmp_path / ".d.recording"
    lines = (folder / "runs.jsonl").read_text().splitlines(keepends=True)
    (folder / "runs.jsonl").write_text("".join(lines[:3]) + '{"frames": ')
    kept = KeptRuns(folder, ABOUT)
    assert kept.tried == 2
    kept.add(list(several())[2])
    assert same(list(several())[2], list(KeptRuns(folder, ABOUT).runs())[2])


@pytest.mark.parametrize("damage", ["cut", "gone", "other", "huge"])
def test_damaged_runs_are_refused_in_one_line(tmp_path, monkeypatch, damage):
    stopped(tmp_path / "d", several())
    path = tmp_path / ".d.recording/000000.safetensors.zst"
    if damage == "cut":
        path.write_bytes(path.read_bytes()[:-40])
    elif damage == "gone":
        path.unlink()
    elif damage == "other":
        with pa.output_stream(str(path), compression="zstd") as stream:
            stream.write(b"\0" * 100)
    else:
        monkeypatch.setattr(kept_recording, "LARGEST", 1000)
        monkeypatch.setattr(kept_recording, "RATIO", 0)
    with pytest.raises(ValueError, match=r"000000\.safetensors\.zst: cannot be read .*remove") as raised:
        list(KeptRuns(tmp_path / ".d.recording", ABOUT).runs())
    assert "\n" not in str(raised.value)


def test_what_a_complete_recording_left_goes(tmp_path):
    stopped(tmp_path / "d", several())
    (tmp_path / "d/meta").mkdir(parents=True)
    (tmp_path / "d" / kept_recording.WORLD_FILE).write_text("{}")
    with pytest.raises(KeyboardInterrupt), keeping_runs(tmp_path / "d", {**ABOUT, "seed": 9}):
        raise KeyboardInterrupt
    assert [path.name for path in tmp_path.iterdir()] == ["d"]


def test_a_half_built_dataset_goes(tmp_path):
    stopped(tmp_path / "d", several())
    building = KeptRuns(tmp_path / ".d.recording", ABOUT).building
    (building / "dataset").mkdir(parents=True)
    assert not KeptRuns(tmp_path / ".d.recording", ABOUT).building.exists()
    shutil.rmtree(tmp_path / ".d.recording")
