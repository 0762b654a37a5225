"""From files to pictures: stages by progress bars, memory of all processes, and both scripts in small."""

import json
import subprocess
import sys
from pathlib import Path

import pytest
from files_to_pictures import FilesToPicturesOptions, table
from watched import Stopwatch, watched

from dpmacro.training.monitor import STAGES as BARS

ROOT = Path(__file__).parents[2]
SMALL = "--planner.rounds=3 --planner.restarts=1 --planner.switch_rounds=3 --planner.rectangles=8"


def test_time_goes_to_the_stage_whose_bar_comes_next():
    stopwatch = Stopwatch(100.0)
    assert not stopwatch.line("loading", 105.0)
    for text, now in (
        ("Features:   0%|          | 0/9 [00:00<?, ?column/s]", 110.0),
        ("Features: 100%|#| 9/9 [00:00<?, ?column/s]", 112.0),
        ("Segmenting Q2 S1:   0%|          | 0/9", 115.0),
        ("Boosting, some left out:  50%|", 116.0),
        ("Switch functions:  50%|", 120.0),
        ("Pictures:  50%|", 121.0),
    ):
        assert stopwatch.line(text, now)
    stopwatch.stop(131.0)
    wanted = {"reading": 10.0, "features": 2.0, "search": 3.0, "final fit": 5.0, "writing": 11.0}
    assert stopwatch.seconds == wanted


def test_every_bar_of_a_training_has_a_stage():
    for name in BARS.values():
        stopwatch = Stopwatch(0.0)
        assert stopwatch.line(f"{name}:   0%|", 1.0) and stopwatch.stage != "reading"


def test_a_script_without_bars_reads(tmp_path):
    stopwatch = Stopwatch(1.0)
    stopwatch.stop(3.0)
    assert stopwatch.seconds == {"reading": 2.0}


CHILD = "import time; kept = bytearray(200 << 20); time.sleep(1)"
PARENT = f"""
import subprocess, sys
kept = bytearray(150 << 20)
bar = "Features: {{}}%|"
sys.stderr.write("careful\\n\\r" + bar.format(0) + "\\r" + bar.format(100) + "\\nlast")
sys.stderr.flush()
subprocess.run([sys.executable, "-c", {CHILD!r}])
print("done")
sys.exit(3)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux tells the memory of other processes")
def test_a_run_is_watched_with_what_it_starts(tmp_path):
    run = watched([sys.executable, "-c", PARENT], tmp_path)
    assert run.status == 3 and run.output == "done\n" and run.errors.splitlines() == ["careful", "last"]
    assert 350 / 1024 < run.gib < 500 / 1024
    assert run.seconds > 1 and 0 < run.cpu < run.seconds
    assert list(run.stages) == ["reading", "features", "writing"]
    assert sum(run.stages.values()) == pytest.approx(run.seconds)


def test_a_line_for_every_script():
    rows = [{"script": "train", "seconds": 10.0, "cpu": 12.34, "gib": 1.234, "reading": 4.0, "search": 6.0}]
    assert table(rows)[1].split() == ["train", "10.0", "12.3", "1.23", "4.0", "0.0", "6.0", "0.0", "0.0"]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"scripts": ["eval"]}, "scripts has 'eval': choose from train, annotate"),
        ({"gib": 0}, "gib is 0: give a number above 0"),
    ],
)
def test_options_are_checked(changes, message):
    with pytest.raises(ValueError, match=message):
        FilesToPicturesOptions(**changes)


def script(tmp_path, *more):
    command = [sys.executable, "benchmarks/files_to_pictures.py", f"--output={tmp_path / 'rows.json'}"]
    generated = [
        "--frames=60",
        "--cameras=1",
        "--size=[64,48]",
        "--length=20",
        f"--generated={tmp_path / 'g'}",
    ]
    return subprocess.run([*command, *generated, *more], cwd=ROOT, capture_output=True, text=True)


def test_both_scripts_run_on_generated_data(tmp_path):
    done = script(tmp_path, f"--options={SMALL} --planner.macros=2", "--seconds=1", "--codec=h264")
    rows = json.loads((tmp_path / "rows.json").read_text())
    assert [row["script"] for row in rows] == ["train", "annotate"], done.stderr
    assert all(row["reading"] > 0 and row["search"] > 0 and row["writing"] > 0 for row in rows)
    assert done.stdout.splitlines()[-1].startswith("annotate")
    assert done.returncode == 2 and "train.py took" in done.stderr and "1 are the goal" in done.stderr


def test_a_script_that_fails_says_why(tmp_path):
    done = script(tmp_path, "--options=--planner.macros=0", "--codec=h264")
    assert done.returncode == 2
    assert done.stderr.splitlines()[-1] == (
        "error: train.py ended with status 2: error: planner.macros is 0: give 1 or more"
    )
