"""Datasets that are damaged at random: one line that says what is wrong, or a right dataset."""

import json
import shutil

import numpy as np
import pyarrow.parquet as pq
import pytest
from compared import assert_nothing_lost
from lerobot_files import VIDEO, build

from dpmacro.annotation.exports.dataset import write_labels
from dpmacro.annotation.exports.labelling import read_labels
from dpmacro.data.demonstrations import DatasetError, Demonstrations

CASES = 30
ODD = (None, "", "x", -1, 0, 2**70, 1e308, float("nan"), [], {}, [None], {"a": 1}, True)


def flip(path, rng):
    content = bytearray(path.read_bytes())
    for place in rng.integers(0, len(content), rng.integers(1, 20)):
        content[place] ^= int(rng.integers(1, 256))
    path.write_bytes(content)


def cut(path, rng):
    content = path.read_bytes()
    path.write_bytes(content[: rng.integers(0, len(content))])


def remove(path, rng):
    path.unlink()


def replace_by_folder(path, rng):
    path.unlink()
    path.mkdir()


def replace_by_broken_link(path, rng):
    path.unlink()
    path.symlink_to(path.parent / "nowhere")


def swap_value(path, rng):
    """A value of a JSON file, or a cell of a table, becomes an odd one; other files are cut."""
    odd = ODD[rng.integers(len(ODD))]
    if path.suffix == ".json":
        content = json.loads(path.read_text())
        at = content
        while isinstance(at, dict) and at:
            key = sorted(at)[rng.integers(len(at))]
            if not isinstance(at[key], dict) or rng.random() < 0.3:
                at[key] = odd
                break
            at = at[key]
        path.write_text(json.dumps(content))
    elif path.suffix == ".parquet":
        table = pq.read_table(path)
        column = int(rng.integers(table.num_columns))
        values = table.column(column).to_pylist()
        values[rng.integers(len(values))] = [None, 0, 10**6][rng.integers(3)]
        try:
            table = table.set_column(column, table.schema.field(column), [values])
        except (TypeError, ValueError):  # the type takes no such value
            table = table.remove_column(column)
        pq.write_table(table, path)
    else:
        cut(path, rng)


def drop_column(path, rng):
    if path.suffix != ".parquet":
        return cut(path, rng)
    table = pq.read_table(path)
    pq.write_table(table.remove_column(int(rng.integers(table.num_columns))), path)


def change_rows(path, rng):
    if path.suffix != ".parquet":
        return flip(path, rng)
    table = pq.read_table(path)
    count = max(len(table) + int(rng.integers(-2, 3)), 0)
    pq.write_table(table.take(rng.integers(0, len(table), count)), path)


DAMAGES = (
    flip,
    flip,
    cut,
    remove,
    replace_by_folder,
    replace_by_broken_link,
    swap_value,
    swap_value,
    drop_column,
    change_rows,
)


@pytest.mark.parametrize("seed", range(CASES))
def test_a_damaged_dataset_gives_one_line_or_a_right_dataset(stored, stages, tmp_path, seed):
    rng = np.random.default_rng(seed)
    root, output = tmp_path / "in", tmp_path / "out"
    shutil.copytree(stored, root)
    files = sorted(path for path in root.rglob("*") if path.is_file())
    damage = DAMAGES[rng.integers(len(DAMAGES))]
    damage(files[rng.integers(len(files))], rng)
    before = {path: path.read_bytes() for path in root.rglob("*") if path.is_file()}
    try:
        write_labels(root, output, stages, ["subtask_index", "language", "sarm", "rabc", "mimicgen", "csv"])
    except (ValueError, OSError) as error:
        assert str(error) and "\n" not in str(error)
        assert not output.exists()
    else:
        assert_nothing_lost(root, output, metadata=damage is not flip)
        found = read_labels(output)
        assert np.array_equal(found.labels, stages.labels)
        assert np.allclose(found.confidence, stages.confidence)
    assert before == {path: path.read_bytes() for path in root.rglob("*") if path.is_file()}


@pytest.mark.parametrize("damage", [(b"avc1", b"zz\x01z"), (b"mdhd", b"xxxx")], ids=["codec", "clock"])
def test_a_video_of_no_known_codec_is_one_line(damage, tmp_path):
    root = build(tmp_path / "in", video={})
    content = (root / VIDEO).read_bytes()
    assert damage[0] in content
    (root / VIDEO).write_bytes(content.replace(*damage))
    with pytest.raises(DatasetError, match=r"file-000\.mp4: ") as caught:
        Demonstrations.load(root)
    assert "\n" not in str(caught.value)
