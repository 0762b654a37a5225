"""TensorBoard's HParams rows: what a reader of the events finds."""

import json

import pytest
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
from tensorboard.plugins.hparams import metadata, plugin_data_pb2

from dpmacro.utils.hparams import flat, read_scores, write_row, write_scores

OPTIONS = {
    "seed": 3,
    "dataset": {"root": "a/b", "inputs": ["x", "y"]},
    "planner": {"macros": None, "on": True},
}


def row(folder):
    """Options and scores, as TensorBoard's plugin reads them."""
    events = EventAccumulator(str(folder))
    events.Reload()
    tags = events.PluginTagToContent(metadata.PLUGIN_NAME)
    start = plugin_data_pb2.HParamsPluginData.FromString(tags[metadata.SESSION_START_INFO_TAG])
    kinds = {
        name: getattr(value, value.WhichOneof("kind"))
        for name, value in start.session_start_info.hparams.items()
    }
    experiment = plugin_data_pb2.HParamsPluginData.FromString(tags[metadata.EXPERIMENT_TAG])
    metrics = [one.name.tag for one in experiment.experiment.metric_infos]
    return kinds, {name: events.Scalars(name)[0].value for name in metrics}


def test_options_are_flat():
    assert flat(OPTIONS) == {
        "seed": 3,
        "dataset.root": "a/b",
        "dataset.inputs": '["x", "y"]',
        "planner.macros": "",
        "planner.on": True,
    }


def test_a_reader_finds_options_and_scores_in_one_row(tmp_path):
    write_row(tmp_path, OPTIONS, {"success": 0.25})
    options, scores = row(tmp_path)
    assert options == flat(OPTIONS) | {"Inputs": '["x", "y"]', "Q": "default", "Seed": "3"}
    assert scores == {"score/success": pytest.approx(0.25)}


def test_the_scores_of_a_training_come_back_through_a_link(tmp_path):
    checkpoint = tmp_path / "000300"
    (checkpoint / "training_state").mkdir(parents=True)
    (checkpoint / "pretrained_model").mkdir()
    (tmp_path / "last").symlink_to("000300")
    assert read_scores(tmp_path / "last/pretrained_model") == {}
    write_scores(checkpoint, {"objective": 0.5})
    assert read_scores(tmp_path / "last/pretrained_model") == {"objective": 0.5}
    assert json.loads((checkpoint / "training_state/scores.json").read_text()) == {"objective": 0.5}
