"""What a dataset's metadata must be: checked once, as it is opened, so that nothing later meets another type.

What LeRobot or its users leave out or write in several ways stays allowed; what has no meaning, or a size
beyond any dataset, is refused with the file, the place, the value and what to write.
"""

import json
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from string import Formatter
from typing import Any, TypeGuard

from dpmacro.data.images import DatasetError
from dpmacro.utils.checks import shown

__all__ = [
    "MOST_FPS",
    "check_episode",
    "check_info",
    "check_task",
    "check_world",
    "filled",
    "is_whole",
]

MOST_FPS = 10_000.0  # a second; a change of a state is over half as many frames
MOST_SIZE = 2**31  # of a side, an index or a count
LONGEST_NAME = 200  # characters of a feature's, which is a folder's name, too
WIDEST = 20  # digits that a template may fill a number up to
LEVELS = 20  # of lists and objects within one another

WIDTH = f"a number's width, {WIDEST} at most, and d"


def check_info(root: Path, info: Mapping[str, Any]) -> None:
    """Raise DatasetError where `meta/info.json` cannot describe a dataset."""
    path = root / "meta/info.json"
    for key in ("features", "fps"):
        if key not in info:
            raise DatasetError(f"dataset {root}: meta/info.json has no {key}; it is no LeRobot dataset")
    named = info["features"]
    if not isinstance(named, dict) or not all(isinstance(one, dict) for one in named.values()):
        raise DatasetError(f"{path}: features is {_told(named)}; give each name its dtype and shape")
    for name, feature in named.items():
        if not name or len(name) > LONGEST_NAME or not name.isprintable():
            raise DatasetError(
                f"{path}: a feature is called {shown(name)}; give it a name of {LONGEST_NAME} letters at most"
            )
        shape = feature.get("shape")
        if shape is not None and not (isinstance(shape, list) and all(map(_is_index, shape))):
            raise DatasetError(
                f"{path}: shape of {name} is {shown(shape)}; write a list of whole numbers, as [3]"
            )
        if math.prod(shape or ()) > MOST_SIZE:
            raise DatasetError(f"{path}: shape of {name} is {shown(shape)}; write what a frame has")
        if not _is_shallow(feature, LEVELS):
            raise DatasetError(f"{path}: {name} has lists within lists of {LEVELS} levels; write fewer")
    if _is_number(info["fps"]) and info["fps"] > MOST_FPS:
        raise DatasetError(
            f"{path}: fps is {shown(info['fps'])}; write how many frames a second has, {MOST_FPS:g} at most"
        )


def check_world(path: Path, recorded: Mapping[str, Any]) -> None:
    """Raise DatasetError where `meta/dpmacro.json` holds something else than what recordings write there."""
    world, truth = recorded.get("world", {}), recorded.get("truth", {})
    named = isinstance(world, dict) and isinstance(world.get("id", ""), str)
    _refuse(path, "world", world, named, 'write {"id": its name, ...} or leave it out')
    words = isinstance(truth, dict) and all(_are(str, names) for names in truth.values())
    _refuse(path, "truth", truth, words, "write a list of names for each column or leave it out")
    symmetric = recorded.get("symmetric", False)
    if not isinstance(symmetric, bool):
        raise DatasetError(f"{path}: symmetric is {_told(symmetric)}; write true or false")


def check_episode(path: Path, row: Mapping[str, Any]) -> None:
    """Raise DatasetError for a row of an episode whose number, files or tasks cannot be."""
    index = row.get("episode_index")
    if not _is_index(index):
        raise DatasetError(f"{path}: a row has episode_index {shown(index)}; give each episode its number")
    for key, value in row.items():
        where = f"{key} of episode {index}"
        if key.endswith(("/chunk_index", "/file_index")):
            _refuse(path, where, value, value is None or _is_index(value), "write a whole number from 0 on")
        if key.endswith("/from_timestamp"):
            _refuse(path, where, value, value is None or _is_number(value), "write seconds from 0 on")
    tasks = row.get("tasks")
    several = tasks is None or isinstance(tasks, str) or _are((str, type(None)), tasks)
    _refuse(path, f"tasks of episode {index}", tasks, several, "write a list of what is to be done, in words")


def check_task(path: Path, row: Mapping[str, Any], index: Any, words: Sequence[Any]) -> None:
    """Raise DatasetError for a row of a task without a number or words."""
    if not _is_index(index) or not words:
        raise DatasetError(f"{path}: a task is {shown(row)}; give each a task_index from 0 on and its words")


def filled(template: Any, place: Mapping[str, Any]) -> str | None:
    """A path by a template; None where that names none of `place`, and so is of another layout.

    Raises ValueError where it cannot be filled in: only names of `place` may stand in it, with a width at
    most, since any format may ask for gigabytes of zeros or for what is in Python's objects. It may not lead
    out of the dataset.
    """
    if not isinstance(template, str):
        return None
    parts = [part for part in Formatter().parse(template) if part[1] is not None]
    names = {name for _, name, _, _ in parts}
    if not parts or not names <= place.keys():
        return None
    for _, _, width, conversion in parts:
        digits = (width or "").removesuffix("d")
        if conversion or (digits and not (digits.isascii() and digits.isdecimal() and int(digits) <= WIDEST)):
            raise ValueError(f"{shown(width)} is not {WIDTH}")
    path = template.format(**place)
    if ".." in Path(path).parts or Path(path).is_absolute() or not path.isprintable():
        raise ValueError("it leads out of the dataset")
    return path


def is_whole(value: Any) -> TypeGuard[int]:
    """Whether a value is a whole number, and no truth value."""
    return isinstance(value, int) and not isinstance(value, bool)


def _is_index(value: Any) -> bool:
    return is_whole(value) and 0 <= value <= MOST_SIZE


def _is_number(value: Any) -> bool:
    """Whether a value is a number that float64 holds, and finite."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    return abs(value) < 1e300  # a whole number may have hundreds of digits


def _are(kind: Any, values: Any) -> bool:
    return isinstance(values, list) and all(isinstance(value, kind) for value in values)


def _is_shallow(value: Any, levels: int) -> bool:
    inner = value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()
    return levels > 0 and all(_is_shallow(own, levels - 1) for own in inner)


def _refuse(path: Path, where: str, value: Any, holds: bool, remedy: str) -> None:
    if not holds:
        raise DatasetError(f"{path}: {where} is {shown(value)}; {remedy}")


def _told(value: Any, write: Callable[[Any], str] = json.dumps) -> str:
    """The beginning of a value, as JSON has it."""
    try:
        return write(value)[:80]
    except (RecursionError, ValueError):
        return shown(value)
