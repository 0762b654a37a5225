"""Subtasks as LeRobot 0.6 reads them: language that is active from a time on, and recipes that ask for it."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pyarrow as pa
from jaxtyping import Int64

from dpmacro.annotation.exports.base import Export
from dpmacro.data.images import DatasetError

__all__ = ["Language"]

PERSISTENT, EVENTS = "language_persistent", "language_events"
ROLE, STYLE = "assistant", "subtask"
_EVENT = [
    pa.field("role", pa.string(), nullable=False),
    pa.field("content", pa.string()),
    pa.field("style", pa.string()),
    pa.field("camera", pa.string()),
    pa.field("tool_calls", pa.list_(pa.string())),
]
_TIMESTAMP = pa.field("timestamp", pa.float32(), nullable=False)
PERSISTENT_TYPE = pa.list_(pa.struct([*_EVENT[:3], _TIMESTAMP, *_EVENT[3:]]))
EVENTS_TYPE = pa.list_(pa.struct(_EVENT))


class Language(Export):
    """`language_persistent`: on every frame of an episode the same list, a row where each segment starts.

    Rows of other styles that the dataset has already stay, and so does a column `language_events`.
    """

    name = "language"
    columns = (PERSISTENT, EVENTS)

    def refusal(self) -> str | None:
        """What is active at a time is not to be told where times go back."""
        for episode, part in zip(self.stages.episodes, self.stages.trajectories, strict=True):
            wrong = np.flatnonzero(np.diff(self.stages.timestamps[part].astype(np.float32)) <= 0)
            if wrong.size:
                return (
                    f"the timestamp of episode {episode} does not rise at frame {wrong[0] + 1}, and it finds "
                    "stages by time: set the timestamps to frame_index / fps, or leave it out"
                )
        return None

    def notes(self) -> tuple[str, ...]:
        """Older readers do not know such columns, and one of LeRobot's own tools does not either."""
        return (
            "language: LeRobot before 0.6 cannot open a dataset with language columns, and "
            "lerobot-dataset-viz of 0.6.1 stops at them; write another dataset with "
            "--formats='[subtask_index]' for both",
        )

    def features(self) -> dict[str, dict[str, Any]]:
        """Both columns must be declared."""
        return {name: {"dtype": "language", "shape": [1], "names": None} for name in self.columns}

    def of_frames(self, places: Int64[np.ndarray, " rows"], table: pa.Table) -> dict[str, pa.Array]:
        """The columns: the episode's list on each of its rows."""
        kind, old = _kept(table)
        ends = np.cumsum(self.stages.lengths)
        episodes, first, which = np.unique(
            np.searchsorted(ends, places, "right"), return_index=True, return_inverse=True
        )
        lists = [
            sorted([*self._rows(int(episode)), *old(int(row))], key=_place)
            for episode, row in zip(episodes, first, strict=True)
        ]
        persistent = pa.array(lists, kind).take(pa.array(which))
        if EVENTS in table.column_names and pa.types.is_list(table.schema.field(EVENTS).type):
            return {PERSISTENT: persistent, EVENTS: table[EVENTS]}
        return {PERSISTENT: persistent, EVENTS: pa.array([[]] * len(table), EVENTS_TYPE)}

    def _rows(self, episode: int) -> list[dict[str, Any]]:
        seconds = self.stages.timestamps[self.stages.trajectories[episode]].astype(np.float32)
        return [
            {
                "role": ROLE,
                "content": self.labelled.name(label),
                "style": STYLE,
                "timestamp": float(seconds[start]),
                "camera": None,
                "tool_calls": None,
            }
            for label, start, _ in self.labelled.segments[episode]
        ]


def _kept(table: pa.Table) -> tuple[pa.DataType, Callable[[int], list[dict[str, Any]]]]:
    """The type of the column, and a function from a row to what others wrote there, subtasks left out."""
    kind = _plain(table.schema.field(PERSISTENT).type) if PERSISTENT in table.column_names else None
    needed = {field.name for field in PERSISTENT_TYPE.value_type}
    if kind is None or {field.name for field in kind.value_type} != needed:
        return PERSISTENT_TYPE, lambda row: []

    def old(row: int) -> list[dict[str, Any]]:
        rows = [one for one in table[PERSISTENT][row].as_py() or () if one is not None]
        for one in rows:
            if one["timestamp"] is None:
                raise DatasetError(f"{PERSISTENT} has a row without timestamp: {one}; annotate it again")
        return [one for one in rows if one["style"] != STYLE]

    return kind, old


def _plain(kind: pa.DataType) -> pa.ListType | None:
    """The type of a list of structs without extensions, which no array is made of; None for other types."""
    if not (pa.types.is_list(kind) and pa.types.is_struct(kind.value_type)):
        return None
    return pa.list_(
        pa.struct([pa.field(one.name, _stored(one.type), one.nullable) for one in kind.value_type])
    )


def _stored(kind: pa.DataType) -> pa.DataType:
    if pa.types.is_list(kind):
        return pa.list_(_stored(kind.value_type))
    return kind.storage_type if isinstance(kind, pa.BaseExtensionType) else kind


def _place(row: dict[str, Any]) -> tuple[float, str, str]:
    return row["timestamp"], row["style"] or "", row["role"] or ""
