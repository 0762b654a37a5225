"""What a training says while it runs."""

import itertools
from pathlib import Path

import numpy as np
import pytest
import torch
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
from torch.utils.tensorboard import SummaryWriter

from dpmacro.boosting.loop import Round
from dpmacro.data.demonstrations import Demonstrations
from dpmacro.training.monitor import STAGES, Monitor


def demonstrations(truth=None):
    return Demonstrations(
        observations={"observation.image": np.zeros((4, 2, 2, 3), np.uint8)},
        actions=np.zeros(4, np.int64),
        lengths=np.array([4]),
        action_names=("stay",),
        fps=10,
        truth=truth,
        world={},
        root=Path("nowhere"),
    )


def turn(stage, rounds, total=None, labels=None, loss=1.0):
    """The reports of a stage's turn."""
    return [
        Round(stage, number, total or rounds, loss / number, 0.5, labels) for number in range(1, rounds + 1)
    ]


def logged(folder, *reports, setting="", truth=None):
    """TensorBoard's events after some reports."""
    with SummaryWriter(str(folder)) as writer:
        monitor = Monitor(writer, demonstrations(truth), 2, setting)
        for report in reports:
            monitor.on_round(report)
        monitor.close()
    return EventAccumulator(str(folder)).Reload()


def steps(events, tag):
    return [(event.step, pytest.approx(event.value)) for event in events.Scalars(tag)]


@pytest.mark.parametrize(("stage", "name"), [("fit", "macro-action 1"), ("switch", "switch function 1")])
def test_what_ends_early_is_said_in_the_log(tmp_path, capsys, stage, name):
    with SummaryWriter(str(tmp_path)) as writer:
        monitor = Monitor(writer, demonstrations(), macros=2)
        monitor.on_round(Round(stage, 1, 2, 1.0, 0.5, None))
        monitor.on_round(Round(stage, 2, 2, 1.0, 0.5, None, ended=(1,)))
        monitor.close()
    line = f"{STAGES[stage]}: {name} ends in round 2, nothing beats chance"
    assert line in capsys.readouterr().err
    events = EventAccumulator(str(tmp_path)).Reload()
    (text,) = events.Tensors(f"boosting/{stage}/text_summary")
    assert (text.step, text.tensor_proto.string_val[0].decode()) == (2, line)


def test_a_round_is_logged_with_its_segmentation(tmp_path, monkeypatch):
    clock = itertools.count(0, 3)
    monkeypatch.setattr("dpmacro.training.monitor.time.perf_counter", lambda: float(next(clock)))
    labels = torch.tensor([0, 0, 0, 1])
    events = logged(tmp_path, *turn("fit", 2, labels=labels), truth=np.array([1, 1, 0, 0]))
    assert steps(events, "loss/fit") == [(1, 1.0), (2, 0.5)]
    assert steps(events, "accuracy/fit") == [(1, 0.5), (2, 0.5)]
    told = {tag: events.Scalars(tag)[-1].value for tag in events.Tags()["scalars"]}
    assert {tag: value for tag, value in told.items() if tag.startswith("segmentation")} == {
        "segmentation/fit/mean_segment_frames": 2.0,
        "segmentation/fit/occupancy_0": 0.75,
        "segmentation/fit/occupancy_1": 0.25,
        "segmentation/fit/agreement_with_truth": 0.75,
        "segmentation/fit/label_changes": 0.0,
    }
    assert told["time/fit_seconds_per_round"] == 3.0


def test_a_setting_is_part_of_every_tag(tmp_path):
    ended = Round("discover", 1, 2, 1.0, 0.5, torch.tensor([0, 1, 1, 1]), ended=(0,))
    events = logged(tmp_path, ended, *turn("score", 2), setting="Q3_S2")
    tags = events.Tags()
    for tag in (*tags["scalars"], *tags["tensors"]):
        assert "discover_Q3_S2" in tag or "score_Q3_S2" in tag
    assert {"loss/discover_Q3_S2", "segmentation/discover_Q3_S2/occupancy_1"} <= set(tags["scalars"])
    assert steps(events, "loss/score_Q3_S2") == [(1, 1.0), (2, 0.5)]


def test_a_stage_that_is_run_again_goes_on_counting(tmp_path):
    """The turns of searching: switch functions and scores, the first scoring cut short."""
    reports = [
        *turn("recognise", 3),
        *turn("score", 2, total=5),
        *turn("recognise", 2),
        *turn("score", 3),
        *turn("score", 1),
    ]
    events = logged(tmp_path, *reports)
    assert [event.step for event in events.Scalars("loss/recognise")] == [1, 2, 3, 4, 5]
    scored = steps(events, "loss/score")
    assert scored == [(1, 1.0), (2, 0.5), (3, 1.0), (4, 0.5), (5, 1 / 3), (6, 1.0)]


@pytest.mark.parametrize("setting", ["", "Q3_S2"])
def test_every_stage_has_a_bar_that_fills(tmp_path, capsys, setting):
    for place, stage in enumerate(STAGES):
        logged(tmp_path / str(place), *turn(stage, 2, loss=0.5), setting=setting)
        bar = capsys.readouterr().err.split("\r")[-1].rstrip()
        name = f"{STAGES[stage]} Q3 S2" if setting else STAGES[stage]
        assert bar.startswith(f"{name}: 100%") and "2/2" in bar and "loss 0.2500" in bar


def test_a_stage_that_is_run_again_has_a_bar_of_its_own(tmp_path, capsys):
    logged(tmp_path, *turn("recognise", 2), *turn("score", 1, total=4), *turn("recognise", 3))
    lines = [line.split("\r")[-1].rstrip() for line in capsys.readouterr().err.split("\n")]
    bars = [line for line in lines if line]
    assert [bar.split(":")[0] for bar in bars] == [STAGES[s] for s in ("recognise", "score", "recognise")]
    assert ["2/2" in bars[0], "1/4" in bars[1], "3/3" in bars[2]] == [True] * 3


def test_a_monitor_that_heard_nothing_closes(tmp_path):
    assert logged(tmp_path).Tags()["scalars"] == []
