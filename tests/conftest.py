"""No test touches the user's caches or the network; a small dataset that many tests read."""

import os
import shutil
import signal
import sys
import tempfile
from pathlib import Path

import pytest
from noise import random_episodes, write

# The folders and files whose modules take longest, the longest first.
SLOW = (
    "training/test_train.py",
    "training",
    "discovery",
    "benchmarks/test_table1.py",
    "benchmarks/test_act_peer.py",
    "scripts",
    "benchmarks",
    "evaluation",
    "data/lerobot",
    "figures",
    "worlds/two_flags",
)


def pytest_configure(config):
    # Before any test module is imported: Hugging Face's libraries read these once, at import.
    config.home = tempfile.mkdtemp(prefix="dpmacro-tests-")
    os.environ.update(
        HF_HOME=config.home,
        HF_DATASETS_CACHE=f"{config.home}/datasets",
        HF_LEROBOT_HOME=f"{config.home}/lerobot",
        HF_HUB_OFFLINE="1",
    )
    if "PYTEST_XDIST_WORKER" in os.environ:
        _take_one_thread()
    # A shell's background jobs, and all under nohup, ignore Ctrl-C, and so would every process they start.
    config.sigint = signal.getsignal(signal.SIGINT)
    if config.sigint is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_unconfigure(config):
    signal.signal(signal.SIGINT, config.sigint)
    shutil.rmtree(config.home, ignore_errors=True)


def pytest_collection_modifyitems(config, items):
    """Beside other processes the longest modules begin first, lest one of them runs alone at the end."""
    if "PYTEST_XDIST_WORKER" in os.environ:
        items.sort(key=lambda item: _place(item.nodeid.removeprefix("tests/")))


def _place(path: str) -> int:
    return next((place for place, slow in enumerate(SLOW) if path.startswith(slow)), len(SLOW))


def _take_one_thread() -> None:
    """Threads of several processes that wait for one another on few cores take ten times as long.

    OpenMP reads the variable when torch is imported; processes that a test starts inherit it.
    """
    os.environ["OMP_NUM_THREADS"] = "1"
    if "torch" in sys.modules:
        sys.modules["torch"].set_num_threads(1)


@pytest.fixture(scope="session")
def recorded(tmp_path_factory) -> Path:
    """A dataset of `random_episodes()`; tests that change it work on a copy."""
    return write(tmp_path_factory.mktemp("recorded") / "two_flags", random_episodes())
