"""The segmentation table: every peer solves what it is made for; a run is written, resumed and printed."""

import json
import os
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[2]
SCRIPT = ROOT / "benchmarks/bench_segmentation.py"
sys.path.insert(0, str(SCRIPT.parent))  # as the script itself finds its neighbours

from bench_segmentation import BenchOptions, dpmacro, main, table  # noqa: E402
from segmentation_grid import Setting, sliding_means  # noqa: E402
from segmentation_peers import PEERS, _starts  # noqa: E402
from segmentation_sources import Source, from_dataset  # noqa: E402

from dpmacro.metrics import segmentation_scores, transitions  # noqa: E402
from dpmacro.utils import cli  # noqa: E402


def planted(kind):
    """Six trajectories of three segments and two macro-actions, told apart by one thing alone.

    "means": where the features are. "dynamics": how they follow the ones before. "rule": how the action
    follows from the first feature.
    """
    rng = np.random.default_rng(0)
    lengths = np.arange(90, 120, 5)
    truth = [
        np.repeat([k % 2, 1 - k % 2, k % 2], (n // 3, n // 3, n - 2 * (n // 3)))
        for k, n in enumerate(lengths)
    ]
    noise = [rng.normal(size=(n, 5)) for n in lengths]
    if kind == "dynamics":
        for values, labels in zip(noise, truth, strict=True):
            for now in range(1, len(values)):
                values[now] += (0.9 if labels[now] else -0.9) * values[now - 1]
    frames, labels = np.concatenate(noise), np.concatenate(truth)
    actions = rng.integers(0, 3, len(frames))
    if kind == "means":
        frames[:, :2] += 3 * labels[:, None]
    if kind == "rule":
        actions = (frames[:, 0] > 0) ^ labels
    return Source("babyai", kind, frames.astype(np.float32), actions.astype(np.int64), lengths, labels)


def scores(source, labels):
    return segmentation_scores(labels, source.truth, source.lengths, 3)


@pytest.mark.benchmark
@pytest.mark.parametrize(
    ("method", "kind"),
    [
        ("GaussianHMM", "means"),
        ("AR-HMM", "dynamics"),
        ("regression HMM", "rule"),
        ("KernelCPD", "means"),
        ("k-means", "means"),
    ],
)
def test_a_peer_finds_what_it_is_made_for(method, kind):
    modules = {"GaussianHMM": "hmmlearn", "KernelCPD": "ruptures", "k-means": "sklearn"}
    pytest.importorskip(modules.get(method, "dynamax"))
    source = planted(kind)
    found = PEERS[method](source, 0, True)
    assert scores(source, found.labels).accuracy > 0.95, found.setting
    assert found.setting


@pytest.mark.benchmark
def test_padding_has_no_say_in_a_hidden_markov_model():
    pytest.importorskip("dynamax")
    import jax
    from segmentation_dynamax import _autoregressive_model, _linear_model, _padded, _regression_model

    source = planted("rule")
    n, columns = source.frames.shape
    observed = _padded(np.ones(n), source.lengths) > 0
    values, actions = (
        _padded(source.frames.astype(float), source.lengths),
        _padded(source.actions, source.lengths),
    )
    held = _padded(np.eye(2)[source.truth], source.lengths)[None]
    sticky = np.array([[0.97, 0.03], [0.03, 0.97]])
    assert not observed.all()
    for fit, emissions in (
        (_autoregressive_model(2, columns, 3), values),
        (_autoregressive_model(2, columns, 3, 0.1), values),
        (_linear_model(2, columns, columns, 3, 0.1), values[:, :, ::-1]),
        (_regression_model(2, 2, columns, 3), actions),
    ):
        inputs = np.dstack([np.roll(values, 1, axis=1), observed])
        with jax.enable_x64(True):
            clean = fit(held, emissions, inputs, sticky)
            emissions, inputs = emissions.copy(), inputs.copy()
            emissions[~observed], inputs[~observed, :-1] = 1, 5
            dirty = fit(held, emissions, inputs, sticky)
        assert np.isfinite(clean[1]).all() and np.allclose(clean[1], dirty[1])
        assert (np.asarray(clean[0] == dirty[0])[:, observed]).all()


@pytest.mark.parametrize("method", ["uniform cuts", "random cuts"])
def test_chance_has_the_true_labels_in_order(method):
    source = planted("means")
    found = PEERS[method](source, 3, False).labels
    assert scores(source, found).edit == 1
    assert (found == PEERS[method](source, 3, False).labels).all()


@pytest.mark.benchmark
def test_ours_runs_on_numbers_and_on_images():
    source = planted("means")
    assert scores(source, dpmacro(source, 0, True).labels).segments >= len(source.lengths)
    images = np.random.default_rng(1).integers(0, 256, (40, 8, 10, 3)).astype(np.uint8)
    images[10:20] //= 8
    images[30:] //= 8
    dark = np.repeat([0, 1, 0, 1], 10)
    found = dpmacro(Source("babyai", "dark", images, dark, np.array([20, 20]), dark), 0, True)
    assert found.setting == "Q=2, S=1"
    assert all(len(points) <= 1 for points in transitions(found.labels, np.array([20, 20])))


def test_starts_have_every_label_and_the_true_number_of_segments():
    source = planted("means")
    for start in _starts(source, source.frames, 0, False):
        assert set(start) == {0, 1} and start.dtype == np.int64
    changes = [
        len(points) for points in transitions(_starts(source, source.frames, 0, True)[0], source.lengths)
    ]
    assert np.abs(np.array(changes) - source.changes).sum() <= 2 * source.macros  # two frames are forced


def test_a_matrix_shares_its_variance_as_asked():
    source = planted("means")
    values = Setting(4, 0.25).matrix(source, 0)
    assert values.shape[1] == 4 + 3
    assert [values[:, :4].var(0).sum(), values[:, 4:].var(0).sum()] == pytest.approx([0.75, 0.25])
    assert Setting(0, 1.0).matrix(source, 0).shape[1] == 3


def test_sliding_means_stay_in_their_trajectory():
    values = np.array([[0.0], [1], [2], [10], [20]])
    means = sliding_means(values, [slice(0, 3), slice(3, 5)], 3)
    assert means[:, 0].tolist() == [0.5, 1, 1.5, 15, 15]


def test_components_of_images_know_the_change(recorded):
    source = from_dataset("two_flags", recorded)
    assert source.case == "two_flags phase" and source.macros == 2
    image, change = source.components
    for block in (image, change):
        assert block.var(0) == pytest.approx(np.ones(block.shape[1]), rel=0.1)
    firsts = np.cumsum(source.lengths) - source.lengths
    assert np.ptp(change[firsts], axis=0).max() == pytest.approx(0, abs=1e-3)  # no image before the first


def bench(*options, **environment):
    return subprocess.run(
        [sys.executable, str(SCRIPT), *options],
        cwd=ROOT,
        env=os.environ | environment,
        capture_output=True,
        text=True,
    )


@pytest.mark.benchmark
def test_a_run_is_written_and_a_missing_peer_skipped(tmp_path):
    (tmp_path / "ruptures.py").write_text("raise ModuleNotFoundError('no', name='ruptures')")
    done = bench(
        "--sources=[digits]",
        "--methods=[KernelCPD, uniform cuts, random cuts]",
        "--seeds=[0, 1]",
        "--quick=true",
        f"--output={tmp_path}/made/rows.json",
        PYTHONPATH=os.pathsep.join([str(tmp_path), str(ROOT)]),
    )
    assert done.returncode == 0, done.stderr
    assert "skipped KernelCPD: no module ruptures; pip install -e '.[bench]'" in done.stdout
    rows = json.loads((tmp_path / "made/rows_quick.json").read_text())
    assert {(row["method"], row["seed"]) for row in rows} == {
        (method, seed) for method in ("uniform cuts", "random cuts") for seed in (0, 1)
    }
    found = [row["value"] for row in rows if row["method"] == "uniform cuts" and row["metric"] == "accuracy"]
    assert re.search(rf"^uniform cuts +2 +{np.mean(found):.3f} ", done.stdout, re.MULTILINE)


def test_rows_that_are_there_are_not_found_anew(tmp_path, capsys):
    shared = {
        "sources": ["digits"],
        "methods": ["uniform cuts"],
        "seeds": [0],
        "output": tmp_path / "rows.json",
    }

    def accuracies(**options):
        main(BenchOptions(quick=True, **shared | options))
        found = re.findall(r"^uniform cuts +(\d+) +(\d\.\d{3}) ", capsys.readouterr().out, re.MULTILINE)
        return [(int(n), float(value)) for n, value in found]

    [(_, truly)] = accuracies()
    written = tmp_path / "rows_quick.json"
    written.write_text(json.dumps([row | {"value": 0.125} for row in json.loads(written.read_text())]))
    assert accuracies() == [(1, 0.125)] != [(1, truly)]
    assert accuracies(seeds=[1]) != [(1, 0.125)]
    assert len({row["seed"] for row in json.loads(written.read_text())}) == 2
    assert accuracies(fresh=True) == [(1, truly)]


def test_rows_of_other_data_do_not_count():
    source = planted("means")
    assert source.digest == planted("means").digest
    for name in ("frames", "actions", "lengths", "truth"):
        changed = getattr(source, name).copy()
        changed.flat[-1] += 1
        assert replace(source, **{name: changed}).digest != source.digest, name


def test_the_table_is_a_mean_over_seeds():
    shared = {"source": "digits", "case": "Q=2", "method": "k-means"}
    rows = [
        shared | {"seed": seed, "metric": metric, "value": value}
        for seed, value in ((0, 0.25), (1, 0.75))
        for metric in ("accuracy", "true_segments")
    ]
    rows += [shared | {"metric": name, "value": 1} for name in ("precision", "recall", "boundary_f1", "edit")]
    rows += [
        shared | {"metric": name, "value": 1}
        for name in ("f1_10", "f1_25", "f1_50", "nmi", "ari", "segments")
    ]
    lines = table(rows)
    assert lines[1] == "digits Q=2: 0.5 true segments, tolerance 3"
    assert lines[3].split()[:3] == ["k-means", "2", "0.500"]


@pytest.mark.parametrize(
    ("option", "message"),
    [
        ("--sources=[chess]", "sources has 'chess': choose from digits"),
        ("--methods=[HMM]", "methods has 'HMM': choose from dpmacro"),
        ("--seeds=[-1]", "seeds has -1: give 0 or more"),
    ],
)
def test_a_wrong_option_is_one_line(option, message):
    with pytest.raises(ValueError, match=message):
        cli.parse(BenchOptions, [option])


@pytest.mark.parametrize("source", ["two_flags", "babyai"])
def test_data_that_are_not_there_are_one_line(tmp_path, source):
    options = BenchOptions(sources=["digits", source], two_flags=tmp_path / "none", babyai=tmp_path / "none")
    with pytest.raises(
        ValueError, match=rf"^{source} is not in .*/none: `make bench-segmentation` records it$"
    ):
        main(options)


def test_a_file_of_other_rows_is_one_line(tmp_path):
    other = tmp_path / "other.json"
    other.write_text('[{"benchmark": "round"}]')
    done = bench("--sources=[digits]", "--methods=[uniform cuts]", f"--output={other}")
    assert done.returncode == 2
    assert done.stderr == f"error: {other} holds no rows of this benchmark: give another --output\n"
    assert json.loads(other.read_text()) == [{"benchmark": "round"}]


def test_the_makefile_records_every_level():
    levels = pytest.importorskip("dpmacro.worlds.babyai").LEVELS
    line = re.search(r"^LEVELS := .*$", (ROOT / "Makefile").read_text(), re.MULTILINE)[0]
    assert {f"BabyAI-{name}" for name in re.findall(r"\w+-v0", line)} == set(levels)
