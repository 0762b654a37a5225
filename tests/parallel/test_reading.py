"""Demonstrations whose pictures ranks decode in shares are those that one process reads."""

import shutil

import numpy as np
import pytest
from lerobot_files import CAMERA, build

from dpmacro.data.demonstrations import Demonstrations
from tests.parallel.threads import on_ranks


@pytest.mark.parametrize("video", [None, {"options": {"g": "4"}}])
@pytest.mark.parametrize("size", [2, 5])
def test_pictures_are_shared_out(video, size, tmp_path):
    root = build(tmp_path / "data", video=video, lengths=(90, 80))
    alone = Demonstrations.load(root)
    for one in on_ranks(size, lambda ranks: Demonstrations.load(root, ranks=ranks)):
        assert np.array_equal(one.observations[CAMERA], alone.observations[CAMERA])
        assert one.stored_shapes == alone.stored_shapes


def test_what_one_rank_cannot_read_ends_all(tmp_path):
    root = build(tmp_path / "data")
    other = shutil.copytree(root, tmp_path / "other")
    (other / "meta/info.json").unlink()

    def work(ranks):
        return Demonstrations.load(other if ranks.rank == 1 else root, ranks=ranks)

    with pytest.raises(ValueError, match=r"info\.json"):
        on_ranks(3, work)
