"""TensorBoard's events where their file cannot be written: one warning, and the run goes on."""

import os
import resource
import subprocess
import sys
import threading
import warnings
from pathlib import Path

import numpy as np
import pytest
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from dpmacro.policy.policy import MacroPolicy
from dpmacro.utils.events import Events, doing_without
from dpmacro.utils.lines import threads_in_a_line
from tests.helpers.limited import limited

LARGEST = 40_000  # bytes of a file: enough for the policy and each stage, too few for the events
SCRIPT = Path(__file__).parents[1] / "parallel/quick_train.py"
QUICK = [
    "--planner.switch_weight=0",
    "--planner.rounds=60",
    "--planner.restarts=1",
    "--planner.rectangles=150",
    "--planner.switch_rounds=5",
    "--dataset.image_size=[32,24]",
    "--save_freq=5",
]


def test_what_is_written_can_be_read(tmp_path):
    with Events(tmp_path) as events:
        events.add_scalar("a", 1.5, 3)
        events.add_text("b", "text")
        events.add_image("c", np.zeros((2, 3, 3), np.uint8), dataformats="HWC")
    read = EventAccumulator(str(tmp_path)).Reload()
    assert [(one.step, one.value) for one in read.Scalars("a")] == [(3, 1.5)]
    assert read.Tags()["images"] == ["c"] and read.Tags()["tensors"] == ["b/text_summary"]


@pytest.mark.parametrize("size", [10, 5000])
def test_a_full_disk_is_one_warning(tmp_path, size, capsys):
    """Also where not even the first bytes fit; the thread that writes says nothing of its own."""
    with limited(size), warnings.catch_warnings(record=True) as caught, threads_in_a_line():
        warnings.simplefilter("always")
        with Events(tmp_path / "tensorboard") as events:
            for step in range(2000):
                events.add_scalar("loss", 1.0, step)
            events.add_text("b", "text")
            events.add_image("c", np.zeros((2, 3, 3), np.uint8), dataformats="HWC")
        for thread in threading.enumerate():
            if type(thread).__name__ == "_AsyncWriterThread":
                thread.join(timeout=5)
    (told,) = caught
    assert str(told.message).startswith(
        f"{tmp_path}/tensorboard: TensorBoard's events cannot be written (File too large); nothing else"
    )
    assert capsys.readouterr().err == ""


def test_a_folder_that_cannot_be_made_is_a_warning(tmp_path):
    (tmp_path / "tensorboard").touch()
    with pytest.warns(UserWarning, match="File exists"), Events(tmp_path / "tensorboard") as events:
        events.add_scalar("a", 1.0, 0)
    with pytest.warns(UserWarning, match=r"^x: .*\(no room\)"), doing_without(Path("x")):
        raise OSError("no room")
    with pytest.raises(RuntimeError, match="a bug"), doing_without(Path("x")):
        raise RuntimeError("a bug")


def test_a_bug_stays_one(tmp_path):
    with pytest.raises(TypeError), Events(tmp_path) as events:
        events.add_scalar("a")


def test_a_training_loses_its_events_alone(recorded, tmp_path):
    """The process itself, whose files may not grow."""
    run = tmp_path / "run"
    done = subprocess.run(
        [sys.executable, SCRIPT, f"--dataset.root={recorded}", *QUICK, f"--output_dir={run}"],
        capture_output=True,
        text=True,
        env=os.environ | {"OMP_NUM_THREADS": "1"},
        timeout=120,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (LARGEST, LARGEST)),
    )
    assert done.returncode == 0 and "objective " in done.stdout, done.stderr
    told = [line for line in done.stderr.replace("\r", "\n").splitlines() if "TensorBoard" in line]
    assert len(told) == 1 and told[0].startswith(f"warning: {run}/tensorboard: TensorBoard's events cannot")
    assert MacroPolicy.load(run / "checkpoints/last/pretrained_model").config.macros == 2
    assert not (run / "checkpoints/000000").exists(), "the run is not over"
