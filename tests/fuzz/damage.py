"""A grammar of damage: edits of JSON, of tensors, of tables and of bytes, each told in a line."""

import copy
import json
import math
import re
import struct
from dataclasses import dataclass
from typing import Any

import pyarrow as pa
import torch
from hypothesis import strategies as st

HUGE = 10**400

ODD = (
    None, True, False, 0, -1, 1, 2, 3, 7, 255, 1000, 10**5, 10**9, -(10**9), 2**31, 2**63, -(2**63) - 1, HUGE,
    0.5, -0.0, 1.5, 1e-300, 1e300, math.nan, math.inf, -math.inf,
    "", "x", "0", "../../x", "/etc/hostname", "$x$", "a\nb", "\x00", "é" * 300, "{x}", "{0}", "nan",
    "{episode_index:0999999999d}", "{chunk_index:0999999999d}", "{chunk_index!r:>999999999}",
    "{video_key.__class__}", "{chunk_index:{chunk_index}}",
    "image", "video", "int64", "float32", "string", "bool", "concat", "pixels", "rectangles", "state", "task",
    "dpboost", "baseline", "huber", "exponential", "chain", "free", "observation.state", "observation.image",
    [], [[]], [0], [1, 2], [10**9, 10**9], [20000, 20000], [20000, 20000, 3], [0, 0, 3], [None], ["x"],
    [[0, 1]], [math.nan], [0] * 1000, {}, {"x": 1}, {"": None}, {"kind": "concat", "parts": []},
)  # fmt: skip


DEEP = re.compile('"<deep ([0-9]+)>"')  # in text of JSON: stands for so many lists within one another


def nodes(value: Any, path: tuple = ()) -> list[tuple]:
    """The paths of all values within a value of JSON, () for itself."""
    found = [path]
    for key, inner in (
        value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    ):
        found += nodes(inner, (*path, key))
    return found


@dataclass(frozen=True)
class Edit:
    """What is done at a place of a value of JSON."""

    path: tuple
    action: str
    value: Any = None

    def __str__(self) -> str:
        told = repr(self.value) if not isinstance(self.value, int) or abs(self.value) < 10**40 else "10**400"
        return f"{'/'.join(map(str, self.path)) or 'all'} {self.action} {told[:60]}"

    def apply(self, value: Any) -> Any:
        """The value edited, a copy."""
        value = copy.deepcopy(value)
        if not self.path:
            return self._changed(value)
        holder = value
        try:
            for key in self.path[:-1]:
                holder = holder[key]
            if self.action == "drop":
                del holder[self.path[-1]]
            elif self.action == "rename" and isinstance(holder, dict):
                holder[str(self.value)] = holder.pop(self.path[-1])
            else:
                holder[self.path[-1]] = self._changed(holder[self.path[-1]])
        except (KeyError, IndexError, TypeError):
            pass  # an edit before this one took the place away
        return value

    def _changed(self, old: Any) -> Any:
        number = isinstance(old, int | float) and not isinstance(old, bool)
        listed = isinstance(old, list)
        return {
            "becomes": lambda: self.value,
            "deep": lambda: f"<deep {self.value}>",
            "more": lambda: old + 1 if number else old,
            "less": lambda: old - 1 if number else old,
            "times": lambda: old * 1000 if number else old * 2 if listed else old,
            "text": lambda: str(old),
            "listed": lambda: [old],
            "longer": lambda: [*old, old[-1] if old else 0] if listed else old,
            "shorter": lambda: old[:-1] if listed else old,
            "reversed": lambda: old[::-1] if listed else old,
        }.get(self.action, lambda: old)()


def edits(value: Any) -> st.SearchStrategy[list[Edit]]:
    """One to three edits of a value of JSON."""
    places = nodes(value)
    shallow = [path for path in places if len(path) <= 2]
    path = st.sampled_from(places) | st.sampled_from(shallow)
    simple = st.sampled_from(
        ("more", "less", "times", "text", "listed", "longer", "shorter", "reversed", "drop")
    )
    one = st.one_of(
        st.builds(Edit, path, st.just("becomes"), st.sampled_from(ODD)),
        st.builds(Edit, path, st.just("becomes"), st.sampled_from(ODD)),
        st.builds(Edit, path, simple),
        st.builds(Edit, path, st.just("rename"), st.sampled_from(("x", "kind", "type", "shape", ""))),
        st.builds(Edit, path, st.just("deep"), st.sampled_from((50, 3000))),
    )
    return st.lists(one, min_size=1, max_size=3)


def edited(value: Any, changes: list[Edit]) -> Any:
    """The value after all edits."""
    for change in changes:
        value = change.apply(value)
    return value


def dumped(value: Any) -> str:
    """JSON, with the deep lists that `Edit` asks for."""
    return DEEP.sub(lambda found: "[" * int(found[1]) + "]" * int(found[1]), json.dumps(value))


@dataclass(frozen=True)
class Bytes:
    """A file cut short, or with other bytes from a place on."""

    share: float
    cut: bool
    content: bytes = b""

    def apply(self, content: bytes) -> bytes:
        """The content damaged."""
        place = int(self.share * len(content))
        if self.cut:
            return content[:place]
        return content[:place] + self.content + content[place + len(self.content) :]


def bytes_damage() -> st.SearchStrategy[Bytes]:
    """Any place; one to eight other bytes."""
    share = st.floats(0, 1, exclude_max=True) | st.sampled_from((0.0, 0.01, 0.02, 0.98, 0.99))
    return st.builds(Bytes, share, st.booleans(), st.binary(min_size=1, max_size=8))


TYPES = (
    torch.int64,
    torch.int32,
    torch.uint8,
    torch.float32,
    torch.float64,
    torch.float16,
    torch.bool,
    torch.bfloat16,
)
VALUES = (0, -1, 1, 7, 255, 1000, 2**31 - 1, -(2**31), 2**62, math.nan, math.inf, -math.inf, 1e38)


@dataclass(frozen=True)
class TensorEdit:
    """What is done to one tensor of several."""

    name: str
    action: str
    value: Any = None
    place: float = 0.0

    def __str__(self) -> str:
        return f"{self.name} {self.action} {self.value}"

    def apply(self, tensors: dict[str, torch.Tensor]) -> None:
        """Edits the dictionary in place."""
        old = tensors.get(self.name)
        if old is None:
            return
        if self.action == "drop":
            del tensors[self.name]
        elif self.action == "rename":
            tensors[self.value] = tensors.pop(self.name)
        else:
            with_tensor = self._changed(old.clone())
            tensors[self.name] = with_tensor.contiguous()

    def _changed(self, old: torch.Tensor) -> torch.Tensor:
        if self.action == "type":
            return old.to(self.value)
        if self.action in ("one", "all"):
            value = self.value
            if old.dtype == torch.bool:
                value = bool(value)
            elif old.is_floating_point():
                most = torch.finfo(old.dtype).max
                value = max(min(value, most), -most) if math.isfinite(value) else value
            else:
                bounds = torch.iinfo(old.dtype)
                value = max(min(int(value), bounds.max), bounds.min) if math.isfinite(value) else 0
            flat = old.flatten()
            if self.action == "all" or not len(flat):
                return torch.full_like(old, value)
            flat[int(self.place * len(flat))] = value
            return flat.view(old.shape)
        axis = int(self.place * max(old.ndim, 1))
        if self.action == "shape":
            return torch.zeros(self.value, dtype=old.dtype)
        if old.ndim == 0:
            return old[None]
        return {
            "shorter": lambda: old.narrow(axis, 0, max(old.shape[axis] - 1, 0)),
            "longer": lambda: torch.cat([old, old.narrow(axis, 0, min(1, old.shape[axis]))], axis),
            "none": lambda: old.narrow(axis, 0, 0),
            "flat": lambda: old.flatten(),
            "axis": lambda: old[None],
            "transposed": lambda: old.transpose(0, -1),
            "reversed": lambda: old.flip(axis),
        }[self.action]()


def tensor_edits(names: list[str]) -> st.SearchStrategy[list[TensorEdit]]:
    """One or two edits of named tensors."""
    name, place = st.sampled_from(names), st.floats(0, 1, exclude_max=True)
    simple = st.sampled_from(("shorter", "longer", "none", "flat", "axis", "transposed", "reversed", "drop"))
    shapes = (
        (),
        (0,),
        (1,),
        (0, 10**9),
        (10**9, 0),
        (0, 10**9, 2, 3),
        (0, 3, 2, 10**9),
        (10**7, 0, 2, 3),
        (2**40, 0),
    )
    others = ("x", "x.y", "actor.stumps.x", "actor.convnet.votes", "features.7.table", "stretches.x", *names)
    one = st.one_of(
        st.builds(TensorEdit, name, simple, st.none(), place),
        st.builds(TensorEdit, name, st.sampled_from(("one", "all")), st.sampled_from(VALUES), place),
        st.builds(TensorEdit, name, st.just("type"), st.sampled_from(TYPES)),
        st.builds(TensorEdit, name, st.just("shape"), st.sampled_from(shapes)),
        st.builds(TensorEdit, name, st.just("rename"), st.sampled_from(others)),
    )
    return st.lists(one, min_size=1, max_size=2)


def with_header(content: bytes, changes: list[Edit]) -> bytes:
    """A file of safetensors with edits of its header."""
    (size,) = struct.unpack("<Q", content[:8])
    header = dumped(edited(json.loads(content[8 : 8 + size]), changes)).encode()
    return struct.pack("<Q", len(header)) + header + content[8 + size :]


def header_of(content: bytes) -> Any:
    """The header of a file of safetensors."""
    return json.loads(content[8 : 8 + struct.unpack("<Q", content[:8])[0]])


@dataclass(frozen=True)
class ColumnEdit:
    """What is done to a column of a table."""

    name: str
    action: str
    value: Any = None
    place: float = 0.0

    def __str__(self) -> str:
        return f"{self.name} {self.action} {str(self.value)[:60]}"

    def apply(self, table: pa.Table) -> pa.Table:
        """The table edited; as it is where Arrow cannot hold the edit."""
        if self.name not in table.column_names:
            return table
        at = table.column_names.index(self.name)
        if self.action == "drop":
            return table.remove_column(at)
        if self.action == "rename":
            return table.rename_columns(
                [self.value if name == self.name else name for name in table.column_names]
            )
        values = table[self.name].to_pylist()
        row = int(self.place * len(values))
        if self.action == "one" and values:
            values[row] = self.value
        elif self.action == "all":
            values = [self.value] * len(values)
        elif self.action == "in" and values:
            values[row] = Edit(tuple(nodes(values[row])[-1]), "becomes", self.value).apply(values[row])
        elif self.action == "reversed":
            values = values[::-1]
        try:
            kind = self.value if self.action == "type" else None
            return table.set_column(at, self.name, pa.array(values, kind))
        except (pa.ArrowException, OverflowError, TypeError, ValueError):
            return table


KINDS = (
    pa.int8(),
    pa.int32(),
    pa.uint64(),
    pa.float32(),
    pa.float64(),
    pa.string(),
    pa.bool_(),
    pa.timestamp("us"),
    pa.list_(pa.float32()),
    pa.list_(pa.list_(pa.int64())),
    pa.binary(),
)


def column_edits(names: list[str], extra: tuple = ()) -> st.SearchStrategy[list[ColumnEdit]]:
    """One or two edits of named columns; `extra` values beside the odd ones."""
    name, place = st.sampled_from(names), st.floats(0, 1, exclude_max=True)
    value = st.sampled_from((*ODD, *extra)) | st.sampled_from(extra or ODD)
    one = st.one_of(
        st.builds(ColumnEdit, name, st.sampled_from(("one", "all", "in")), value, place),
        st.builds(ColumnEdit, name, st.sampled_from(("drop", "reversed"))),
        st.builds(ColumnEdit, name, st.just("type"), st.sampled_from(KINDS)),
        st.builds(ColumnEdit, name, st.just("rename"), st.sampled_from((*names, "x", ""))),
    )
    return st.lists(one, min_size=1, max_size=2)
