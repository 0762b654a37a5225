"""No test touches the user's caches or the network; a small dataset that many tests read."""

import os
import shutil
import tempfile
from pathlib import Path

import pytest
from noise import ACTIONS, WORLD, random_episodes


def pytest_configure(config):
    # Before any test module is imported: Hugging Face's libraries read these once, at import.
    config.home = tempfile.mkdtemp(prefix="dpmacro-tests-")
    os.environ.update(
        HF_HOME=config.home,
        HF_DATASETS_CACHE=f"{config.home}/datasets",
        HF_LEROBOT_HOME=f"{config.home}/lerobot",
        HF_HUB_OFFLINE="1",
    )


def pytest_unconfigure(config):
    shutil.rmtree(config.home, ignore_errors=True)


@pytest.fixture(scope="session")
def recorded(tmp_path_factory) -> Path:
    """A dataset of `random_episodes()`; tests that change it work on a copy."""
    from dpmacro.data.lerobot.writer import DemonstrationWriter

    root = tmp_path_factory.mktemp("recorded") / "two_flags"
    with DemonstrationWriter.create(root, ACTIONS, 30, WORLD, view=False) as writer:
        for episode in random_episodes():
            writer.add_episode(**episode)
    return root
