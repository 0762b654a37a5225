"""Language columns, and what LeRobot's own reader and recipes find in them."""

import shutil
from dataclasses import replace

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from lerobot_files import DATA, write_table

from dpmacro.annotation.exports.dataset import write_labels

PLAN = {
    "role": "assistant",
    "content": "bring it",
    "style": "plan",
    "timestamp": 0.0,
    "camera": None,
    "tool_calls": None,
}
EVENT = {"role": "user", "content": "where is it?", "style": "vqa", "camera": "front", "tool_calls": None}


def language(root, name="language_persistent"):
    files = sorted((root / "data").rglob("*.parquet"))
    return [cell for path in files for cell in pq.read_table(path)[name].to_pylist()]


def test_rows_are_where_the_segments_start(stored, stages, tmp_path):
    write_labels(stored, tmp_path / "out", stages, ["language"])
    cells = language(tmp_path / "out")
    for part, segments in zip(stages.trajectories, stages.segments, strict=True):
        assert all(cell == cells[part.start] for cell in cells[part])
        for row, (label, start, _) in zip(cells[part.start], segments, strict=True):
            assert row["content"] == stages.names[label]
            assert row["timestamp"] == stages.timestamps[part.start + start]
            assert (row["role"], row["style"], row["camera"]) == ("assistant", "subtask", None)
    assert language(tmp_path / "out", "language_events") == [[]] * len(cells)
    schema = pq.read_schema(tmp_path / "out" / DATA)
    row = schema.field("language_persistent").type.value_type
    assert [field.name for field in row] == ["role", "content", "style", "timestamp", "camera", "tool_calls"]
    assert row.field("timestamp").type == pa.float32() and not row.field("role").nullable


@pytest.mark.parametrize("kind", [None, pa.list_(pa.json_())], ids=["as pyarrow infers it", "JSON"])
def test_what_others_wrote_stays(stored, stages, tmp_path, kind):
    root = tmp_path / "in"
    shutil.copytree(stored, root)
    stale = {**PLAN, "style": "subtask", "content": "an older one"}
    for path in sorted((root / "data").rglob("*.parquet")):
        table = pq.read_table(path)
        persistent = pa.array([[PLAN, stale]] * len(table))
        if kind is not None:
            fields = [pa.field(f.name, f.type) for f in persistent.type.value_type if f.name != "tool_calls"]
            row = pa.struct([*fields, pa.field("tool_calls", kind)])
            values = persistent.flatten()
            children = [values.field(field.name) for field in fields]
            calls = pa.ListArray.from_arrays(
                pa.array([0] * (len(values) + 1), pa.int32()),
                pa.ExtensionArray.from_storage(pa.json_(), pa.array([], pa.string())),
                mask=pa.array([True] * len(values)),
            )
            flat = pa.StructArray.from_arrays([*children, calls], fields=list(row))
            persistent = pa.ListArray.from_arrays(persistent.offsets, flat)
        events = pa.array([[EVENT]] + [[]] * (len(table) - 1))
        table = table.append_column("language_persistent", persistent)
        pq.write_table(table.append_column("language_events", events), path)
    write_labels(root, tmp_path / "out", stages, ["language"])
    cells = language(tmp_path / "out")
    for part, segments in zip(stages.trajectories, stages.segments, strict=True):
        others = [row for row in cells[part.start] if row["style"] != "subtask"]
        assert others == [PLAN]
        own = [row["content"] for row in cells[part.start] if row["style"] == "subtask"]
        assert own == [stages.names[label] for label, _, _ in segments]
        order = [(row["timestamp"], row["style"]) for row in cells[part.start]]
        assert order == sorted(order)
    assert language(tmp_path / "out", "language_events") == language(root, "language_events")


def test_times_must_rise(stored, stages, tmp_path):
    root = tmp_path / "in"
    shutil.copytree(stored, root)
    table = pq.read_table(root / DATA)
    seconds = table["timestamp"].to_numpy().copy()
    seconds[5] = seconds[4]
    columns = {name: table[name].combine_chunks() for name in table.column_names}
    write_table(root / DATA, {**columns, "timestamp": seconds})
    with pytest.raises(ValueError, match="timestamp of episode 0 does not rise at frame 5"):
        write_labels(root, tmp_path / "out", stages, ["language"])


# LeRobot 0.6's own code.


def opened(root):
    pytest.importorskip("lerobot.datasets.language_render", reason="LeRobot before 0.6 has no language")
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    return LeRobotDataset("test/language", root=root)


def test_lerobot_finds_the_stage_at_every_frame(stored, stages, tmp_path):
    write_labels(stored, tmp_path / "out", stages, ["language"])
    dataset = opened(tmp_path / "out")
    from lerobot.datasets.language_render import active_at, emitted_at, nth_next, nth_prev

    for part, segments in zip(stages.trajectories, stages.segments, strict=True):
        for place, (label, start, end) in enumerate(segments):
            for frame in {start, end - 1}:  # at a cut, and one frame before
                item = dataset[part.start + frame]
                now, persistent = float(item["timestamp"]), item["language_persistent"]
                asked = {"persistent": persistent, "style": "subtask"}
                assert active_at(now, **asked)["content"] == stages.names[label]
                following = nth_next(now, **asked)
                assert (following is None) == (place == len(segments) - 1)
                assert (nth_prev(now, **asked) is None) == (place == 0)
                assert item["language_events"] == []
        # LeRobot takes what lies within 0.1 s for emitted now: frames of this data are as far apart.
        assert emitted_at(0.0, events=[], persistent=[persistent[0]], style="subtask") is not None


def test_lerobots_recipe_says_the_stage(stored, stages, tmp_path):
    write_labels(stored, tmp_path / "out", stages, ["language"])
    dataset = opened(tmp_path / "out")
    from lerobot.configs.recipe import MessageTurn, TrainingRecipe
    from lerobot.datasets.language_render import render_sample

    turns = [
        MessageTurn(role="user", content="${task}", stream="high_level"),
        MessageTurn(role="assistant", content="${subtask}", stream="low_level", target=True),
    ]
    recipe = TrainingRecipe(bindings={"subtask": "active_at(t, style=subtask)"}, messages=turns)
    for index in range(len(dataset)):
        item = dataset[index]
        said = render_sample(
            recipe=recipe,
            persistent=item["language_persistent"],
            events=item["language_events"],
            t=float(item["timestamp"]),
            sample_idx=index,
            task=item["task"],
        )
        assert [turn["content"] for turn in said["messages"]] == [
            "bring it",
            stages.names[stages.labels[index]],
        ]


def test_lerobot_batches_frames_with_language(stored, stages, tmp_path):
    write_labels(stored, tmp_path / "out", stages, ["language"])
    dataset = opened(tmp_path / "out")
    import torch
    from lerobot.utils.collate import lerobot_collate_fn

    assert dataset.meta.has_language_columns
    batches = torch.utils.data.DataLoader(dataset, batch_size=11, collate_fn=lerobot_collate_fn)
    found = np.concatenate([batch["macro_action"].numpy() for batch in batches])
    assert np.array_equal(found, stages.labels)


def test_one_frame_stages_are_found(stored, stages, tmp_path):
    labels = stages.labels.copy()
    labels[[11, 18, 23, 32]] = 0  # the last frame of every demonstration
    write_labels(stored, tmp_path / "out", replace(stages, labels=labels), ["language"])
    cells = language(tmp_path / "out")
    assert [cells[index][-1]["content"] for index in (0, 12, 19, 24)] == ["reach"] * 4
