"""A dataset's files with any damage are refused in one line, or read as sound demonstrations."""

import io
import json
import shutil
import zlib

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st
from lerobot_files import CAMERA, DATA, EPISODES, NUMBERS, VIDEO, as_v2, build, png

from dpmacro.data.demonstrations import Demonstrations
from tests.fuzz.damage import bytes_damage, column_edits, dumped, edited, edits
from tests.fuzz.limits import Findings, cases

FEW = 15
INFO, STATS, WORLD = "meta/info.json", "meta/stats.json", "meta/dpmacro.json"
TASKS, LINES, TASK_LINES = "meta/tasks.parquet", "meta/episodes.jsonl", "meta/tasks.jsonl"


def huge_png(side):
    """A PNG file whose header says `side` squared pixels, of which it holds none."""
    content = bytearray(png(8))
    content[16:24] = side.to_bytes(4, "big") * 2
    content[29:33] = zlib.crc32(bytes(content[12:29])).to_bytes(4, "big")
    return bytes(content)


def common(root):
    """What both kinds have beside `build`: truth, a task column of words, statistics, a world."""
    (root / STATS).write_text(
        json.dumps({name: {"max": [3], "min": [0], "mean": [0.5]} for name in ("phase", "index", "action")})
    )
    (root / WORLD).write_text(
        json.dumps({"world": {"id": "X-v0", "size": 3}, "truth": {"phase": ["a", "b"]}, "symmetric": False})
    )


MORE = {"phase": NUMBERS["index"], "discrete_action": NUMBERS["index"]}


def more(classes):
    columns = {"phase": np.arange(11) % 2}
    return columns | ({"discrete_action": np.arange(11) % 3} if classes else {})


def images(root):
    build(root, columns=more(True), features=MORE)
    common(root)


def films(root):
    build(root, columns=more(False), features={"phase": NUMBERS["index"]}, video={})
    common(root)


def older(root):
    build(root, columns=more(False), features={"phase": NUMBERS["index"]})
    as_v2(root)
    common(root)


DATASETS = {one.__name__: one for one in (images, films, older)}
JSON = {"images": (INFO, STATS, WORLD), "films": (INFO, WORLD), "older": (INFO, STATS)}
JSON_LINES = {"older": (LINES, TASK_LINES)}
SECOND = "data/chunk-000/episode_000001.parquet"
TABLES = {"images": (EPISODES, DATA, TASKS), "films": (EPISODES, DATA), "older": (SECOND,)}
RAW = {"images": (INFO, EPISODES, DATA), "films": (VIDEO, DATA), "older": (INFO, LINES)}
PICTURES = (
    huge_png(100_000),
    huge_png(2**31 - 1),
    huge_png(20_000),
    png(8)[:60],
    b"",
    b"\xff\xd8\xff",
    png(300, np.uint16, (48, 64)),
    png(9, shape=(2, 3, 3)),
)
FILES = ("../../../etc/passwd", "\x00", "x" * 5000, "meta")
CELLS = [{"bytes": content, "path": None} for content in PICTURES]
CELLS += [{"bytes": None, "path": path} for path in FILES]


@pytest.fixture(scope="module")
def roots(tmp_path_factory):
    """Every dataset as it should be."""
    made = {name: tmp_path_factory.mktemp(name) / "d" for name in DATASETS}
    for name, root in made.items():
        DATASETS[name](root)
    return made


def is_read(root):
    """Raises AssertionError where what is read is not what `Demonstrations` promises."""
    read = Demonstrations.load(root)
    n = int(read.lengths.sum())
    assert len(read.lengths) and read.lengths.min() >= 2 and n < 1000
    assert read.fps > 0 and np.isfinite(read.fps)
    assert len(read.actions) == n and len(read.action_names) < 2**17
    if read.vector:
        assert np.isfinite(read.actions).all() and read.actions.shape[1] == len(read.action_names)
    else:
        assert read.actions.min() >= 0 and read.actions.max() < len(read.action_names)
    for key, values in read.observations.items():
        assert isinstance(key, str) and len(values) == n
        assert values.dtype == np.uint8 or np.isfinite(values).all()
    if read.truth is not None:
        assert len(read.truth) == n and read.truth.min() >= 0 and read.truth.max() < len(read.truth_classes)
        assert len(read.truth_classes) < 10_000
    assert isinstance(read.world, dict) and isinstance(read.symmetric, bool)
    assert all(isinstance(text, str) for text in (*read.action_names, *read.truth_classes, *read.tasks))
    assert all("\n" not in note and len(note) < 1000 for note in read.notes)
    assert len(read.episodes) == len(read.lengths)


def copied(root, tmp):
    """A fresh copy of a dataset."""
    shutil.rmtree(tmp / "d", ignore_errors=True)
    return shutil.copytree(root, tmp / "d")


def table_of(content):
    return pq.read_table(io.BytesIO(content))


@pytest.mark.parametrize("kind", DATASETS)
def test_damaged_json(roots, tmp_path, kind):
    old, found = roots[kind], Findings()
    whole = {name: json.loads((old / name).read_text()) for name in JSON[kind]}
    lines = {
        name: [json.loads(line) for line in (old / name).read_text().splitlines()]
        for name in JSON_LINES.get(kind, ())
    }
    parts = [edits(value).map(lambda own, name=name: (name, own)) for name, value in (whole | lines).items()]

    @cases(FEW)
    @given(st.one_of(parts[0], *parts))
    def run(drawn):
        name, changes = drawn
        root = copied(old, tmp_path)
        new = edited((whole | lines)[name], changes)
        text = "\n".join(map(dumped, new)) if name in lines and isinstance(new, list) else dumped(new)
        (root / name).write_text(text)
        found.run(f"{name} {[*map(str, changes)]}", lambda: is_read(root), "")

    run()
    found.check(f"json of {kind}")


@pytest.mark.parametrize("kind", DATASETS)
def test_damaged_tables(roots, tmp_path, kind):
    old, found = roots[kind], Findings()
    tables = {name: pq.read_table(old / name) for name in TABLES[kind]}
    parts = [
        column_edits(table.column_names).map(lambda own, name=name: (name, own))
        for name, table in tables.items()
    ]

    @cases(FEW)
    @given(st.one_of(*parts))
    def run(drawn):
        name, changes = drawn
        root, table = copied(old, tmp_path), tables[name]
        try:
            for change in changes:
                table = change.apply(table)
            pq.write_table(table, root / name)
        except (pa.ArrowException, OverflowError, KeyError):
            return
        found.run(f"{name} {[*map(str, changes)]}", lambda: is_read(root), "")

    run()
    found.check(f"tables of {kind}")


@pytest.mark.parametrize("kind", ["images"])
def test_damaged_pictures(roots, tmp_path, kind):
    old, found = roots[kind], Findings()
    table = pq.read_table(old / DATA)
    cells = st.sampled_from(CELLS) | bytes_damage().map(
        lambda own: {"bytes": own.apply(png(8)), "path": None}
    )

    @cases(FEW)
    @given(st.integers(0, 10), cells)
    def run(row, cell):
        root, values = copied(old, tmp_path), table[CAMERA].to_pylist()
        values[row] = cell
        place = table.column_names.index(CAMERA)
        pq.write_table(table.set_column(place, CAMERA, pa.array(values)), root / DATA)
        found.run(f"{row} {str(cell)[:80]}", lambda: is_read(root), "")

    run()
    found.check(f"pictures of {kind}")


@pytest.mark.parametrize("kind", DATASETS)
def test_damaged_bytes(roots, tmp_path, kind):
    old, found = roots[kind], Findings()

    @cases(FEW)
    @given(st.sampled_from(RAW[kind]), bytes_damage())
    def run(name, change):
        root = copied(old, tmp_path)
        (root / name).write_bytes(change.apply((root / name).read_bytes()))
        found.run(f"{name} {change}", lambda: is_read(root), "")

    run()
    found.check(f"bytes of {kind}")
