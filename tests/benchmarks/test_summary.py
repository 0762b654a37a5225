"""The table of several evaluations."""

import json
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]


def write(folder, planner, outcomes):
    path = folder / f"{planner}.json"
    section = {"planner": planner, "outcomes": outcomes, "seeds": list(range(10, 10 + len(outcomes)))}
    path.write_text(json.dumps({"dpmacro": section}))
    return path


def test_a_line_for_every_evaluation_and_a_picture(tmp_path):
    files = [
        write(tmp_path, "teacher", ["success"] * 9 + ["red_first"]),
        write(tmp_path, "baseline", ["red_never_reached"] * 10),
    ]
    done = subprocess.run(
        [
            sys.executable,
            "benchmarks/summary.py",
            f"--results={' '.join(map(str, files))}",
            f"--chart={tmp_path / 'success.png'}",
        ],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
    )
    _, teacher, baseline = done.stdout.splitlines()
    assert teacher.split()[:3] == ["teacher", "9/10", "90%"]
    assert "60% to 98%" in teacher and "1 red first" in teacher and "10..19" in teacher
    assert baseline.split()[:3] == ["baseline", "0/10", "0%"]
    assert (tmp_path / "success.png").stat().st_size > 1000
