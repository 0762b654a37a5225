"""What a training says while it runs."""

from pathlib import Path

import numpy as np
import pytest
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
from torch.utils.tensorboard import SummaryWriter

from dpmacro.boosting import Round
from dpmacro.demonstrations import Demonstrations
from dpmacro.monitor import STAGES, Monitor


def demonstrations():
    return Demonstrations(
        images=np.zeros((4, 2, 2, 3), np.uint8),
        actions=np.zeros(4, np.int64),
        lengths=np.array([4]),
        action_names=("stay",),
        fps=10,
        truth=None,
        world={},
        root=Path("nowhere"),
    )


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
