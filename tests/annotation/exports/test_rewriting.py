"""Parquet files with more columns: how the old ones are stored stays as it is."""

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from compared import assert_same_table
from hypothesis import given, settings
from hypothesis import strategies as st

from dpmacro.annotation.exports.rewriting import rewrite, row_count
from dpmacro.data.images import DatasetError

CODECS = ("NONE", "SNAPPY", "GZIP", "ZSTD", "LZ4", "BROTLI")
COLUMNS = {
    "number": pa.int64(),
    "small": pa.float16(),
    "words": pa.large_string(),
    "vector": pa.list_(pa.float32(), 2),
    "ragged": pa.list_(pa.list_(pa.int8())),
    "image": pa.struct([pa.field("bytes", pa.binary()), pa.field("path", pa.string())]),
    "time": pa.timestamp("ns"),
    "kind": pa.dictionary(pa.int32(), pa.string()),
}
VALUES = {
    "number": [1, None, 2**62],
    "small": [0.5, None, 1.0],
    "words": ["a", None, "ü"],
    "vector": [[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]],
    "ragged": [[[1], []], None, [[2, 3]]],
    "image": [{"bytes": b"png", "path": None}, None, {"bytes": None, "path": "x.png"}],
    "time": [1, None, 3],
    "kind": ["a", "b", None],
}


def some_table(rows):
    arrays = [
        pa.array([VALUES[name][row % 3] for row in range(rows)], kind) for name, kind in COLUMNS.items()
    ]
    return pa.table(arrays, pa.schema(list(COLUMNS.items()), {"huggingface": "{}", "by": "another tool"}))


@given(
    sizes=st.lists(st.integers(0, 5), min_size=0, max_size=4),
    codecs=st.fixed_dictionaries({name: st.sampled_from(CODECS) for name in COLUMNS}),
    dictionaries=st.sets(st.sampled_from(sorted(COLUMNS))),
)
@settings(max_examples=25, deadline=None)
def test_all_of_a_file_stays(tmp_path_factory, sizes, codecs, dictionaries):
    folder = tmp_path_factory.mktemp("rewritten")
    table = some_table(sum(sizes))
    paths = {path.split(".")[0]: [] for path in COLUMNS}
    pq.write_table(table, folder / "layout.parquet")
    layout = pq.ParquetFile(folder / "layout.parquet").schema
    for place in range(len(layout)):
        paths[layout.column(place).path.split(".")[0]].append(layout.column(place).path)
    options = {
        "compression": {path: codecs[name] for name, of_name in paths.items() for path in of_name},
        "use_dictionary": [path for name in dictionaries for path in paths[name]],
    }
    first = 0
    with pq.ParquetWriter(folder / "old.parquet", table.schema, **options) as writer:
        for size in sizes:
            writer.write_table(table.slice(first, size))
            first += size
    starts = []

    def columns(start, part):
        starts.append(start)
        return {"label": pa.array(range(start, start + len(part)), pa.int64()), "number": pa.nulls(len(part))}

    rewrite(folder / "old.parquet", folder / "new.parquet", columns, {"words"})
    assert_same_table(folder / "old.parquet", folder / "new.parquet", replaced={"words", "number"})
    found = pq.read_table(folder / "new.parquet")
    assert found.column_names == [*(name for name in COLUMNS if name != "words"), "label"]
    assert found["label"].to_pylist() == list(range(sum(sizes)))
    assert found["number"].null_count == sum(sizes)


def test_damage_in_the_middle_of_a_file(tmp_path):
    path = tmp_path / "old.parquet"
    pq.write_table(pa.table({"x": list(range(5000))}), path, compression="ZSTD")
    content = bytearray(path.read_bytes())
    content[4:1000] = b"?" * 996
    path.write_bytes(content)
    assert row_count(path) == 5000
    with pytest.raises(DatasetError, match=r"old.parquet: half-written or damaged \(.+\); record") as caught:
        rewrite(path, tmp_path / "new.parquet", lambda start, part: {})
    assert "\n" not in str(caught.value)
    with pytest.raises(DatasetError, match=r"none.parquet: is missing"):
        row_count(tmp_path / "none.parquet")
