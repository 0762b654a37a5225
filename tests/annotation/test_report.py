"""The files of a report, read back."""

import json
from dataclasses import replace

import matplotlib.image
import numpy as np
import pytest
from segmented import FRONT, STATE, TOP, some_summary
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from dpmacro.annotation.pictures import pictures
from dpmacro.annotation.report import score_text, stages_of, write_report
from dpmacro.annotation.summary import SCORES
from dpmacro.policy.config import InputConfig
from tests.annotation.page.reading import data_of, labels_of
from tests.annotation.test_html import Reader

NAMES = {"segmentation", "transitions", "elbow", "pixels"}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("report")
    summary = some_summary()
    write_report(summary, pictures(summary, 2), folder)
    return folder


def test_the_page_shows_every_score_and_the_pictures_that_strips_do_not_replace(folder):
    document = (folder / "segmentation.html").read_text(encoding="utf-8")
    reader = Reader(document)
    text = "".join(reader.texts)
    assert "Stages of noise & more" in text and "runs/<one>" in text
    assert all(name in text for name in SCORES.values())
    assert "turn <left>" in text or "forward" in text or "turn right" in text
    images = reader.of("img")
    assert len(images) == 3 and all(image["alt"] for image in images)
    assert all(image["src"].startswith("data:image/png;base64,") for image in images)
    headings = [tag for tag, _ in reader.elements].count("h3")
    assert headings == 5  # scores, macro-actions, three kinds of pictures


def test_the_page_holds_the_segmentation_truth_and_images(folder):
    summary, data = some_summary(), data_of((folder / "segmentation.html").read_text(encoding="utf-8"))
    rows = data["demonstrations"]
    assert [row["episode"] for row in rows] == [4, 7, 5] and data["dataset"] == "noise & more"
    labels, truth = (
        np.concatenate([labels_of(row[name], row["frames"]) for row in rows])
        for name in ("segments", "truth")
    )
    assert np.array_equal(labels, summary.labels)
    assert np.array_equal(truth, summary.demonstrations.truth)
    assert data["names"] == ["macro-action 0", "macro-action 1", "macro-action 2"]
    assert data["truth"] == {"column": "phase", "names": ["before", "after"]}
    assert data["cameras"] == ["image"] and data["curves"] == []
    assert [len(row["sheets"][0][0]["frames"]) for row in rows] == [12, 7, 9]


def test_other_stages_and_fewer_pictures_can_be_given(tmp_path):
    summary = some_summary(keys=(STATE, FRONT), vector=True)
    names = ("reach", "grasp", "carry")
    stages = replace(stages_of(summary), names=names, corrected=np.ones(28, bool))
    write_report(summary, iter([]), tmp_path, stages, frames=2, reasons=("x", "y", "z"))
    data = data_of((tmp_path / "segmentation.html").read_text(encoding="utf-8"))
    assert tuple(data["names"]) == names and data["reasons"] == ["x", "y", "z"]
    assert [row["corrected"] for row in data["demonstrations"]] == [[[0, 12]], [[0, 7]], [[0, 9]]]
    assert [len(row["sheets"][0][0]["frames"]) for row in data["demonstrations"]] == [2, 2, 2]
    assert [axis["name"] for axis in data["curves"]] == [
        *("dx", "dy", "gripper", "never moves"),
        *(f"state {name}" for name in ("shoulder", "elbow", "wrist", "gripper.pos")),
    ]
    (found,) = {row["seconds"] for row in data["demonstrations"]}
    assert found is None and data["fps"] == 30


def test_pictures_numbers_and_events(folder):
    names = {path.stem for path in (folder / "figures").iterdir()}
    assert names == {*NAMES, "demonstration_004", "demonstration_007"}
    for path in (folder / "figures").iterdir():
        assert matplotlib.image.imread(path).std() > 0.05
    numbers = json.loads((folder / "segmentation.json").read_text())
    assert numbers["scores"]["policy"]["accuracy"] == 1 and numbers["policy"] == "runs/<one>"
    assert numbers["demonstrations"][0]["segments"] == [[2, 0, 6], [0, 6, 12]]
    events = EventAccumulator(str(folder / "tensorboard")).Reload()
    assert {f"figures/{name}" for name in names} == set(events.Tags()["images"])
    assert events.Scalars("segmentation/accuracy")[0].value == 1
    assert events.Scalars("segmentation/random_cuts/accuracy")[0].value < 1
    assert len(events.Tags()["scalars"]) == 3 * len(SCORES)
    assert not list(folder.rglob(".*")), "no temporary file stays"


def test_without_truth_or_stumps_the_page_says_so(tmp_path, monkeypatch):
    monkeypatch.setattr("dpmacro.annotation.report.importances", lambda policy: None)
    summary = some_summary(truth=False)
    write_report(summary, iter([]), tmp_path)
    text = "".join(Reader((tmp_path / "segmentation.html").read_text()).texts)
    assert "no column of true labels" in text and "no map of chosen pixels" in text


def text_of(folder, summary):
    write_report(summary, iter([]), folder)
    return "".join(Reader((folder / "segmentation.html").read_text()).texts)


def test_the_page_of_vectors_tells_what_tells_most(tmp_path):
    text = text_of(tmp_path, some_summary(keys=(STATE,), vector=True))
    assert "gripper low, -0.9 sd" in text and "gripper high, +1.1 sd" in text and "usual action" not in text
    assert "actions4 numbers: dx, dy, gripper, never moves" in text.replace("\n", "")
    assert "inputsobservation.state" in text and "cameras" not in text
    assert "no map of chosen pixels" not in text


def test_the_page_lists_cameras_actions_and_order(tmp_path):
    summary = some_summary(keys=(FRONT, TOP))
    config = summary.policy.config
    shrunk = {**config.inputs, TOP: InputConfig((10, 8, 3), (480, 640))}
    names = tuple(f"joint_{k}" for k in range(15))
    changed = replace(config, inputs=shrunk, order="chain", action_names=names)
    summary = replace(summary, policy=replace(summary.policy, config=changed))
    text = text_of(tmp_path, summary)
    assert "inputsobservation.images.front, observation.images.top" in text
    assert "camerasfront 16x12, top 8x10, shrunk from 640x480" in text
    assert "orderchain" in text and "actions15 classes: joint_0, " in text and "joint_11 and 3 more" in text
    assert "orderfree" in text_of(tmp_path / "free", some_summary())


def test_scores_stand_in_columns():
    lines = score_text(some_summary()).splitlines()
    assert lines[0].split("   ")[-1].strip() == "random cuts" and len({len(line) for line in lines}) == 1
    assert lines[1].startswith("frames that agree") and lines[1].split()[3] == "1.000"
    assert lines[-1].split() == ["true", "segments", "6", "6", "6"]


def test_a_picture_that_fails_is_a_line_and_the_report_is_whole(tmp_path, monkeypatch):
    def fails(*given):
        raise RuntimeError("no fonts")

    summary = some_summary()
    monkeypatch.setattr("dpmacro.figures.elbow", fails)
    with pytest.warns(UserWarning, match="the picture number . could not be made .*no fonts"):
        write_report(summary, pictures(summary, 0), tmp_path)
    assert {path.stem for path in (tmp_path / "figures").iterdir()} == NAMES - {"elbow"}
    monkeypatch.setattr("dpmacro.figures.to_image", fails)
    with pytest.warns(UserWarning, match="the picture segmentation could not be made"):
        write_report(summary, pictures(summary, 0), tmp_path / "again")
    assert (tmp_path / "again/segmentation.json").exists()


def test_what_says_that_a_report_is_complete_is_written_last(tmp_path, monkeypatch):
    def killed(*given):
        assert not (tmp_path / "segmentation.json").exists()
        raise KeyboardInterrupt

    summary = some_summary()
    monkeypatch.setattr("dpmacro.annotation.report.write_page", killed)
    with pytest.raises(KeyboardInterrupt):
        write_report(summary, iter(()), tmp_path)
    assert not (tmp_path / "segmentation.json").exists()
