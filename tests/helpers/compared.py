"""Whether a dataset with labels has all that the one without has, compared field by field."""

import json

import pyarrow.parquet as pq

REWRITTEN = {"meta/info.json", "meta/stats.json"}


def assert_nothing_lost(root, output, replaced=(), metadata=True):
    """Frames, columns, types, row groups, compression and metadata of `root` are those of `output`.

    `replaced` are features that `output` may have otherwise. Metadata of a schema may stand in a file twice,
    of which damage may change one: then there is nothing to compare.
    """
    for path in sorted(root.rglob("*")):
        name = path.relative_to(root).as_posix()
        if not path.is_file() or name in REWRITTEN or name in replaced:
            continue
        other = output / name
        if path.suffix == ".parquet" and name.startswith(("data/", "meta/episodes/")):
            assert_same_table(path, other, replaced, metadata)
        else:
            assert path.read_bytes() == other.read_bytes(), name
    for name in REWRITTEN:
        if (root / name).is_file():
            assert_within(
                json.loads((root / name).read_text()), json.loads((output / name).read_text()), replaced
            )


def assert_same_table(path, other, replaced=(), metadata=True):
    one, two = pq.ParquetFile(path), pq.ParquetFile(other)
    names = [name for name in one.schema_arrow.names if not _replaced(name, replaced)]
    # As text: a number that is none does not equal itself.
    assert str(one.read(columns=names).to_pylist()) == str(two.read(columns=names).to_pylist())
    assert [one.schema_arrow.field(name) for name in names] == [
        two.schema_arrow.field(name) for name in names
    ]
    assert not metadata or one.schema_arrow.metadata == two.schema_arrow.metadata
    assert one.num_row_groups == two.num_row_groups
    for group in range(one.num_row_groups):
        stored = {c.path_in_schema: c for c in columns_of(two, group)}
        for column in columns_of(one, group):
            if not _replaced(column.path_in_schema.split(".")[0], replaced):
                same = stored[column.path_in_schema]
                assert (column.compression, column.num_values) == (same.compression, same.num_values)
                assert column.has_dictionary_page == same.has_dictionary_page


def columns_of(file, group):
    part = file.metadata.row_group(group)
    return [part.column(place) for place in range(part.num_columns)]


def assert_within(old, new, replaced=()):
    """Every value of `old` is in `new` at the same place, but for what is replaced."""
    if isinstance(old, dict):
        for key, value in old.items():
            if key not in replaced:
                assert_within(value, new[key], replaced)
    else:
        assert json.dumps(old) == json.dumps(new)


def _replaced(name, replaced):
    return name in replaced or (name.startswith("stats/") and name.split("/")[1] in replaced)
