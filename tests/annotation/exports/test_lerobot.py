"""LeRobot's own dataset class and its tools for datasets on what was written; validators of others."""

import numpy as np
import pytest

from dpmacro.annotation.exports.dataset import write_labels
from dpmacro.annotation.exports.formats import default_formats
from dpmacro.annotation.exports.labelling import read_labels

OURS = {"macro_action": "int64", "confidence": "float32", "idle": "bool", "corrected": "bool"}
FORMATS = (*default_formats(), "sarm", "rabc", "mimicgen")
BEFORE_06 = "subtask_index" in default_formats()


@pytest.fixture(scope="module")
def written(stored, stages, tmp_path_factory):
    root = tmp_path_factory.mktemp("lerobot") / "out"
    write_labels(stored, root, stages, FORMATS)
    return root


@pytest.fixture(scope="module")
def dataset(written):
    return opened(written)


def opened(root):
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    return LeRobotDataset("test/labels", root=root)


def labels_of(dataset):
    return np.array([int(label) for label in dataset.hf_dataset["macro_action"]])


def test_every_frame_has_its_labels(dataset, stages):
    for name, kind in OURS.items():
        assert dataset.features[name]["dtype"] == kind
    for index in range(len(dataset)):
        item = dataset[index]
        assert item["macro_action"].item() == stages.labels[index]
        assert item["confidence"].item() == pytest.approx(stages.confidence[index])
        assert item["idle"].item() == stages.idle[index]
        assert item["corrected"].item() == stages.corrected[index]
        assert item["observation.images.front"].shape == (3, 48, 64)


@pytest.mark.skipif(not BEFORE_06, reason="LeRobot reads no subtask_index from 0.6 on")
def test_every_frame_has_its_subtask(dataset, stages):
    for index in range(len(dataset)):
        assert dataset[index]["subtask"] == stages.names[stages.labels[index]]


def test_policies_see_what_they_saw(stored, dataset):
    """No new column may become a policy's input or output."""
    try:
        from lerobot.utils.feature_utils import dataset_to_policy_features
    except ImportError:
        from lerobot.datasets.utils import dataset_to_policy_features

    before = dataset_to_policy_features(opened(stored).features)
    assert dataset_to_policy_features(dataset.features) == before


def test_episodes_can_be_deleted(dataset, stages, tmp_path):
    from lerobot.datasets.dataset_tools import delete_episodes

    fewer = delete_episodes(dataset, [1], output_dir=tmp_path / "fewer", repo_id="test/fewer")
    kept = stages.of_episodes((0, 2, 3))
    assert np.array_equal(labels_of(fewer), kept.labels)
    mean = fewer.meta.stats["macro_action"]["mean"]
    assert mean == pytest.approx(kept.labels.mean())
    found = read_labels(tmp_path / "fewer", stages.names)  # LeRobot leaves the names out
    assert np.array_equal(found.labels, kept.labels) and np.array_equal(found.idle, kept.idle)
    assert np.array_equal(found.corrected, kept.corrected)
    write_labels(tmp_path / "fewer", tmp_path / "again", found, FORMATS)
    assert np.array_equal(labels_of(opened(tmp_path / "again")), kept.labels)


def test_datasets_can_be_split_and_merged(dataset, stages, tmp_path):
    from lerobot.datasets.dataset_tools import merge_datasets, split_dataset

    parts = split_dataset(dataset, {"train": 0.5, "val": 0.5}, output_dir=tmp_path / "parts")
    assert np.array_equal(labels_of(parts["val"]), stages.of_episodes((2, 3)).labels)
    merged = merge_datasets(
        [parts["train"], parts["val"]], output_repo_id="test/merged", output_dir=tmp_path / "merged"
    )
    assert np.array_equal(labels_of(merged), stages.labels)
    assert merged.meta.stats["confidence"]["mean"] == pytest.approx(stages.confidence.mean())
    assert merged.meta.stats["macro_action"]["max"] == 2
    found = read_labels(tmp_path / "merged", stages.names)
    assert np.allclose(found.confidence, stages.confidence)


def test_hugging_faces_datasets_reads_it_alone(written, stages, tmp_path):
    import datasets

    files = [str(path) for path in sorted((written / "data").rglob("*.parquet"))]
    found = datasets.load_dataset("parquet", data_files=files, cache_dir=str(tmp_path))["train"]
    assert found["macro_action"][:] == stages.labels.tolist()
    assert found.features["observation.images.front"] == datasets.Image()


# Validators that others made.


def doctor(root):
    pytest.importorskip("lerobot_doctor", reason="pip install -e '.[dev]' brings it")
    from lerobot_doctor.dataset_loader import load_local
    from lerobot_doctor.runner import Severity, run_checks

    report = run_checks(load_local(root))
    assert {result.name for result in report.results} >= {
        "Metadata & Format Compliance",
        "Training Readiness",
    }
    return {
        (result.name, message.severity, message.message)
        for result in report.results
        for message in result.messages
        if message.severity != Severity.PASS
    }


def lint(root):
    pytest.importorskip("lerobot_lint", reason="pip install -e '.[dev]' brings it")
    from lerobot_lint.config import load_profile
    from lerobot_lint.engine import check_dataset

    findings = check_dataset(str(root), load_profile("default"))
    assert findings and not [one for one in findings if one.check == "EPISODE_LOAD_ERROR"]
    return {str(finding) for finding in findings}


def test_lerobot_doctor_finds_nothing_new(stored, written):
    new = {message for _, _, message in doctor(written) - doctor(stored)}
    # It takes language for numbers; LeRobot itself writes no statistics of language.
    expected = "Features in data but not in stats.json: ['language_events', 'language_persistent']"
    assert new == (set() if BEFORE_06 else {expected})


def test_lerobot_lint_finds_nothing_new(stored, written):
    assert lint(written) == lint(stored)
