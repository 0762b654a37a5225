"""The README's example runs as it stands there."""

import re
import subprocess
import sys
from pathlib import Path

README = Path(__file__).resolve().parent.parent / "README.md"
BLOCK = re.compile(r"^```python\n(.*?)^```", re.DOTALL | re.MULTILINE)


def test_the_example_runs_and_finds_the_macro_actions(tmp_path):
    example = next(block for block in BLOCK.findall(README.read_text()) if "DPBoost" in block)
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", example], cwd=tmp_path, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    progress = re.compile(r"\d+%\||it/s|s/it")  # of bars
    assert not [line for line in done.stderr.splitlines() if line and not progress.search(line)]
    shares = [float(share) for share in re.findall(r"([\d.]+)%", done.stdout)]
    assert shares and all(90 < share <= 100 for share in shares), done.stdout
    assert not list(tmp_path.iterdir())  # it leaves no file behind
