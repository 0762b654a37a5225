"""Lines of JSON that are appended to a file as work is done, so that a stopped run can be gone on with."""

import json
import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from dpmacro.utils.files import replacing

__all__ = ["LARGEST", "Journal"]

LARGEST = 2**30  # bytes of a file that is read


class Journal:
    """A file of JSON lines: the first says what the work is, every further one what was done of it.

    A line is on disk once `add` returns. One that was written in part, since the process was killed or the
    disk was full, does not count, and the next line takes its place.

    Attributes:
        path: the file.
        lines: those after the first, as they were read and added.

    Args:
        path: made, with folders above it, where it does not exist.
        about: what the work is, as JSON holds it.
        remedy: what to do instead, for the error where the file is of other work.

    Raises ValueError, one line, where the file is damaged, larger than `LARGEST`, or of other work that some
    was done of; and OSError where it cannot be read or made.
    """

    def __init__(self, path: Path, about: Mapping[str, Any], remedy: str) -> None:
        self.path = path
        self.lines: list[dict[str, Any]] = []
        self._remedy = remedy
        about = json.loads(json.dumps(about))
        text = b""
        if path.exists():
            if path.stat().st_size > LARGEST:
                raise ValueError(f"{path}: has more than {LARGEST:,} bytes, which no run writes; {remedy}")
            text = path.read_bytes()
        self._size = text.rfind(b"\n") + 1  # what is behind the last line's end was written in part
        if self._size:
            numbered = enumerate(_split(text[: self._size]), 1)
            first, *self.lines = (self._read(number, line) for number, line in numbered)
            if self.lines:
                self._refuse_other(about, first)
                return
        with replacing(path) as temporary:  # nothing was done yet
            temporary.write_bytes(_line(about))
        self._size = len(_line(about))

    def add(self, line: Mapping[str, Any]) -> None:
        """Append a line. Where it raises OSError, the lines before it stay as they are."""
        data = _line(line)
        with self.path.open("r+b") as file:
            file.truncate(self._size)
            file.seek(self._size)
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        self._size += len(data)
        self.lines.append(dict(line))

    def _read(self, number: int, text: bytes) -> dict[str, Any]:
        try:
            line = json.loads(text)
        except (ValueError, RecursionError) as error:
            reason = " ".join(str(error).split())
            raise ValueError(f"{self.path}, line {number}: is no JSON ({reason}); {self._remedy}") from error
        if not isinstance(line, dict):
            raise ValueError(
                f"{self.path}, line {number}: holds a {type(line).__name__} and no object; {self._remedy}"
            )
        return line

    def _refuse_other(self, now: Mapping[str, Any], then: Mapping[str, Any]) -> None:
        known, asked = dict(_flat(then)), dict(_flat(now))
        for name in {**known, **asked}:
            one, other = known.get(name), asked.get(name)
            if one != other or type(one) is not type(other):
                raise ValueError(
                    f"{self.path}: was begun with {name} {_shown(one)}, and now it is {_shown(other)}; run "
                    f"the command that it was begun with, or {self._remedy}"
                )


def _line(values: Mapping[str, Any]) -> bytes:
    return json.dumps(values).encode() + b"\n"


def _split(text: bytes) -> list[bytes]:
    return text.split(b"\n")[:-1]


def _flat(values: Mapping[str, Any], before: str = "") -> Iterator[tuple[str, Any]]:
    """Values of groups within groups by names with points, `world.max_steps`."""
    for name, value in values.items():
        if isinstance(value, dict) and value:
            yield from _flat(value, f"{before}{name}.")
        else:
            yield before + name, value


def _shown(value: Any) -> str:
    text = "left out" if value is None else json.dumps(value)
    return text if len(text) <= 60 else text[:57] + "..."
