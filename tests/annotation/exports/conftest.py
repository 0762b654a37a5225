"""A small dataset that LeRobot's own API wrote, with a state and an image, in two files; and stages of it."""

import json

import numpy as np
import pyarrow.parquet as pq
import pytest
from lerobot_files import DATA, EPISODES

from dpmacro.annotation.stages import Stages
from dpmacro.data.lerobot.compat import create_dataset, quiet

LENGTHS = (12, 7, 5, 9)
NAMES = ("reach", "carry it", "leave")
CUTS = ((4, 9), (2, 3), (3, 4), (2, 8))  # first frames of the second and the third stage
FPS = 10
FEATURES = {
    "observation.images.front": {
        "dtype": "image",
        "shape": (48, 64, 3),
        "names": ["height", "width", "channels"],
    },
    "observation.state": {"dtype": "float32", "shape": (2,), "names": ["x", "y"]},
    "action": {"dtype": "float32", "shape": (3,), "names": ["dx", "dy", "grip"]},
}


@pytest.fixture(scope="session")
def stored(tmp_path_factory):
    """The dataset; tests that change it work on a copy."""
    root, rng = tmp_path_factory.mktemp("stored") / "arm", np.random.default_rng(0)
    with quiet():
        dataset = create_dataset(root, FPS, FEATURES)
        for length in LENGTHS:
            for _ in range(length):
                dataset.add_frame(
                    {
                        "observation.images.front": rng.integers(0, 256, (48, 64, 3), np.uint8),
                        "observation.state": rng.normal(size=2).astype(np.float32),
                        "action": rng.normal(size=3).astype(np.float32),
                        "task": "bring it",
                    }
                )
            dataset.save_episode()
        dataset.finalize()
    in_two_files(root)
    (root / "README.md").write_text("An arm that brings things.\n")
    return root


def in_two_files(root):
    """Move the last two episodes to data and metadata files of their own."""
    table, episodes = pq.read_table(root / DATA), pq.read_table(root / EPISODES)
    first = sum(LENGTHS[:2])
    starts = np.cumsum([0, *LENGTHS])
    for name, part, parts in (
        ("000", table.slice(0, first), range(2)),
        ("001", table.slice(first), range(2, 4)),
    ):
        path = root / DATA.replace("file-000", f"file-{name}")
        base = starts[parts[0]]
        with pq.ParquetWriter(path, part.schema) as writer:
            for episode in parts:
                writer.write_table(part.slice(starts[episode] - base, LENGTHS[episode]))
    for number in range(2):
        part = episodes.slice(2 * number, 2)
        for column in ("data/file_index", "meta/episodes/file_index"):
            place = part.schema.get_field_index(column)
            part = part.set_column(place, part.schema.field(place), [[number] * 2])
        pq.write_table(part, root / EPISODES.replace("file-000", f"file-00{number}"))


@pytest.fixture(scope="session")
def stages():
    """Three stages in the same order in every demonstration; a person said those of the second."""
    n_frames, rng = sum(LENGTHS), np.random.default_rng(1)
    labels = [
        np.searchsorted(cuts, np.arange(length), "right") for cuts, length in zip(CUTS, LENGTHS, strict=True)
    ]
    by_person = np.repeat([False, True, False, False], LENGTHS)
    return Stages(
        np.concatenate(labels).astype(np.int64),
        np.where(by_person, 1, rng.random(n_frames)),
        rng.random(n_frames) < 0.2,
        by_person,
        NAMES,
        np.array(LENGTHS, np.int64),
        (0, 1, 2, 3),
        np.concatenate([np.arange(length) / FPS for length in LENGTHS]).astype(np.float32).astype(np.float64),
        float(FPS),
    )


def info_of(root):
    return json.loads((root / "meta/info.json").read_text())
