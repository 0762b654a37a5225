"""LeRobot's own API for writing datasets, alike for all its versions; quiet, and nothing left in caches."""

import os
import sys
import warnings
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import av

_NAME = "dpmacro/demonstrations"  # LeRobot wants one; it is written nowhere
# LeRobot is imported where it is used: processes that only run the teacher need not wait seconds for it.


def create_dataset(root: Path, fps: int | float, features: dict[str, dict[str, Any]]) -> Any:
    """A LeRobotDataset to add frames to, in a new folder."""
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    view = any(feature["dtype"] == "video" for feature in features.values())
    return LeRobotDataset.create(
        _NAME, root=root, fps=fps, features=features, use_videos=view, **_encoding(view)
    )


@contextmanager
def embedding_at_once() -> Iterator[None]:
    """Images enter an episode's table in one call; LeRobot makes one for each, half of its time."""
    modules = [
        module
        for name in ("lerobot.datasets.lerobot_dataset", "lerobot.datasets.dataset_writer")
        if hasattr(module := sys.modules.get(name), "embed_images")
    ]
    with ExitStack() as stack:
        for module in modules:
            stack.enter_context(_replaced(module, "embed_images", _embed_images))
        yield


@contextmanager
def quiet() -> Iterator[None]:
    """No bar per episode from Hugging Face's `datasets`, no chatter of video encoders or about statistics."""
    import datasets

    bars_disabled = datasets.are_progress_bars_disabled()
    encoder_log = os.environ.get("SVT_LOG")
    datasets.disable_progress_bars()
    os.environ["SVT_LOG"] = "1"  # errors only
    av.logging.set_libav_level(av.logging.WARNING)
    try:
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", "Converting input from bool", RuntimeWarning)
            yield
    finally:
        av.logging.set_libav_level(av.logging.INFO)  # libav's own default; it cannot be asked
        if encoder_log is None:
            del os.environ["SVT_LOG"]
        else:
            os.environ["SVT_LOG"] = encoder_log
        # LeRobot shows them again on its own where it hid some.
        (datasets.disable_progress_bars if bars_disabled else datasets.enable_progress_bars)()


@contextmanager
def _replaced(owner: Any, name: str, value: Any) -> Iterator[None]:
    """An attribute that has another value for the time of the block."""
    before = getattr(owner, name)
    setattr(owner, name, value)
    try:
        yield
    finally:
        setattr(owner, name, before)


def _encoding(view: bool) -> dict[str, Any]:
    # Streaming is twice as fast as going through PNG files; 0 is a queue without a limit, since a full one
    # drops frames.
    return {"video_backend": "pyav", "streaming_encoding": view, "encoder_queue_maxsize": 0}


def _embed_images(dataset: Any) -> Any:
    import datasets
    from datasets.table import InMemoryTable, embed_table_storage

    table = embed_table_storage(dataset.with_format("arrow")[:])
    embedded = datasets.Dataset(InMemoryTable(table), info=dataset.info, split=dataset.split)
    return embedded.with_format(**dataset.format)
