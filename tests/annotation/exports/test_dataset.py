"""The new dataset: all of the old one and the labels, complete or not there, and errors in a line."""

import errno
import json
import os
import shutil
from dataclasses import replace
from pathlib import Path

import lerobot_files
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from compared import assert_nothing_lost
from staged import some_stages
from stopped import killed

from dpmacro.annotation.exports.dataset import write_labels
from dpmacro.annotation.exports.folders import unfinished
from dpmacro.annotation.exports.formats import FORMATS, default_formats
from dpmacro.annotation.exports.labelling import read_labels

ALL = tuple(FORMATS)
FIELDS = ("labels", "idle", "corrected", "names", "lengths", "episodes", "timestamps", "fps")


def assert_same_stages(one, two):
    for field in FIELDS:
        assert np.array_equal(getattr(one, field), getattr(two, field)), field
    assert np.allclose(one.confidence, two.confidence, atol=1e-6)


def tree(root):
    return {path.relative_to(root).as_posix() for path in Path(root).rglob("*") if path.is_file()}


def contents(root):
    return {name: (Path(root) / name).read_bytes() for name in tree(root)}


def test_nothing_is_lost_and_stages_come_back(stored, stages, tmp_path):
    before = contents(stored)
    written = write_labels(stored, tmp_path / "out", stages, ALL)
    assert written.root == tmp_path / "out" and written.formats == ALL
    assert_nothing_lost(stored, tmp_path / "out")
    assert_same_stages(read_labels(tmp_path / "out"), stages)
    assert contents(stored) == before
    assert {path.name for path in tmp_path.iterdir()} == {"out"}


def test_edits_of_stages_change_the_labels_alone(stored, stages, tmp_path):
    write_labels(stored, tmp_path / "one", stages, ALL)
    labels = stages.labels.copy()
    labels[3:6] = 1  # the first cut comes a frame earlier
    edited = replace(
        stages, labels=labels, names=("go", "carry it", "leave"), corrected=np.ones(len(labels), bool)
    )
    written = write_labels(tmp_path / "one", tmp_path / "two", edited, ALL)
    assert written.notes[0].startswith(
        "columns replaced: macro_action, confidence, idle, corrected, subtask_i"
    )
    assert written.notes[0].endswith("dense_subtask_start_frames, dense_subtask_end_frames")
    assert written.notes[1].startswith(
        "files replaced: meta/dpmacro_stages.json, meta/subtasks.parquet, meta/"
    )
    ours = {column for export in FORMATS.values() for column in export.columns}
    ours |= {column for export in FORMATS.values() for column in export.episode_columns}
    ours |= {path for export in FORMATS.values() for path in export.files}
    ours |= {"macro_action", "confidence", "idle", "corrected", "meta/dpmacro_stages.json"}
    assert_nothing_lost(tmp_path / "one", tmp_path / "two", ours)
    assert_nothing_lost(stored, tmp_path / "two")
    assert_same_stages(read_labels(tmp_path / "two"), edited)
    write_labels(tmp_path / "two", tmp_path / "three", stages, ALL)
    assert tree(tmp_path / "three") == tree(tmp_path / "one")
    assert_nothing_lost(tmp_path / "one", tmp_path / "three")


def test_the_columns_are_declared_with_statistics(stored, stages, tmp_path):
    write_labels(stored, tmp_path / "out", stages, ["subtask_index"])
    info = json.loads((tmp_path / "out/meta/info.json").read_text())
    kinds = {"macro_action": "int64", "confidence": "float32", "idle": "bool", "corrected": "bool"}
    for name, kind in {**kinds, "subtask_index": "int64"}.items():
        assert info["features"][name] == {"dtype": kind, "shape": [1], "names": None}
    statistics = json.loads((tmp_path / "out/meta/stats.json").read_text())
    assert statistics["macro_action"]["mean"] == [pytest.approx(stages.labels.mean())]
    assert statistics["idle"]["count"] == [len(stages.labels)] and statistics["idle"]["max"] == [1.0]
    rows = pq.read_table(tmp_path / "out/meta/episodes/chunk-000/file-001.parquet").to_pylist()
    assert rows[0]["stats/macro_action/mean"] == [pytest.approx(stages.labels[19:24].mean())]
    assert set(statistics["action"]) == set(statistics["macro_action"])


def test_demonstrations_may_come_in_any_order(stored, stages, tmp_path):
    write_labels(stored, tmp_path / "one", stages, ALL)
    write_labels(stored, tmp_path / "two", stages.of_episodes((2, 0, 3, 1)), ALL)
    assert contents(tmp_path / "one") == contents(tmp_path / "two")


def test_videos_are_linked_and_metadata_copied(tmp_path):
    root = lerobot_files.build(tmp_path / "in", video={})
    write_labels(root, tmp_path / "out", some_stages((5, 6)), ["csv"])
    assert (root / lerobot_files.VIDEO).samefile(tmp_path / "out" / lerobot_files.VIDEO)
    assert not (root / "meta/tasks.parquet").samefile(tmp_path / "out/meta/tasks.parquet")
    assert_nothing_lost(root, tmp_path / "out")


def test_videos_are_copied_where_there_are_no_links(tmp_path, monkeypatch):
    def refuse(*arguments):
        raise OSError(errno.EXDEV, "Invalid cross-device link")

    monkeypatch.setattr(os, "link", refuse)
    root = lerobot_files.build(tmp_path / "in", video={})
    write_labels(root, tmp_path / "out", some_stages((5, 6)), ["csv"])
    assert not (root / lerobot_files.VIDEO).samefile(tmp_path / "out" / lerobot_files.VIDEO)
    assert_nothing_lost(root, tmp_path / "out")


def test_links_are_followed_as_hugging_faces_cache_has_them(tmp_path):
    root = lerobot_files.build(tmp_path / "in", video={})
    blobs = tmp_path / "blobs"
    blobs.mkdir()
    for number, name in enumerate(sorted(tree(root))):
        shutil.move(root / name, blobs / str(number))
        (root / name).symlink_to(blobs / str(number))
    (root / ".cache").mkdir()
    (root / ".cache/of_the_hub").write_text("x")
    write_labels(root, tmp_path / "out", some_stages((5, 6)), ["csv"])
    assert not any(path.is_symlink() for path in (tmp_path / "out").rglob("*"))
    assert not (tmp_path / "out/.cache").exists()
    shutil.rmtree(root / ".cache")
    assert_nothing_lost(root, tmp_path / "out")


def test_columns_of_any_shape_stay(tmp_path):
    nested = pa.array([[[float(k)] * 3] * 2 for k in range(11)], pa.list_(pa.list_(pa.float32())))
    odd = {"grid": nested, "words": pa.array(["x"] * 11).dictionary_encode(), "big": pa.array([None] * 11)}
    features = {"grid": {"dtype": "float32", "shape": [2, 3], "names": None}}
    root = lerobot_files.build(tmp_path / "in", odd, features, fps=30.0062)
    write_labels(root, tmp_path / "out", some_stages((5, 6), fps=30.0062), ["csv"])
    assert_nothing_lost(root, tmp_path / "out")


def test_by_default_what_the_installed_lerobot_reads(stored, stages, tmp_path):
    written = write_labels(stored, tmp_path / "out", stages)
    assert written.formats == default_formats()
    assert set(written.formats) < set(ALL) and "csv" in written.formats


def test_a_file_of_the_same_name_is_replaced_and_said(tmp_path):
    root = lerobot_files.build(tmp_path / "in")
    (root / "labels.csv").write_text("mine")
    written = write_labels(root, tmp_path / "out", some_stages((5, 6)), ["csv"])
    assert written.notes == ("files replaced: labels.csv",)
    assert (root / "labels.csv").read_text() == "mine"
    assert (tmp_path / "out/labels.csv").read_text().startswith("episode,")


def test_formats_from_before_are_written_anew_or_dropped(stored, stages, tmp_path):
    write_labels(stored, tmp_path / "one", stages, ALL)
    back = replace(stages, labels=np.where(np.arange(33) == 11, 0, stages.labels))
    written = write_labels(tmp_path / "one", tmp_path / "two", back, ["csv"])
    assert set(written.formats) == {"csv", "subtask_index", "language"}
    assert sum("not written" in line for line in written.notes) == 3
    assert not tree(tmp_path / "two") & {"sarm_progress.parquet", "mimicgen.hdf5"}
    table = pq.read_table(tmp_path / "two/meta/episodes/chunk-000/file-000.parquet")
    assert not [name for name in table.column_names if "_subtask_" in name]
    found = pq.read_table(tmp_path / "two/data/chunk-000/file-000.parquet")
    assert found["subtask_index"].to_pylist() == back.labels[:19].tolist()


# What stops a run.


def test_a_run_killed_anywhere_leaves_nothing_finished_and_is_gone_on_with(tmp_path):
    root, stages = lerobot_files.build(tmp_path / "in", video={}), some_stages((5, 6))
    write_labels(root, tmp_path / "whole", stages, ["sarm", "csv"])
    whole, output, at = contents(tmp_path / "whole"), tmp_path / "out", 0

    arguments = (root, output, stages, ["sarm", "csv"])
    while killed(write_labels, arguments, at := at + 1, before=at % 2 == 0):
        partial = tmp_path / ".out.partial/dataset"
        if output.exists():  # the last rename is that of the whole folder
            assert contents(output) == whole
            shutil.rmtree(output)
            continue
        # What LeRobot takes for a dataset is one that has this file.
        assert not (partial / "meta/info.json").exists() or tree(partial) >= whole.keys()
        if at % 4 == 0:
            assert killed(write_labels, arguments, 1, before=True)  # and again
        done = {name: (partial / name).stat().st_ino for name in tree(partial) & whole.keys()}
        assert at < 3 or done
        write_labels(*arguments)
        assert contents(output) == whole
        assert {name: (output / name).stat().st_ino for name in done} == done
        shutil.rmtree(output)
    assert at > 9
    assert contents(output) == whole
    assert {path.name for path in tmp_path.iterdir()} == {"in", "whole", "out"}


def test_other_labels_are_not_mixed_with_those_of_a_stopped_run(stored, stages, tmp_path):
    other = replace(stages, labels=stages.labels[::-1].copy())
    assert killed(write_labels, (stored, tmp_path / "out", stages, ["csv"]), 6)
    assert tree(tmp_path / ".out.partial/dataset")
    write_labels(stored, tmp_path / "out", other, ["csv"])
    assert_same_stages(read_labels(tmp_path / "out"), other)


def test_two_processes_do_not_write_one_dataset(stored, stages, tmp_path):
    with (
        unfinished(tmp_path / "out", "held"),
        pytest.raises(ValueError, match=r"another process writes it; wait"),
    ):
        write_labels(stored, tmp_path / "out", stages, ["csv"])
    assert list((tmp_path / "out").iterdir()) == []  # what the first one wrote: nothing


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EDQUOT])
def test_a_full_disk_is_said_in_a_line_and_gone_on_with(stored, stages, tmp_path, monkeypatch, number):
    def full(source, target):
        raise OSError(number, os.strerror(number), str(target))

    with monkeypatch.context() as patched:
        patched.setattr(shutil, "copyfile", full)
        with pytest.raises(OSError, match=rf"^--output=.*{os.strerror(number)}.*free some space") as caught:
            write_labels(stored, tmp_path / "out", stages, ALL)
    assert "\n" not in str(caught.value) and not (tmp_path / "out").exists()
    write_labels(stored, tmp_path / "out", stages, ALL)
    assert_same_stages(read_labels(tmp_path / "out"), stages)


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() == 0, reason="root may write anywhere")
def test_a_place_without_the_right_to_write(stored, stages, tmp_path):
    tmp_path.chmod(0o555)
    with pytest.raises(OSError, match="give a folder that you may write to"):
        write_labels(stored, tmp_path / "out", stages, ["csv"])


def test_a_file_in_the_way(stored, stages, tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(OSError, match=r"^--output=.*cannot be written \(Not a directory"):
        write_labels(stored, tmp_path / "file/out", stages, ["csv"])


# What is refused before anything is written.


def refused(tmp_path, message, root, stages, output=None, formats=("csv",), **options):
    before = contents(root) if Path(root).is_dir() else None
    with pytest.raises(ValueError, match=message) as caught:
        write_labels(root, output or tmp_path / "out", stages, formats, **options)
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "out").exists() and not list(tmp_path.glob(".*.partial"))
    assert before is None or contents(root) == before


def test_places_that_cannot_be(stored, stages, tmp_path):
    full = tmp_path / "full"
    full.mkdir()
    (full / "something").touch()
    refused(tmp_path, "exists already; remove it or give another", stored, stages, full)
    refused(tmp_path, "lie one in the other: give a folder beside it", stored, stages, stored / "out")
    refused(tmp_path, "lie one in the other", stored, stages, stored.parent)
    refused(tmp_path, "lie one in the other", stored, stages, stored)
    link = tmp_path / "link"
    link.symlink_to(stored)
    refused(tmp_path, "lie one in the other", stored, stages, link / "out")
    write_labels(stored, tmp_path / "done", stages, ["csv"])
    refused(tmp_path, "holds a dataset already; remove it", stored, stages, tmp_path / "done")
    refused(tmp_path, "no such folder", tmp_path / "nothing", stages)
    (tmp_path / "empty").mkdir()
    write_labels(stored, tmp_path / "empty", stages, ["csv"])


def test_labels_of_other_episodes(stored, stages, tmp_path):
    some = stages.of_episodes((0, 2, 3))
    refused(tmp_path, r"1 of them have no labels \(episode 1 first\); annotate all", stored, some)
    other = replace(stages, episodes=(0, 1, 2, 9))
    refused(tmp_path, r"1 of them have no labels \(episode 3", stored, other)
    more = some_stages((*stages.lengths.tolist(), 3))
    refused(tmp_path, "has no episode 4, which has labels", stored, more)
    short = some_stages((12, 7, 5, 8))
    refused(tmp_path, "episode 3 has 9 frames, and 8 have labels", stored, short)


def test_datasets_of_another_format(tmp_path):
    root = lerobot_files.as_v2(lerobot_files.build(tmp_path / "in"))
    refused(tmp_path, "is of LeRobot format v2.1.*convert_dataset_v21_to_v30", root, some_stages((5, 6)))


def test_a_dataset_without_a_video(tmp_path):
    root = lerobot_files.build(tmp_path / "in", video={})
    (root / lerobot_files.VIDEO).unlink()
    refused(tmp_path, r"mp4: is missing; the dataset is half-copied", root, some_stages((5, 6)))


def test_rows_of_no_episode(tmp_path):
    root = lerobot_files.build(tmp_path / "in")
    shutil.copy(root / lerobot_files.DATA, root / "data/chunk-000/file-001.parquet")
    refused(tmp_path, "row 0 is of no episode that meta/episodes lists", root, some_stages((5, 6)))


def test_a_folder_that_holds_itself(tmp_path):
    root = lerobot_files.build(tmp_path / "in")
    (root / "data/again").symlink_to(root)
    refused(tmp_path, "is a link to a folder that it lies in", root, some_stages((5, 6)))


def test_formats_that_cannot_be(stored, stages, tmp_path):
    refused(tmp_path, "formats hold 'srm': choose from subtask_index, ", stored, stages, formats=["srm"])
    back = replace(stages, labels=np.where(np.arange(33) == 11, 0, stages.labels))
    refused(tmp_path, r"^sarm: cannot be written, stages come back \('reach' in", stored, back, formats=ALL)
    written = write_labels(stored, tmp_path / "out", back, ALL, skip=True)
    assert written.formats == ("subtask_index", "language", "csv")
    assert [line.split(":")[0] for line in written.notes] == ["language", "sarm", "rabc", "mimicgen"]


def test_datasets_without_labels_are_not_read(stored, tmp_path, stages):
    with pytest.raises(ValueError, match="has no column macro_action, confidence, idle, corrected; annotate"):
        read_labels(stored)
    write_labels(stored, tmp_path / "out", stages, ["csv"])
    (tmp_path / "out/meta/dpmacro_stages.json").unlink()
    with pytest.raises(ValueError, match="is missing, which names the stages; give their names"):
        read_labels(tmp_path / "out")
    assert_same_stages(read_labels(tmp_path / "out", stages.names), stages)
    with pytest.raises(ValueError, match="labels are 0 to 2: give 0 to 1"):
        read_labels(tmp_path / "out", ["a", "b"])
