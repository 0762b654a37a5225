"""Files of a dataset -> Python and NumPy: JSON, JSON lines, and checked columns of parquet files."""

import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
from jaxtyping import Int64

from dpmacro.data.images import DatasetError
from dpmacro.utils.checks import in_a_line, shown

__all__ = [
    "column_names",
    "is_file",
    "read_batches",
    "read_json",
    "read_json_lines",
    "read_rows",
    "read_table",
    "to_cells",
    "to_numpy",
    "to_pixels",
]

MOST_ROWS = 2**24  # of a file; a kilobyte may claim more, all alike, and they would fill memory
BATCH = 512  # rows of images that are held encoded, where row groups are not larger
HALF_COPIED = "the dataset is half-copied or half-written"
_LISTS = (pa.types.is_list, pa.types.is_large_list, pa.types.is_fixed_size_list)


def read_json(path: Path) -> dict[str, Any]:
    """A JSON object; DatasetError where the file is missing or holds anything else."""
    content = _parsed(path, _text_of(path))
    if not isinstance(content, dict):
        raise DatasetError(f"{path}: holds a {type(content).__name__}, not an object; record it again")
    return content


def read_json_lines(path: Path) -> list[dict[str, Any]]:
    """The JSON objects of a file, one a line; empty lines are skipped."""
    rows = [_parsed(path, line) for line in _text_of(path).splitlines() if line.strip()]
    for number, row in enumerate(rows):
        if not isinstance(row, dict):
            raise DatasetError(f"{path}: object {number} is a {type(row).__name__}; record the dataset again")
    return rows


def is_file(path: Path) -> bool:
    """Whether there is such a file; false for a name that no file can have."""
    try:
        return path.is_file()
    except OSError:
        return False


def column_names(path: Path) -> list[str]:
    """The columns of a parquet file."""
    return _open(path).schema_arrow.names


def read_table(path: Path, names: Sequence[str] | None = None, rows: Any = None) -> pa.Table:
    """The named columns of a parquet file, or all of them.

    Args:
        path: of the file.
        names: of columns; None for all.
        rows: numbers of rows, in the order wanted, repeats allowed; None for all. Row groups that hold none
            of them are not read.

    Raises DatasetError for a file that is missing or damaged, or lacks a column.
    """
    file = _open(path)
    missing = sorted(set(names or []) - set(file.schema_arrow.names))
    if missing:
        raise DatasetError(f"{path}: has no column {', '.join(missing)} that meta/info.json names")
    try:
        columns = None if names is None else list(names)
        if rows is None:
            return file.read(columns=columns)
        starts = _starts(file)
        group_of = np.searchsorted(starts, rows, "right") - 1
        groups = np.unique(group_of)
        first = np.cumsum([0, *np.diff(starts)[groups]])[:-1]  # of each in what is read
        table = file.read_row_groups(groups.tolist(), columns=columns)
        wanted = first[np.searchsorted(groups, group_of)] + rows - starts[group_of]
        return table if np.array_equal(wanted, np.arange(len(table))) else table.take(pa.array(wanted))
    except (OSError, pa.ArrowException) as error:
        raise _damaged(path, error) from error


def read_batches(
    path: Path, names: Sequence[str], rows: Int64[np.ndarray, " rows"], most: int = BATCH
) -> Iterator[tuple[Int64[np.ndarray, " some"], pa.Table]]:
    """The named columns by whole row groups of about `most` rows: places in `rows`, and what stands there."""
    group_of = np.searchsorted(_starts(_open(path)), rows, "right") - 1
    order, cuts = np.argsort(group_of, kind="stable"), [0]
    for place in (np.flatnonzero(np.diff(group_of[order])) + 1).tolist():
        if place - cuts[-1] >= most:
            cuts.append(place)
    for some in np.split(order, cuts[1:]):
        yield some, read_table(path, names, rows[some])


def read_rows(path: Path, without: str = "stats/") -> list[dict[str, Any]]:
    """The rows of a parquet file, without the columns that begin with `without`."""
    names = [name for name in column_names(path) if not name.startswith(without)]
    return read_table(path, names).to_pylist()


def to_numpy(column: pa.ChunkedArray, where: str, frames: Int64[np.ndarray, " rows"]) -> np.ndarray:
    """A column of numbers or text as [rows] or, where cells are lists of any depth, [rows, size].

    Args:
        column: of a table.
        where: begins the errors.
        frames: the frames that the rows are, for errors.

    Raises DatasetError for a missing value and for lists of different lengths, with the frame.
    """
    values, rows, nested = _plain(column), len(column), False
    _refuse_missing(values, where, frames)
    while any(is_list(values.type) for is_list in _LISTS):
        _refuse_ragged(values, where, frames, rows)
        values, nested = pc.list_flatten(values), True
        _refuse_missing(values, where, frames, len(values) // max(rows, 1))
    kind = values.type
    if pa.types.is_string(kind) or pa.types.is_large_string(kind):
        return np.array(values.to_pylist(), dtype=object)
    if not (pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_boolean(kind)):
        raise DatasetError(f"{where}: holds values of type {kind}; dpmacro reads numbers and text")
    return values.to_numpy().reshape(rows, -1) if nested else values.to_numpy()


def to_cells(column: pa.ChunkedArray) -> list[pa.Buffer | pa.Scalar | str | None]:
    """The images of a column: what is encoded, lists of pixels, the path of a file, or None without any.

    Views into the table: copies would be thousands of small objects whose memory is never given back.
    """
    values = _plain(column)
    kind = values.type
    if pa.types.is_struct(kind):
        fields = {kind.field(place).name for place in range(kind.num_fields)}
        nothing = [None] * len(values)
        encoded = pc.struct_field(values, "bytes") if "bytes" in fields else nothing
        paths = pc.struct_field(values, "path") if "path" in fields else nothing
        return [_cell(content, path) for content, path in zip(encoded, paths, strict=True)]
    if pa.types.is_binary(kind) or pa.types.is_large_binary(kind):
        return [_cell(content, None) for content in values]
    if pa.types.is_string(kind) or pa.types.is_large_string(kind):
        return [_cell(None, path) for path in values]
    if _depth(kind) in (2, 3) and pa.types.is_integer(_innermost(kind)):
        return [cell if cell.is_valid else None for cell in values]
    raise DatasetError(f"holds images as {kind}; dpmacro reads PNG and JPEG files, convert it with LeRobot")


def to_pixels(cell: pa.Scalar) -> np.ndarray | None:
    """An image stored as lists of whole numbers, [height, width] or with colours; None where it is ragged."""
    values, shape = cell.values, [len(cell.values)]
    while any(is_list(values.type) for is_list in _LISTS):
        sizes = pc.list_value_length(values).to_numpy(zero_copy_only=False)
        if not len(sizes) or (sizes != sizes[0]).any():
            return None
        values = pc.list_flatten(values)
        shape.append(int(sizes[0]))
    return None if values.null_count else values.to_numpy(zero_copy_only=False).reshape(shape)


def _depth(kind: pa.DataType) -> int:
    """How many lists lie within one another."""
    return 1 + _depth(kind.value_type) if any(is_list(kind) for is_list in _LISTS) else 0


def _innermost(kind: pa.DataType) -> pa.DataType:
    return _innermost(kind.value_type) if _depth(kind) else kind


def _cell(content: Any, path: Any) -> pa.Buffer | str | None:
    if content is not None and content.is_valid:
        return content.as_buffer()
    return path.as_py() if path is not None else None


def _plain(column: pa.ChunkedArray) -> pa.ChunkedArray:
    """Without the types that Hugging Face's `datasets` registers, and without dictionaries."""
    if isinstance(column.type, pa.BaseExtensionType):
        column = pa.chunked_array([chunk.storage for chunk in column.chunks], column.type.storage_type)
    if pa.types.is_dictionary(column.type):
        column = column.cast(column.type.value_type)
    return column


def _refuse_missing(values: pa.ChunkedArray, where: str, frames: np.ndarray, size: int = 1) -> None:
    if values.null_count:
        row = pc.index(pc.is_null(values), True).as_py() // max(size, 1)
        raise DatasetError(
            f"{where}: has no value at frame {frames[row]} ({values.null_count} missing in all); fill "
            "them in, "
            "leave the column out, or leave out the episode by --dataset.episodes"
        )


def _refuse_ragged(values: pa.ChunkedArray, where: str, frames: np.ndarray, rows: int) -> None:
    sizes = pc.list_value_length(values).to_numpy()
    if len(sizes) and (wrong := np.flatnonzero(sizes != sizes[0])).size:
        row = wrong[0] * rows // len(sizes)
        raise DatasetError(
            f"{where}: has {sizes[wrong[0]]} numbers at frame {frames[row]} and {sizes[0]} at frame "
            f"{frames[0]}; store as many at every frame"
        )


def _starts(file: pq.ParquetFile) -> Int64[np.ndarray, " groups_and_one"]:
    """The first row of every row group, and the number of all rows."""
    sizes = [file.metadata.row_group(group).num_rows for group in range(file.num_row_groups)]
    return np.cumsum([0, *sizes])


def _open(path: Path) -> pq.ParquetFile:
    if not is_file(path):
        raise DatasetError(f"{path}: is missing; {HALF_COPIED}")
    try:
        file = pq.ParquetFile(path)
        names = file.schema_arrow.names
    except (OSError, pa.ArrowException, UnicodeDecodeError) as error:
        raise _damaged(path, error) from error
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise DatasetError(f"{path}: has the column {shown(twice)} twice; write it once")
    if file.metadata.num_rows > MOST_ROWS:
        raise DatasetError(f"{path}: has {file.metadata.num_rows} rows; write {MOST_ROWS} a file at most")
    return file


def _damaged(path: Path, error: Exception) -> DatasetError:
    return DatasetError(f"{path}: half-written or damaged ({in_a_line(error)}); record the dataset again")


def _text_of(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8-sig")  # editors on Windows begin files with a mark
    except OSError as error:
        raise DatasetError(
            f"{path}: cannot be read ({error.strerror}); is this a LeRobot dataset?"
        ) from error
    except UnicodeDecodeError as error:
        raise DatasetError(f"{path}: is not text in UTF-8 ({error}); record the dataset again") from error


def _parsed(path: Path, text: str) -> Any:
    try:
        return json.loads(text)
    except RecursionError as error:
        raise DatasetError(f"{path}: has too many lists within lists; record the dataset again") from error
    except ValueError as error:
        raise DatasetError(f"{path}: is not JSON ({in_a_line(error)}); record the dataset again") from error
