"""SARM's columns and RA-BC's progress, and what LeRobot's own code makes of them."""

import importlib
import json
import sys
import types
from dataclasses import replace

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
import torch

from dpmacro.annotation.exports.dataset import write_labels
from dpmacro.annotation.exports.formats import default_formats

HEADS = ("sparse", "dense")
BEFORE_06 = "subtask_index" in default_formats()
MODELS = {"transformers": ("CLIPModel", "CLIPProcessor"), "faker": ("Faker",)}
FIELDS = ("names", "start_times", "end_times", "start_frames", "end_frames")


def lerobots(*names):
    """The first of these modules that the installed LeRobot has."""
    found = [name for name in names if _is_there(name)]
    assert found, f"LeRobot has none of {names}"
    return importlib.import_module(found[0])


def _is_there(name):
    try:
        return importlib.util.find_spec(name) is not None
    except ModuleNotFoundError:
        return False


def episodes_of(root):
    files = sorted((root / "meta/episodes").rglob("*.parquet"))
    return pd.concat([pd.read_parquet(path) for path in files], ignore_index=True)


@pytest.fixture(scope="module")
def written(stored, stages, tmp_path_factory):
    root = tmp_path_factory.mktemp("sarm") / "out"
    write_labels(stored, root, stages, ["sarm", "rabc"])
    return root


def test_the_last_frame_of_a_stage_is_included(written, stages):
    rows = episodes_of(written)
    for place, (part, segments) in enumerate(zip(stages.trajectories, stages.segments, strict=True)):
        for head in HEADS:
            names, *others = (rows.loc[place, f"{head}_subtask_{field}"] for field in FIELDS)
            start_times, end_times, starts, ends = (list(one) for one in others)
            assert list(names) == list(stages.names)
            assert starts == [start for _, start, _ in segments]
            assert ends == [end - 1 for _, _, end in segments]
            seconds = stages.timestamps[part]
            assert start_times == seconds[starts].tolist() and end_times == seconds[ends].tolist()


def test_shares_are_means_over_demonstrations_in_the_stages_order(written, stages):
    shares = json.loads((written / "meta/temporal_proportions_dense.json").read_text())
    assert shares == json.loads((written / "meta/temporal_proportions_sparse.json").read_text())
    assert tuple(shares) == stages.names and sum(shares.values()) == pytest.approx(1)
    assert shares["reach"] == pytest.approx(np.mean([4 / 12, 2 / 7, 3 / 5, 2 / 9]))


def test_lerobots_sarm_finds_stage_and_progress_at_every_frame(written, stages):
    sarm = lerobots("lerobot.rewards.sarm.sarm_utils", "lerobot.policies.sarm.sarm_utils")
    rows = episodes_of(written)
    shares = json.loads((written / "meta/temporal_proportions_dense.json").read_text())
    table = pq.read_table(written / "sarm_progress.parquet")
    progress = table["progress_dense"].to_numpy()
    assert table["index"].to_pylist() == list(range(len(stages.labels)))
    assert np.array_equal(progress, table["progress_sparse"].to_numpy())
    for place, (part, segments) in enumerate(zip(stages.trajectories, stages.segments, strict=True)):
        ends = {end - 1 for _, _, end in segments}
        starts = {start for _, start, _ in segments}
        for frame in range(part.stop - part.start):
            arguments = (
                frame,
                part.stop - part.start,
                *(
                    rows.loc[place, f"dense_subtask_{field}"]
                    for field in ("names", "start_frames", "end_frames")
                ),
                list(stages.names),
                shares,
            )
            stage, within = sarm.find_stage_and_tau(*arguments)
            assert stage == stages.labels[part.start + frame]
            if frame in ends:
                assert within == 1
            elif frame in starts:
                assert within == 0
            combined = sarm.find_stage_and_tau(*arguments, return_combined=True)
            done = sarm.normalize_stage_tau(
                combined, temporal_proportions=shares, subtask_names=list(stages.names)
            )
            assert progress[part.start + frame] == pytest.approx(done, abs=1e-3)
        assert progress[part.stop - 1] == pytest.approx(1)
        assert (np.diff(progress[part]) >= 0).all()


def test_lerobots_sarm_reads_the_dataset(written, stages, monkeypatch):
    """SARM's own step of processing, without the models of language and images beside it."""
    with monkeypatch.context() as patched:
        if BEFORE_06:  # its module asks for them when it is imported
            for name, attributes in MODELS.items():
                patched.setitem(sys.modules, name, types.SimpleNamespace(**dict.fromkeys(attributes)))
            patched.delitem(sys.modules, "lerobot.policies.sarm.processor_sarm", raising=False)
        module = lerobots("lerobot.rewards.sarm.processor_sarm", "lerobot.policies.sarm.processor_sarm")
    sys.modules.pop("lerobot.policies.sarm.processor_sarm", None)
    from lerobot.datasets.lerobot_dataset import LeRobotDatasetMetadata

    step = object.__new__(module.SARMEncodingProcessorStep)
    step.dataset_meta = LeRobotDatasetMetadata("test/sarm", root=written)
    shares = json.loads((written / "meta/temporal_proportions_dense.json").read_text())
    step.dense_subtask_names, step.dense_temporal_proportions = list(shares), shares
    step.sparse_subtask_names, step.sparse_temporal_proportions = list(shares), shares
    step.config = types.SimpleNamespace(n_obs_steps=2, max_rewind_steps=1, frame_gap=1)
    if hasattr(step, "_validate_annotation_columns"):
        step._validate_annotation_columns()
    rows = step.dataset_meta.episodes.to_pandas()
    frames = np.arange(len(stages.labels))
    episodes = np.repeat(np.arange(4), stages.lengths)
    none = torch.zeros(len(frames), dtype=torch.int64)
    for head in HEADS:
        targets = step._compute_batch_targets(frames, episodes, none, none, rows, head).numpy()
        now = targets[:, 1]  # a frame before, now, a frame after
        table = pq.read_table(written / "sarm_progress.parquet")
        whole = lerobots("lerobot.rewards.sarm.sarm_utils", "lerobot.policies.sarm.sarm_utils")
        done = [whole.normalize_stage_tau(float(x), temporal_proportions=shares) for x in now]
        assert np.allclose(done, table[f"progress_{head}"].to_numpy(), atol=1e-3)


def test_lerobots_weights_for_samples(written, stages):
    module = lerobots("lerobot.rewards.sarm.rabc", "lerobot.utils.rabc")
    for head in HEADS:
        weights = module.RABCWeights(written / "sarm_progress.parquet", chunk_size=3, head_mode=head)
        assert len(weights.progress_lookup) == len(stages.labels)
        of_frames, _ = weights.compute_batch_weights({"index": np.arange(len(stages.labels))})
        last = [part.stop - 1 for part in stages.trajectories]
        moving = np.setdiff1d(np.arange(len(stages.labels)), last)
        assert (of_frames.numpy()[moving] >= 1).all()  # all of them get on
        assert weights._compute_delta(0) == pytest.approx(
            weights.progress_lookup[3] - weights.progress_lookup[0]
        )
        assert weights._compute_delta(11) == 0  # the episode's last frame


def test_lerobot_train_finds_the_weights_beside_the_data(written):
    pytest.importorskip("lerobot.utils.sample_weighting", reason="LeRobot before 0.6 has another option")
    from lerobot.utils.sample_weighting import SampleWeightingConfig, make_sample_weighter

    policy = types.SimpleNamespace(config=types.SimpleNamespace(chunk_size=3))
    config = SampleWeightingConfig(type="rabc")
    weighter = make_sample_weighter(config, policy, torch.device("cpu"), dataset_root=str(written))
    assert weighter.get_stats()["num_frames"] == 33


def test_progress_of_stages_of_one_frame(stored, stages, tmp_path):
    labels = np.concatenate([np.minimum(np.arange(length), 2) for length in stages.lengths])
    write_labels(stored, tmp_path / "out", replace(stages, labels=labels), ["sarm", "rabc"])
    progress = pq.read_table(tmp_path / "out/sarm_progress.parquet")["progress_sparse"].to_numpy()
    shares = [np.mean([1 / length for length in stages.lengths])] * 2
    assert progress[:3] == pytest.approx([shares[0], sum(shares), sum(shares)])
    assert progress[11] == pytest.approx(1)


def test_one_stage_is_progress_from_0_to_1(stored, stages, tmp_path):
    one = replace(stages, labels=np.zeros(33, np.int64), names=("all of it",))
    write_labels(stored, tmp_path / "out", one, ["sarm", "rabc"])
    progress = pq.read_table(tmp_path / "out/sarm_progress.parquet")["progress_sparse"].to_numpy()
    assert progress[:12] == pytest.approx(np.linspace(0, 1, 12))


def test_other_stages_elsewhere(stored, stages, tmp_path):
    labels = np.where(np.arange(33) >= 24, 2 - stages.labels, stages.labels)
    turned = replace(stages, labels=labels)
    message = (
        r"episode 0 has reach, carry it, leave and episode 3 leave, carry it, reach, and it needs the same"
    )
    for name in ("sarm", "rabc", "mimicgen"):
        with pytest.raises(ValueError, match=f"^{name}: cannot be written, {message}"):
            write_labels(stored, tmp_path / "out", turned, [name])
