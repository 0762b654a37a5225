"""The table of odd datasets: its rows, its columns, and what it calls wrong."""

import json
import os
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

import pytest
from odd_datasets import CASES, RIGHT, WRONG, Outcome, report

ROOT = Path(__file__).parents[2]


def script(tmp_path, *more):
    return subprocess.run(
        [sys.executable, "benchmarks/odd_datasets.py", f"--rows={tmp_path / 'rows.json'}", *more],
        cwd=ROOT,
        env=os.environ | {"HF_HUB_OFFLINE": "1"},
        capture_output=True,
        text=True,
    )


def test_names_are_of_one_case_each():
    for cases in CASES.values():
        assert all(odd.line is None or odd.shown == () for odd in cases.values())
    assert sum(map(len, CASES.values())) > 90


@pytest.mark.parametrize(
    ("ours", "theirs", "wrong"),
    [
        (RIGHT, RIGHT, False),
        (RIGHT, "does not open: KeyError", False),
        ("fps is null; write it", "opens; a frame raises KeyError", False),
        ("fps is null; write it", RIGHT, True),
        (WRONG, "does not open: KeyError", True),
    ],
)
def test_what_lerobot_reads_has_to_be_read(ours, theirs, wrong):
    assert Outcome("Images", "a", ours, theirs).wrong == wrong


def test_a_column_for_every_version():
    rows = [{"group": "Images", "name": "a|b", "ours": RIGHT, "theirs": RIGHT}]
    known = {"0.4.4": rows, "0.6.1": [{**rows[0], "theirs": "does not open"}], "0.5.0": []}
    lines = report(known, "python table.py").splitlines()
    assert "| what is odd | dpmacro | LeRobot 0.4.4 | LeRobot 0.5.0 | LeRobot 0.6.1 |" in lines
    assert r"| a\|b | the right frames | the right frames | - | does not open |" in lines


def test_the_script_writes_the_table(tmp_path):
    done = script(tmp_path, "--only=total", f"--report={tmp_path / 'odd.md'}")
    assert done.returncode == 0, done.stderr
    text = (tmp_path / "odd.md").read_text()
    assert f"LeRobot {version('lerobot')} |" in text and "python benchmarks/odd_datasets.py" in text
    rows = json.loads((tmp_path / "rows.json").read_text())[version("lerobot")]
    assert {row["name"]: row["ours"] for row in rows} == {
        "totals null": RIGHT,
        "totals too small": RIGHT,
        "total_frames too large": RIGHT,
        "total_episodes too large": "dataset d: half-written, info.json says 3 episodes and 11 frames, "
        "meta/episodes lists 2 and 11; record or copy it again, or correct total_episodes",
    }
    assert script(tmp_path, "--only=nothing like this").returncode == 2


@pytest.mark.benchmark
def test_all_that_lerobot_reads_is_read(tmp_path):
    done = script(tmp_path)
    assert done.returncode == 0, done.stderr
