"""What a finished training shows, for actions that are vectors and for inputs without a camera."""

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.figure import Figure
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
from torch.utils.tensorboard import SummaryWriter

from dpmacro import figures
from dpmacro.training.pictures import TrainingPictures
from tests.annotation.test_annotate import LENGTHS, train, vectors_with_a_rule

CAMERAS = ("observation.images.front", "observation.images.top")


@pytest.mark.parametrize(("cameras", "order"), [((), "free"), (CAMERAS[:1], "free"), (CAMERAS, "chain")])
def test_a_training_on_vectors_shows_pictures_and_says_what_accuracy_is(
    cameras, order, tmp_path, monkeypatch
):
    shown = {}
    monkeypatch.setattr(figures, "save", lambda figure, path: shown.update({path.stem: figure}))
    rng = np.random.default_rng(0)
    seen = {camera: rng.integers(0, 256, (LENGTHS.sum(), 6, 8, 3), np.uint8) for camera in cameras}
    demonstrations = vectors_with_a_rule()
    demonstrations = replace(demonstrations, observations={**demonstrations.observations, **seen})
    given = {"rounds": 5, "restarts": 2, "switch_rounds": 2, "switch_weight": 0.0, "order": order}
    policy, found = train(demonstrations, **given)
    with SummaryWriter(str(tmp_path)) as writer:
        TrainingPictures(writer, tmp_path).show(demonstrations, policy, found)
    assert {"timeline", "objective", "segmentation", "transitions", "columns"} <= set(shown)
    assert ("elbow" in shown) == (order == "free")
    maps = {"pixels"} if len(cameras) == 1 else {"pixels_front", "pixels_top"}
    assert {name for name in shown if name.startswith("pixels")} <= (maps if cameras else set())
    rows = [axis.get_ylabel() for axis in shown["timeline"].axes]
    names = {0: [], 1: ["seen"], 2: ["front", "top"]}[len(cameras)]
    assert rows == [*names, "true class", "macro-action", "gripper", "dx"]
    events = EventAccumulator(str(tmp_path)).Reload()
    assert {f"figures/{name}" for name in shown} == set(events.Tags()["images"])
    (text,) = events.Tensors("accuracy/text_summary")
    assert b"share of their variance that is explained" in text.tensor_proto.string_val[0]


class Unwritten(Figure):
    """A picture that cannot be saved."""

    def savefig(self, *given, **options):
        raise RuntimeError("no place")


def test_a_picture_that_fails_is_a_line_and_the_others_are_made(tmp_path, monkeypatch):
    def fails(*given):
        raise RuntimeError("no fonts")

    monkeypatch.setattr(figures, "timelines", fails)
    policy, found = train(vectors_with_a_rule(), rounds=5, restarts=2, switch_rounds=2, switch_weight=0.0)
    with SummaryWriter(str(tmp_path)) as writer:
        with pytest.warns(
            UserWarning, match=r"the picture segmentation could not .*no fonts.*; nothing else depends on it"
        ):
            TrainingPictures(writer, tmp_path).show(vectors_with_a_rule(), policy, found)
        with pytest.warns(UserWarning, match="the picture selection could not"):
            TrainingPictures(writer, tmp_path).add("selection", Unwritten())
    names = {path.stem for path in tmp_path.glob("*.png")}
    assert {"timeline", "objective", "transitions"} <= names and "segmentation" not in names
