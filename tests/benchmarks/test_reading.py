"""The benchmark of reading: every way decodes all frames, and the table says how they compare."""

import json
import subprocess
import sys
from pathlib import Path

import pytest
import reading
from generated import Contents, generate
from lerobot_files import build

ROOT = Path(__file__).parents[2]
SMALL = Contents(frames=60, cameras=2, width=64, height=48, codec="h264", length=30)


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    return generate(tmp_path_factory.mktemp("generated") / "small", SMALL)


@pytest.mark.parametrize("threads", [1, 2, 3])
@pytest.mark.parametrize("way", ["decode_files", "decode_in_threads"])
def test_every_frame_is_decoded_once(small, way, threads):
    assert getattr(reading, way)(reading.videos(small), threads)["frames"] == 120


def test_parts_of_a_file_meet(small):
    path = reading.videos(small)[0]
    for count in (1, 2, 7, 100):
        parts = reading._parts(path, count)
        assert [end for _, _, end in parts] == [*(start for _, start, _ in parts[1:]), None]
        assert sum(map(reading._decode_part, parts)) == 60


def test_the_table_compares_repeat_by_repeat_with_the_fastest():
    def row(way, rates):
        return {"way": way, "rates": rates, "frames": 9, "gib": 0.5}

    found = [row("dpmacro", [80, 90, 50]), row("PyAV, a", [100, 100, 100]), row("PyAV, b", [90, 120, 40])]
    lines = reading.table(found)
    assert lines[1].split() == ["dpmacro", "80", "50", "90", "9", "0.50"]
    assert lines[-1] == "ratio to PyAV, a: 0.80, from 0.50 to 0.90 (0.80 is the goal)"


def test_the_script_prints_a_line_for_every_way(tmp_path, small):
    command = [sys.executable, "benchmarks/reading.py", f"--dataset.root={small}", "--repeats=1"]
    done = subprocess.run(
        [*command, f"--output={tmp_path / 'rows.json'}"], cwd=ROOT, capture_output=True, text=True, check=True
    )
    rows = json.loads((tmp_path / "rows.json").read_text())
    assert [row["way"] for row in rows] == list(reading.WAYS)
    assert all(row["frames"] == 120 and len(row["rates"]) == 1 and row["gib"] > 0.01 for row in rows)
    assert all(f"\n{way}" in done.stdout for way in reading.WAYS) and "ratio to PyAV" in done.stdout


def test_a_dataset_without_videos_is_refused(tmp_path):
    with pytest.raises(ValueError, match="has no video: give one that has"):
        reading.videos(build(tmp_path / "d"))
