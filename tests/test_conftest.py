"""What the test run sets up for every test: threads, Ctrl-C, the order of modules."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
import torch

from tests.conftest import SLOW, _place

TESTS = Path(__file__).resolve().parent
THREADS = "import torch; print(torch.get_num_threads())"
INTERRUPTED = """\
import os, signal
def test_an_interrupt():
    try:
        os.kill(os.getpid(), signal.SIGINT)
    except KeyboardInterrupt:
        return
    raise AssertionError("Ctrl-C is ignored")
"""


@pytest.mark.skipif("PYTEST_XDIST_WORKER" not in os.environ, reason="the tests run in one process")
def test_a_worker_and_what_it_starts_have_one_thread():
    assert torch.get_num_threads() == 1
    done = subprocess.run([sys.executable, "-c", THREADS], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "1"


def test_an_interrupt_reaches_the_tests_of_a_background_job(tmp_path):
    (tmp_path / "test_interrupt.py").write_text(INTERRUPTED)
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-p", "conftest"]
    paths = os.pathsep.join([str(TESTS), str(TESTS / "helpers")])
    done = subprocess.run(
        [*command, "--rootdir", str(tmp_path), str(tmp_path)],
        env=os.environ | {"PYTHONPATH": paths},
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_IGN),
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stdout


def test_slow_modules_are_there_and_begin_first():
    assert [slow for slow in SLOW if not (TESTS / slow).exists()] == []
    places = [_place(path) for path in ("training/test_train.py", "training/test_x.py", "utils/test_x.py")]
    assert places == sorted(set(places))
