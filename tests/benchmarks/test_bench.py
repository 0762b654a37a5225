"""The benchmark suite: small runs as a user starts them, and peers that solve the same problem."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from dpmacro.segmentation.recursion import segment

ROOT = Path(__file__).parents[2]
BENCHMARKS = ROOT / "benchmarks"
KEYS = {"benchmark", "case", "ours", "peer_name", "peer", "ratio", "unit", "accuracy", "peer_accuracy"}


@pytest.fixture
def modules(monkeypatch):
    """Importable as the scripts import them."""
    monkeypatch.syspath_prepend(BENCHMARKS)


def bench(*options, **environment):
    return subprocess.run(
        [sys.executable, "benchmarks/bench.py", *options],
        cwd=ROOT,
        env=os.environ | environment,
        capture_output=True,
        text=True,
    )


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A tiny run where LightGBM is not installed: what was printed, and the rows."""
    folder = tmp_path_factory.mktemp("bench")
    (folder / "lightgbm.py").write_text("raise ModuleNotFoundError('no', name='lightgbm')")
    output = folder / "made" / "bench.json"
    done = bench(
        "--only=[round]",
        "--matrices=[random]",
        "--peers=[LightGBM]",
        "--learners=[drawn=512]",
        "--repeats=1",
        "--threads=1",
        "--quick=true",
        f"--output={output}",
        PYTHONPATH=os.pathsep.join([str(folder), str(ROOT)]),
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines(), json.loads(output.read_text())


@pytest.mark.benchmark
def test_rows_hold_what_was_measured(run):
    lines, rows = run
    assert {row["benchmark"] for row in rows} == {"round", "memory"}
    for row in rows:
        assert row.keys() >= KEYS
        assert row["ratio"] == pytest.approx(row["ours"] / row["peer"])
        assert any(row["case"] in line for line in lines)
    rounds = [row for row in rows if row["benchmark"] == "round"]
    assert all(0.3 < row[key] < 1 for row in rounds for key in ("accuracy", "peer_accuracy"))
    assert all(row["unit"] == "s" and 0 < row["ours"] < 10 for row in rounds)


@pytest.mark.benchmark
def test_the_header_says_where_the_numbers_come_from(run):
    lines, _ = run
    assert [line.split()[0] for line in lines[:4]] == ["commit", "machine", "versions", "command"]
    assert f"torch {torch.__version__.split('+')[0]}" in lines[2]
    assert "benchmarks/bench.py" in lines[3] and "--matrices=[random]" in lines[3]


@pytest.mark.benchmark
def test_a_peer_that_is_not_installed_is_skipped_with_the_remedy(run):
    lines, rows = run
    assert {row["peer_name"] for row in rows} == {"ours, exact"}
    assert "skipped peers.lightgbm: no module lightgbm; pip install -e '.[bench]'" in lines[-1]


@pytest.mark.parametrize(
    ("option", "message"),
    [
        ("--only=[speed]", "only has 'speed': choose from round"),
        ("--matrices=[audio]", "matrices has 'audio': choose from pixels"),
        ("--repeats=0", "repeats is 0: give 1 or more"),
    ],
)
def test_a_wrong_option_is_one_line(modules, option, message):
    import bench as script

    from dpmacro.utils import cli

    with pytest.raises(ValueError, match=message.replace("[", r"\[")):
        cli.parse(script.BenchOptions, [option])


def test_a_measurement_that_fails_says_why(modules):
    from measure import FailedError, measure

    with pytest.raises(FailedError, match=r"matrices\.planted: TypeError"):
        measure("matrices.planted", {}, 1)


def test_demonstrations_hold_out_their_last_trajectories(modules, recorded):
    from building import recorded as from_recording

    from dpmacro.data.demonstrations import Demonstrations

    demonstrations = Demonstrations.load(recorded)
    matrix = from_recording("pixels", demonstrations, 1_000_000, 50)
    last = demonstrations.trajectories[-1]
    assert matrix.features.shape == (last.start, 50) and matrix.features.dtype == np.uint8
    assert (matrix.held_actions == demonstrations.actions[last]).all()
    assert matrix.lengths.tolist() == demonstrations.lengths[:-1].tolist()
    shorter = from_recording("pixels", demonstrations, last.start - 1, 50)
    assert shorter.lengths.sum() == last.start - 1
    assert (shorter.held_actions == matrix.held_actions).all()


@pytest.mark.benchmark
@settings(max_examples=30, deadline=None)
@given(
    shape=st.tuples(st.integers(1, 3), st.integers(1, 12), st.integers(1, 4)),
    bound=st.integers(0, 5),
    seed=st.integers(0, 2**16),
)
def test_the_numba_loop_finds_our_optimum(shape, bound, seed):
    pytest.importorskip("numba")
    sys.path.insert(0, str(BENCHMARKS))
    try:
        from recursion import segment_all
    finally:
        sys.path.remove(str(BENCHMARKS))
    costs = np.random.default_rng(seed).normal(size=shape)
    labels, totals = segment_all(costs, bound)
    ours = segment(torch.from_numpy(costs).flatten(0, 1), torch.full((shape[0],), shape[1]), bound)
    assert totals == pytest.approx(ours.cost.numpy(), abs=1e-9)
    held = np.take_along_axis(costs, labels[:, :, None].astype(np.int64), 2).sum((1, 2))
    assert held == pytest.approx(totals, abs=1e-9)
    assert ((np.diff(labels) != 0).sum(1) <= bound).all()
