"""Sources whose actions are vectors: recorded datasets of robots and people, their truth hidden from methods.

metaworld   Meta-World's scripted experts, the stage their truth (datasets/record.py records them)
mocap6      people exercising, what people said which exercise it is
cr5         a real arm that picks a banana; when its gripper closes and opens is the truth, and hidden
"""

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from segmentation_sources import QUICK_EPISODES, VECTOR_TOLERANCES, Source

__all__ = ["available", "missing_folders", "vector_sources"]

HAND = 3  # of Meta-World's state, the first columns: where the hand is
GRIPPER_CHANGES = 2  # of a cr5 episode that is used: it reaches, carries and leaves


def vector_sources(
    names: Sequence[str], seeds: Sequence[int], folders: Mapping[str, Path | None], quick: bool
) -> Iterator[tuple[int, Source]]:
    """Every source with every seed of the methods; `quick` is a few episodes of each dataset."""
    for name in names:
        for root in available(name, folders):
            source = READERS[name](root, QUICK_EPISODES if quick else None)
            yield from ((seed, source) for seed in seeds)


def available(name: str, folders: Mapping[str, Path | None]) -> list[Path]:
    """The datasets of a source: one, or for Meta-World one for every task; none where they are missing."""
    folder = folders[name]
    if folder is None:
        return []
    places = folder.glob("*/meta/info.json") if name == "metaworld" else folder.glob("meta/info.json")
    return sorted(path.parents[1] for path in places)


def missing_folders(names: Sequence[str], folders: Mapping[str, Path | None]) -> list[str]:
    """A line for every source that is wanted and whose folder was not given.

    Raises ValueError with the remedy where a folder was given and has no dataset.
    """
    lines = []
    for name in VECTOR_TOLERANCES:
        if name in names and not available(name, folders):
            option = f"--{'mocap' if name == 'mocap6' else name}"
            if folders[name] is None:
                lines.append(f"skipped {name}: give the folder of the dataset as {option}=FOLDER")
            else:
                remedy = "`make bench-segmentation` records it" if name == "metaworld" else f"give {option}"
                raise ValueError(f"{name} is not in {folders[name]}: {remedy}")
    return lines


def metaworld(root: Path, episodes: int | None) -> Source:
    """A task of Meta-World; methods see the whole state, of which the hand is the robot."""
    states, actions, lengths, truth = read(root, "stage", episodes)
    gripper = actions.shape[1] - 1
    return Source("metaworld", root.name, states, actions, lengths, truth, gripper, HAND)


def mocap6(root: Path, episodes: int | None) -> Source:
    """People exercising; nobody grips anything."""
    return Source("mocap6", "exercise", *read(root, "exercise", episodes))


def cr5(root: Path, episodes: int | None) -> Source:
    """The arm without its gripper: labels 0, 1, 2 between its two changes; other episodes are left out."""
    states, actions, lengths, _ = read(root, None, None)
    features = json.loads((root / "meta/info.json").read_text())["features"]
    gripper = features["action"]["names"].index("gripper")
    closed = actions[:, gripper] > np.quantile(actions[:, gripper], [0.05, 0.95]).mean()
    changed = np.diff(closed.astype(np.int64), prepend=0) != 0
    changed[np.cumsum(lengths) - lengths] = False
    starts = np.cumsum(lengths) - lengths
    kept = np.flatnonzero(np.add.reduceat(changed.astype(int), starts) == GRIPPER_CHANGES)[:episodes]
    frames = np.concatenate([np.arange(starts[k], starts[k] + lengths[k]) for k in kept])
    truth = np.concatenate([changed[starts[k] : starts[k] + lengths[k]].cumsum() for k in kept])
    others = np.delete(actions, gripper, axis=1)
    return Source("cr5", "gripper hidden", states[frames], others[frames], lengths[kept], truth)


READERS = {"metaworld": metaworld, "mocap6": mocap6, "cr5": cr5}


def read(
    root: Path, truth: str | None, episodes: int | None
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """State, action, lengths and true labels of a LeRobot v3 dataset.

    float32 [frames, columns], float32 [frames, dimensions], int64 [trajectories] and int64 [frames], the last
    numbers for the values of the column `truth`, or all 0. The first `episodes` only, where given.

    To be replaced by `Demonstrations.load` once that reads vectors. Raises ValueError for a missing column.
    """
    names = ["episode_index", "frame_index", "observation.state", "action"] + ([truth] if truth else [])
    paths = sorted(root.glob("data/**/*.parquet"))
    try:
        table = pa.concat_tables([pq.read_table(path, columns=names) for path in paths])
        table = table.sort_by([("episode_index", "ascending"), ("frame_index", "ascending")])
        of_frame = table["episode_index"].to_numpy()
        states, actions = (np.array(table[name].to_pylist(), np.float32) for name in names[2:4])
        labels = table[truth].to_numpy() if truth else np.zeros(len(of_frame), np.int64)
    except (pa.ArrowInvalid, KeyError, ValueError) as error:
        raise ValueError(f"dataset {root}: cannot read {', '.join(names)}: {error}") from error
    lengths = np.unique(of_frame, return_counts=True)[1][:episodes].astype(np.int64)
    frames = slice(int(lengths.sum()))
    labels = np.unique(labels[frames], return_inverse=True)[1].astype(np.int64)
    return states[frames], actions[frames], lengths, labels
