"""Arguments as they must be: each function returns its argument, or raises a ValueError of one line.

The line starts with the argument's name, says the value, and what to give instead. Arrays and devices are in
tensors.py, since eval.py's workers import this module and not torch.
"""

import math
import numbers
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

__all__ = [
    "as_choice",
    "as_count",
    "as_entries",
    "as_flag",
    "as_kind",
    "as_number",
    "as_path",
    "as_text",
    "in_a_line",
    "shown",
]

SHOWN = 60  # characters of a wrong value
SHOWN_ERROR = 200  # characters of what another library says


def as_count(name: str, value: Any, least: int = 1, most: int | None = None) -> int:
    """A whole number of `least` or more, and `most` or less."""
    if isinstance(value, bool | np.bool_) or not isinstance(value, numbers.Integral):
        raise ValueError(f"{name} is {shown(value)}: give a whole number, {least} or more")
    whole = int(value)
    if whole < least:
        raise ValueError(f"{name} is {shown(whole)}: give {least} or more")
    if most is not None and whole > most:
        raise ValueError(f"{name} is {shown(whole)}: give {most} or less")
    return whole


def as_flag(name: str, value: Any) -> bool:
    """True or False."""
    if not isinstance(value, bool | np.bool_):
        raise ValueError(f"{name} is {shown(value)}: give True or False")
    return bool(value)


def as_number(
    name: str, value: Any, *, least: float = -math.inf, above: float = -math.inf, most: float = math.inf
) -> float:
    """A finite number of `least` or more, greater than `above`, and `most` or less."""
    bounds = (f"above {above:g}", above), (f"of {least:g} or more", least), (f"up to {most:g}", most)
    wanted = (
        f"a finite number {' and '.join(words for words, bound in bounds if math.isfinite(bound))}".strip()
    )
    if isinstance(value, bool | np.bool_) or not isinstance(value, numbers.Real):
        raise ValueError(f"{name} is {shown(value)}: give {wanted}")
    try:
        number = float(value)
    except OverflowError:
        number = math.inf
    if not (math.isfinite(number) and number > above and least <= number <= most):
        raise ValueError(f"{name} is {shown(value)}: give {wanted}")
    return number


def as_text(name: str, value: Any) -> str:
    """A text."""
    if not isinstance(value, str):
        raise ValueError(f"{name} is {shown(value)}: give a text")
    return value


def as_choice(name: str, value: Any, known: Iterable[str]) -> str:
    """One of the texts that are `known`."""
    known = tuple(known)
    if not isinstance(value, str) or value not in known:
        raise ValueError(f"{name} is {shown(value)}: give one of {', '.join(known)}")
    return value


def as_kind(name: str, value: Any, kind: Any, wanted: str = "") -> Any:
    """An instance of a class, or of one of several; `wanted` says in words what to give instead."""
    if not isinstance(value, kind):
        raise ValueError(f"{name} is a {type(value).__name__}: give {wanted or f'a {kind.__name__}'}")
    return value


def as_path(name: str, value: Any) -> Path:
    """A path that is not empty."""
    if not isinstance(value, str | Path) or not str(value):
        raise ValueError(f"{name} is {shown(value)}: give the path of a folder")
    return Path(value)


def as_entries(name: str, value: Any, count: int | None = None, kind: Any = tuple | list) -> Any:
    """A list or a tuple, or what `kind` says, of `count` entries where that is given."""
    wanted = "a list" if kind == tuple | list else "names with a value each"
    if not isinstance(value, kind):
        raise ValueError(f"{name} is {shown(value)}: give {wanted}")
    if count is not None and len(value) != count:
        raise ValueError(f"{name} has {len(value)} entries, {shown(value)}: give {count}")
    return value


def shown(value: Any) -> str:
    """A value in one short line."""
    try:
        line = " ".join(repr(value).split())
    except ValueError:  # Python does not print whole numbers of thousands of digits
        line = f"{type(value).__name__} of too many digits"
    except RecursionError:
        line = f"{type(value).__name__} of too many levels"
    return line if len(line) <= SHOWN else f"{line[: SHOWN - 3]}..."


def in_a_line(error: BaseException) -> str:
    """What an error says, in one line; what it is where it says nothing."""
    line = " ".join(str(error).split()) or type(error).__name__
    return line if len(line) <= SHOWN_ERROR else f"{line[: SHOWN_ERROR - 3]}..."
