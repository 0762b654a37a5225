"""A parquet file with more columns; what it has already stays as it is stored."""

import io
from collections.abc import Callable, Collection
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from dpmacro.data.images import DatasetError
from dpmacro.data.lerobot.tables import column_names

__all__ = ["rewrite", "row_count"]

Columns = Callable[[int, pa.Table], dict[str, pa.Array]]
USUAL = "SNAPPY"  # compression of new columns where the file has none to follow
AS_ARGUMENT = {"UNCOMPRESSED": "NONE", "LZ4_RAW": "LZ4"}  # names in files -> names that the writer takes


def row_count(path: Path) -> int:
    """Rows of a parquet file; DatasetError where it is missing or damaged."""
    column_names(path)
    return pq.ParquetFile(path).metadata.num_rows


def rewrite(source: Path, target: Path, columns: Columns, dropped: Collection[str] = ()) -> None:
    """Write `source` with more columns to `target`.

    Row groups, compression, types and the schema's metadata stay. A row group is in memory at a time.

    Args:
        source: a parquet file.
        target: where to write.
        columns: from the number of the first row, and the rows, of a row group to its new columns. One that
            is there already is replaced where it stands; others are appended.
        dropped: columns to leave out.

    Raises DatasetError where `source` is missing or damaged.
    """
    column_names(source)
    file = pq.ParquetFile(source)
    groups: list[int | None] = [*range(file.num_row_groups)] or [None]
    first, writer = 0, None
    try:
        for group in groups:
            table = file.schema_arrow.empty_table() if group is None else _read(file, group, source)
            changed = _changed(table, columns(first, table), dropped)
            first += len(table)
            if writer is None:
                writer = pq.ParquetWriter(target, changed.schema, **_encoding(file, changed))
            if group is not None:
                writer.write_table(changed, row_group_size=max(len(changed), 1))
    finally:
        if writer is not None:
            writer.close()


def _read(file: pq.ParquetFile, group: int, source: Path) -> pa.Table:
    try:
        return file.read_row_group(group)
    except (OSError, pa.ArrowException) as error:
        reason = str(error).splitlines()[0]
        raise DatasetError(
            f"{source}: half-written or damaged ({reason}); record the dataset again"
        ) from error


def _changed(table: pa.Table, columns: dict[str, pa.Array], dropped: Collection[str]) -> pa.Table:
    table = table.drop_columns([name for name in table.column_names if name in dropped])
    for name, values in columns.items():
        field = pa.field(name, values.type)
        place = table.schema.get_field_index(name)
        table = table.append_column(field, values) if place < 0 else table.set_column(place, field, values)
    return table


def _encoding(file: pq.ParquetFile, changed: pa.Table) -> dict[str, object]:
    """Compression and dictionaries as in the file, by the paths that parquet gives columns."""
    if not file.num_row_groups:
        return {"compression": USUAL}
    group = file.metadata.row_group(0)
    stored = [group.column(place) for place in range(group.num_columns)]
    codecs = {one.path_in_schema: AS_ARGUMENT.get(one.compression, one.compression) for one in stored}
    plain = {one.path_in_schema for one in stored if not one.has_dictionary_page}
    usual = next(iter(codecs.values()), USUAL)
    empty = io.BytesIO()
    pq.write_table(changed.slice(0, 0), empty)
    layout = pq.ParquetFile(empty).schema
    paths = [layout.column(place).path for place in range(len(layout))]
    return {
        "compression": {path: codecs.get(path, usual) for path in paths},
        "use_dictionary": [path for path in paths if path not in plain],
    }
