"""A dataset's metadata is checked as it is opened: each defect is one line with the file, value and remedy.

tests/fuzz damages every field; here stand the kinds that once ended in another error or filled memory.
"""

import json

import cv2
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from lerobot_files import (
    CAMERA,
    DATA,
    VIDEO,
    build,
    edit_feature,
    edit_info,
    edit_rows,
    edit_table,
    png,
)

from dpmacro.data.demonstrations import DatasetError, Demonstrations
from dpmacro.data.lerobot.headers import stated_size
from dpmacro.data.lerobot.schema import filled
from tests.fuzz.limits import limited
from tests.fuzz.test_datasets import huge_png

N = 11


def write(name, value):
    def change(root):
        (root / name).write_text(value if isinstance(value, str) else json.dumps(value))

    return change


def info(**changes):
    return lambda root: edit_info(root, **changes)


def feature(name, **changes):
    return lambda root: edit_feature(root, name, **changes)


def table(path=DATA, **columns):
    return lambda root: edit_table(root, path, **columns)


def rows(**changes):
    return lambda root: edit_rows(root, lambda given: [row.update(changes) for row in given])


def lost(change):
    """The data lie where no usual template finds them."""

    def both(root):
        change(root)
        (root / DATA).rename(root / "data/elsewhere.parquet")

    return both


def twice(root):
    old = pq.read_table(root / DATA)
    pq.write_table(
        old.rename_columns(["action" if name == "index" else name for name in old.column_names]), root / DATA
    )


def cell(content):
    def change(root):
        cells = [{"bytes": png(8), "path": None}] * (N - 1) + [{"bytes": content, "path": None}]
        edit_table(root, **{CAMERA: pa.array(cells)})

    return change


WIDE = "data/{chunk_index:0999999999d}/{file_index}.parquet"
WORLD = "meta/dpmacro.json"
DEFECTS = {
    "deep lists": (write(WORLD, "[" * 5000 + "]" * 5000), "too many lists within lists"),
    "a world that is a list": (
        write(WORLD, {"world": [1]}),
        r"dpmacro\.json: world is \[1\]; write",
    ),
    "an id that is a number": (write(WORLD, {"world": {"id": 3}}), "world is .*; write"),
    "truth that is text": (
        write(WORLD, {"truth": "phase"}),
        "truth is 'phase'; write a list of names",
    ),
    "classes that are numbers": (
        write(WORLD, {"truth": {"phase": [1]}}),
        "truth is .*; write a list",
    ),
    "a giant width": (
        lost(info(data_path=WIDE)),
        "data_path is .*0999999999d.*; write data/chunk",
    ),
    "a template of Python's objects": (lost(info(data_path="{chunk_index.__class__}")), None),
    "a template that leads out": (
        lost(info(data_path="../{chunk_index}{file_index}")),
        "leads out of the",
    ),
    "a shape that is a number": (
        feature("action", shape=3),
        "shape of action is 3; write a list",
    ),
    "a shape without bounds": (feature("action", shape=[10**9, 10**9]), "shape of action is"),
    "a dtype that is a list": (feature("action", dtype=["float32"]), None),
    "fps without bounds": (info(fps=1e12), "fps is 1000000000000.0; write how many frames a second has"),
    "an episode_index of text": (rows(episode_index="one"), "a row has episode_index 'one'"),
    "tasks that are a number": (rows(tasks=3), "tasks of episode 0 is 3; write a list"),
    "a file number that is a list": (
        rows(**{"data/file_index": [1]}),
        "file_index of episode 0 is ",
    ),
    "a column twice": (twice, "has the column 'action' twice; write it once"),
    "frame_index of text": (table(frame_index=list("abcdefghijk")), "frame_index is not one number a row"),
    "episode_index of lists": (table(episode_index=[[0, 0]] * N), "episode_index is not one number a row"),
    "two tasks a frame": (
        table(task_index=[[0, 1]] * N),
        "task_index is not one number a frame",
    ),
    "a header of 100,000 squared": (cell(huge_png(100_000)), "frame 10 is 100000x100000 by its header"),
    "a header of 20,000 squared": (cell(huge_png(20_000)), "frame 10 is 20000x20000 by its header"),
    "a name that no file can have": (table(**{CAMERA: ["x" * 5000] * N}), "damaged or missing"),
}


@pytest.mark.parametrize("case", DEFECTS)
def test_a_defect_is_one_line(tmp_path, case):
    change, line = DEFECTS[case]
    root = build(tmp_path / "d")
    change(root)
    if line is None:
        assert len(Demonstrations.load(root).actions) == N
        return
    with pytest.raises(DatasetError, match=line) as caught, limited():
        Demonstrations.load(root)
    assert str(root) in str(caught.value) and "\n" not in str(caught.value) and len(str(caught.value)) < 700


def test_truth_and_statistics_of_huge_numbers_take_no_memory(tmp_path):
    huge = np.arange(N) * 10**17
    root = build(
        tmp_path / "d", columns={"phase": huge}, features={"phase": {"dtype": "int64", "shape": [1]}}
    )
    for statistics in ({"max": [10**300]}, {"max": [1e300]}, {"max": "x"}, [], {"max": [[1], [1, 2]]}):
        (root / "meta/stats.json").write_text(json.dumps({"phase": statistics}))
        with limited():
            read = Demonstrations.load(root, truth="phase")
        assert len(read.truth_classes) == N


def test_a_note_of_a_long_rate_is_a_short_line(tmp_path):
    root = build(tmp_path / "d")
    edit_info(root, fps="x" * 5000)
    assert max(map(len, Demonstrations.load(root).notes)) < 300


def test_a_file_of_more_rows_than_memory_holds(tmp_path):
    root = build(tmp_path / "d")
    pq.write_table(pa.table({"episode_index": pa.array(np.zeros(2**24 + 1, np.int8))}), root / DATA)
    with pytest.raises(DatasetError, match=r"has 16777217 rows; write 16777216 a file at most"):
        Demonstrations.load(root)


def test_a_video_whose_title_is_in_no_encoding_is_read(tmp_path):
    root = build(tmp_path / "d", video={})
    content = (root / VIDEO).read_bytes()
    assert b"Lavf" in content
    (root / VIDEO).write_bytes(content.replace(b"Lavf", b"\xff\xfe\xff\xfe"))
    assert len(Demonstrations.load(root).images) == N


@pytest.mark.parametrize(
    ("template", "path"),
    [
        ("a/{x:03d}.p", "a/007.p"),
        ("{x}", "7"),
        ("{x:3}", "  7"),
        ("a", None),
        (None, None),
        ("{y}", None),
        ("{x.real}", None),
    ],
)
def test_templates(template, path):
    assert filled(template, {"x": 7}) == path


@pytest.mark.parametrize(
    "template", ["{x:099d}", "{x!r}", "{x:>3}", "{x:{x}}", "../{x}", "/{x}", "a\n{x}", "{x"]
)
def test_templates_that_cannot_be_filled(template):
    with pytest.raises(ValueError, match=r"width|leads out|expected"):
        filled(template, {"x": 7})


def test_the_size_by_the_header():

    image = np.zeros((48, 64, 3), np.uint8)
    for ending in (".png", ".jpg"):
        content = cv2.imencode(ending, image)[1].tobytes()
        assert stated_size(content) == (64, 48)
        assert all(stated_size(content[:cut]) in (None, (64, 48)) for cut in range(0, len(content), 7))
    assert stated_size(b"\xff\xd8" + b"\xff" * 50) is None and stated_size(b"GIF89a") is None
