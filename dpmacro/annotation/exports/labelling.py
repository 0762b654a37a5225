"""Stages and the dataset they are of: brought together before writing, and read back."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Int64

from dpmacro.annotation.exports.base import Labelled
from dpmacro.annotation.exports.formats import FORMATS
from dpmacro.annotation.exports.macro_action import STAGES_FILE, MacroAction
from dpmacro.annotation.exports.rewriting import row_count
from dpmacro.annotation.stages import Stages
from dpmacro.data.images import DatasetError
from dpmacro.data.lerobot.layout import Video
from dpmacro.data.lerobot.reader import StoredDataset
from dpmacro.data.lerobot.rows import Rows
from dpmacro.data.lerobot.tables import HALF_COPIED, read_json

__all__ = ["check_episodes", "formats_of", "labelled_dataset", "open_for_labels", "read_labels"]


def labelled_dataset(root: Path, stages: Stages) -> Labelled:
    """The dataset in a folder and the stages of all its frames.

    Raises DatasetError where the dataset is of another format than v3, damaged or incomplete, and ValueError
    where its episodes are others than those of the labels.
    """
    store = open_for_labels(root)
    for episode in store.episodes:
        for video in episode.videos.values():
            if isinstance(video, str):
                raise DatasetError(video)
            if isinstance(video, Video) and not video.path.is_file():
                raise DatasetError(f"{video.path}: is missing; {HALF_COPIED}")
    rows = store.locate(store.episodes)
    in_order = _in_order(store, rows, stages)
    seconds = store.columns(["timestamp"], store.episodes, rows)["timestamp"]
    in_order = replace(in_order, timestamps=seconds.reshape(-1).astype(np.float64))
    return Labelled(store, in_order, _places(root, rows))


def formats_of(root: Path) -> tuple[str, ...]:
    """The formats that a dataset has from an annotation before; () where it has none."""
    path = root / STAGES_FILE
    found = read_json(path).get("formats", []) if path.exists() else []
    return tuple(name for name in found if name in FORMATS) if isinstance(found, list) else ()


def read_labels(root: str | Path, names: Sequence[str] | None = None) -> Stages:
    """The stages that `write_labels` wrote into a dataset.

    Args:
        root: the folder of the dataset.
        names: of the stages; by default those that the dataset has. LeRobot's own tools leave them out where
            they write a dataset anew.

    Raises DatasetError where the dataset has no stages, or no names of them.
    """
    root = Path(root)
    store = open_for_labels(root)
    missing = [name for name in MacroAction.columns if name not in store.features]
    if missing:
        raise DatasetError(f"dataset {root}: has no column {', '.join(missing)}; annotate it")
    if names is None:
        path = root / STAGES_FILE
        if not path.is_file():
            raise DatasetError(f"{path}: is missing, which names the stages; give their names")
        found = read_json(path).get("stages")
        if not isinstance(found, list):
            raise DatasetError(f"{path}: has no list of stages; annotate the dataset again")
        names = found
    rows = store.locate(store.episodes)
    columns = store.columns([*MacroAction.columns, "timestamp"], store.episodes, rows)
    kinds = {"confidence": np.float64, "idle": bool, "corrected": bool, "timestamp": np.float64}
    flat = {name: values.astype(kinds.get(name, np.int64)) for name, values in columns.items()}
    try:
        return Stages(
            flat["macro_action"],
            flat["confidence"],
            flat["idle"],
            flat["corrected"],
            tuple(names),
            rows.lengths,
            tuple(episode.index for episode in store.episodes),
            flat["timestamp"],
            store.fps,
        )
    except ValueError as error:
        raise DatasetError(f"dataset {root}: {error}") from error


def open_for_labels(root: Path) -> StoredDataset:
    """The dataset in a folder. Raises DatasetError where labels cannot be written into its like."""
    store = StoredDataset.open(root)
    version = str(store.info.get("codebase_version"))
    if not version.startswith("v3."):
        raise DatasetError(
            f"dataset {root}: is of LeRobot format {version}, and labels are written into v3; convert it "
            "with LeRobot's convert_dataset_v21_to_v30"
        )
    if not any((root / "meta/episodes").glob("**/*.parquet")):
        raise DatasetError(f"dataset {root}: has no table in meta/episodes; {HALF_COPIED}")
    for name in ("timestamp", "episode_index"):
        if name not in store.features:
            raise DatasetError(
                f"dataset {root}: meta/info.json names no column {name}; it is no LeRobot dataset"
            )
    _ = store.fps  # raises where it is none
    return store


def check_episodes(store: StoredDataset, episodes: Sequence[int]) -> None:
    """Raise ValueError where labels of these episodes are not labels of all that a dataset has."""
    own = {episode.index for episode in store.episodes}
    without = sorted(own - set(episodes))
    if without:
        raise ValueError(
            f"dataset {store.root}: has {len(own)} episodes, and {len(without)} of them have no labels "
            f"(episode {without[0]} first); annotate all of them, or take a dataset of some by "
            "lerobot-edit-dataset's split"
        )
    beyond = sorted(set(episodes) - own)
    if beyond:
        raise ValueError(
            f"dataset {store.root}: has no episode {beyond[0]}, which has labels; annotate it anew"
        )


def _in_order(store: StoredDataset, rows: Rows, stages: Stages) -> Stages:
    check_episodes(store, stages.episodes)
    own = tuple(episode.index for episode in store.episodes)
    in_order = stages.of_episodes(own)
    wrong = np.flatnonzero(in_order.lengths != rows.lengths)
    if wrong.size:
        raise ValueError(
            f"dataset {store.root}: episode {own[wrong[0]]} has {rows.lengths[wrong[0]]} frames, and "
            f"{in_order.lengths[wrong[0]]} have labels; annotate it anew"
        )
    return in_order


def _places(root: Path, rows: Rows) -> dict[Path, Int64[np.ndarray, " rows"]]:
    """Which frame every row of every data file is."""
    places = {}
    located = {part.path: part for part in rows.parts}
    for path in sorted((root / "data").glob("**/*.parquet")):
        of_file = np.full(row_count(path), -1, np.int64)
        if path in located:
            of_file[located[path].rows] = located[path].places
        if (of_file < 0).any():
            raise DatasetError(
                f"{path}: row {int((of_file < 0).argmax())} is of no episode that meta/episodes lists; "
                f"{HALF_COPIED}"
            )
        places[path] = of_file
    return places
