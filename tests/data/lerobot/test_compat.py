import os
import warnings
from contextlib import nullcontext

import numpy as np
import pyarrow.parquet as pq
import pytest
from noise import random_episodes, write

from dpmacro.data.lerobot.compat import _embed_images


@pytest.mark.parametrize("bars_disabled", [False, True])
def test_writing_is_silent_and_leaves_no_state(tmp_path, capfd, monkeypatch, bars_disabled):
    import datasets

    monkeypatch.delenv("SVT_LOG", raising=False)
    assert not datasets.are_progress_bars_disabled()
    views = np.zeros((12, 64, 96, 3), np.uint8)
    cache = datasets.config.HF_DATASETS_CACHE
    if bars_disabled:
        datasets.disable_progress_bars()
    try:
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("default", RuntimeWarning)
            write(tmp_path / "d", [next(random_episodes()) | {"views": views}])
        assert datasets.are_progress_bars_disabled() == bars_disabled
    finally:
        datasets.enable_progress_bars()
    assert [str(warning.message) for warning in caught if warning.category is RuntimeWarning] == []
    assert capfd.readouterr() == ("", "")
    assert "SVT_LOG" not in os.environ and cache == datasets.config.HF_DATASETS_CACHE


def test_embedding_at_once_writes_what_lerobot_writes(recorded, tmp_path, monkeypatch):
    monkeypatch.setattr("dpmacro.evaluation.run_writer.embedding_at_once", nullcontext)
    root = write(tmp_path / "one_by_one", random_episodes())
    ours, theirs = (pq.ParquetFile(folder / "data/chunk-000/file-000.parquet") for folder in (recorded, root))
    assert ours.read().equals(theirs.read())
    assert ours.schema_arrow.equals(theirs.schema_arrow)
    assert ours.metadata.num_row_groups == theirs.metadata.num_row_groups


@pytest.mark.parametrize("view", [False, True])
def test_lerobot_embeds_by_the_function_that_is_replaced(recorded, tmp_path, monkeypatch, view):
    """Where a new LeRobot has it elsewhere, recording is slower, and this says so."""
    calls = []

    def noted(dataset):
        calls.append(len(dataset))
        return _embed_images(dataset)

    monkeypatch.setattr("dpmacro.data.lerobot.compat._embed_images", noted)
    episodes = list(random_episodes((4, 3)))
    for episode in episodes:
        episode["views"] = np.zeros((len(episode["actions"]), 64, 96, 3), np.uint8) if view else None
    write(tmp_path / "d", episodes)
    assert calls == [4, 3]
