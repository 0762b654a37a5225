"""A LeRobot dataset -> the parts of demonstrations, checked one after another."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from dpmacro.data.actions import actions_of, choose_action
from dpmacro.data.images import DatasetError, FrameBuffer, ImageTransform
from dpmacro.data.inputs import choose_inputs, read_cameras, read_vectors, task_indices, task_names
from dpmacro.data.lerobot.layout import StoredEpisode
from dpmacro.data.lerobot.reader import StoredDataset
from dpmacro.data.lerobot.rows import Rows
from dpmacro.data.names import entry_names
from dpmacro.data.truth import choose_truth, true_labels
from dpmacro.parallel import ALONE, Ranks

__all__ = ["load_parts"]


def load_parts(
    root: Path,
    episodes: Sequence[int] | None,
    inputs: Sequence[str] | None,
    action: str | Sequence[str] | None,
    truth: str | None,
    transform: ImageTransform,
    task: str | int | None,
    tolerance: float,
    ranks: Ranks = ALONE,
) -> dict[str, Any]:
    """Arguments of `Demonstrations`; parameters and errors are those of `Demonstrations.load`."""
    with ranks.together():
        store = StoredDataset.open(root)
        fps, chosen = store.fps, store.choose(episodes)
        if task is not None:
            chosen = _of_task(store, chosen, task)
        chosen, rows, short = _long_enough(store, chosen, asked=episodes is not None)
        truth, acting = choose_truth(store, truth), choose_action(store, action)
        what = choose_inputs(store, inputs, (*acting, "action", *([truth] if truth else ())))
        several = "task_index" in store.features and task is None
        beside = ["action"] if acting == ["discrete_action"] and "action" in store.features else []
        wanted = [
            *acting,
            *beside,
            *([truth] if truth else []),
            *what.vectors,
            *(["task_index"] if several else []),
        ]
        columns = store.columns(list(dict.fromkeys(wanted)), chosen, rows)
        actions, action_names = actions_of(store, acting, columns)
        labels, classes = (None, ()) if truth is None else true_labels(store, truth, columns[truth])
        vectors = read_vectors(store, what.vectors, columns)
        doing = task_indices(store, columns["task_index"]) if several else None
        tasks = task_names(store, doing)
    buffers, depths = read_cameras(store, what, inputs is not None, chosen, rows, transform, tolerance, ranks)
    observations: dict[str, np.ndarray] = {
        camera: buffer.images for camera, buffer in buffers.items()
    } | vectors
    if len(tasks) > 1 and doing is not None:
        observations["task_index"] = doing
    return {
        "observations": observations,
        "actions": actions,
        "lengths": rows.lengths,
        "action_names": action_names,
        "fps": fps,
        "truth": labels,
        "world": store.world,
        "root": root,
        "truth_name": truth,
        "truth_classes": classes,
        "stored_shapes": {camera: buffer.stored_shape for camera, buffer in buffers.items()},
        "symmetric": store.symmetric,
        "state_names": {
            name: entry_names(store.features[name], values.shape[1]) for name, values in vectors.items()
        },
        "tasks": tasks,
        "episodes": tuple(episode.index for episode in chosen),
        "notes": (
            *_notes(buffers, vectors, tasks, observations),
            *store.notes,
            *short,
            *_rate(store),
            *what.notes,
            *depths,
            *_disorder(rows),
        ),
    }


def _of_task(store: StoredDataset, episodes: list[StoredEpisode], task: str | int) -> list[StoredEpisode]:
    """The episodes in which a task is done, given by its words or its task_index."""
    words = store.tasks.get(task, str(task)) if isinstance(task, int) else task
    known = {word for episode in store.episodes for word in episode.tasks} | set(store.tasks.values())
    if words not in known and words.isdecimal():
        words = store.tasks.get(int(words), words)
    if any(episode.tasks for episode in store.episodes):
        found = [episode for episode in episodes if words in episode.tasks]
    else:
        rows = store.locate(episodes)
        doing = store.scalars(["task_index"], episodes, rows)["task_index"]
        index = next((number for number, word in store.tasks.items() if word == words), -1)
        starts = np.cumsum(rows.lengths) - rows.lengths
        found = [episode for episode, start in zip(episodes, starts, strict=True) if doing[start] == index]
    if not found:
        raise DatasetError(
            f"dataset {store.root}: no episode of task {task!r} among those chosen; there are "
            f"{', '.join(repr(word) for word in sorted(known)[:10]) or 'none with words'}"
        )
    return found


def _rate(store: StoredDataset) -> list[str]:
    if store.info["fps"] == store.fps:
        return []
    said = json.dumps(store.info["fps"])[:80]
    return [f"info.json: fps is {said}; the timestamps say {store.fps:g} frames a second, which is taken"]


def _disorder(rows: Rows) -> list[str]:
    """A line for each kind of frame_index that numbers an episode's frames in another way than 0, 1, ..."""
    told = {
        "frame_index repeats in {}: their frames are taken in the order of the rows": rows.unordered,
        "frame_index leaves numbers out in {}: the frames that there are follow one another": rows.skipping,
    }
    return [line.format(f"episodes {_listed(which)}") for line, which in told.items() if which]


def _listed(numbers: Sequence[int]) -> str:
    return ", ".join(map(str, numbers[:5])) + (", ..." if len(numbers) > 5 else "")


def _long_enough(
    store: StoredDataset, episodes: list[StoredEpisode], asked: bool
) -> tuple[list[StoredEpisode], Rows, list[str]]:
    """The episodes of two frames or more, where their frames lie, and a line about those left out.

    Raises DatasetError for a shorter one that was `asked` for, and where all are shorter.
    """
    rows = store.locate(episodes)
    short = np.flatnonzero(rows.lengths < 2)
    if not short.size:
        return episodes, rows, []
    if asked or len(short) == len(episodes):
        length = int(rows.lengths[short[0]])
        raise DatasetError(
            f"dataset {store.root}: episode {episodes[short[0]].index} has {length} "
            f"frame{'' if length == 1 else 's'}; dpmacro "
            "needs at least two frames per episode"
        )
    left = [episodes[place].index for place in short]
    kept = [episode for episode in episodes if episode.index not in left]
    return (
        kept,
        store.locate(kept),
        [f"episodes {_listed(left)} are left out: they have less than two frames"],
    )


def _notes(
    buffers: dict[str, FrameBuffer],
    vectors: dict[str, np.ndarray],
    tasks: tuple[str, ...],
    observations: dict[str, np.ndarray],
) -> list[str]:
    """What is read, in one line, and the tasks in another where there are several."""
    told = []
    for camera, buffer in buffers.items():
        height, width = buffer.images.shape[1:3]
        stored = buffer.stored_shape
        told.append(f"{camera} ({f'{stored[1]}x{stored[0]} shrunk to ' if stored else ''}{width}x{height})")
    told += [f"{name} ({values.shape[1]})" for name, values in vectors.items()]
    lines = [f"inputs: {', '.join(told)}"]
    if "task_index" in observations:
        lines.append(
            f"{len(tasks)} tasks, given to the policy as task_index: {', '.join(tasks[:5])}"
            f"{', ...' if len(tasks) > 5 else ''}"
        )
    return lines
