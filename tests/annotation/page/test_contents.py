"""The data on the page says what the stages say, frame by frame, and is never markup."""

import json

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from dpmacro.annotation.page import contents as module
from dpmacro.annotation.page.contents import as_script, contents
from dpmacro.annotation.page.shown import Curves, Shown, Truth
from tests.annotation.page.reading import labels_of, marked, numbers, some_stages


@given(
    lengths=st.lists(st.integers(1, 30), min_size=1, max_size=5),
    n_stages=st.integers(1, 6),
    seed=st.integers(0, 2**32),
    fps=st.sampled_from([0.5, 10.0, 30.0062]),
)
def test_stages_come_back_from_the_page(lengths, n_stages, seed, fps):
    names = tuple(f"stage {k}" for k in range(n_stages))
    episodes = tuple(np.random.default_rng(seed).permutation(len(lengths)).tolist())
    stages = some_stages(lengths, names, fps, seed, episodes)
    data = json.loads(as_script(contents(stages, "some", Shown())))
    assert (data["dataset"], data["fps"], tuple(data["names"])) == ("some", fps, names)
    rows = data["demonstrations"]
    assert [row["episode"] for row in rows] == list(episodes)
    assert [row["frames"] for row in rows] == lengths
    for name, read in (
        ("labels", lambda row: labels_of(row["segments"], row["frames"])),
        ("idle", lambda row: marked(row["idle"], row["frames"])),
        ("corrected", lambda row: marked(row["corrected"], row["frames"])),
    ):
        assert np.array_equal(np.concatenate([read(row) for row in rows]), getattr(stages, name)), name
    sure = np.concatenate([numbers(row["confidence"]) for row in rows]) / 255
    np.testing.assert_allclose(sure, stages.confidence, atol=0.5 / 255 + 1e-9)
    seconds = [
        np.arange(row["frames"]) / fps if row["seconds"] is None else numbers(row["seconds"], "<f4")
        for row in rows
    ]
    np.testing.assert_allclose(np.concatenate(seconds), stages.timestamps, atol=1e-3, rtol=1e-6)


def test_neighbouring_runs_differ_and_timestamps_of_the_clock_are_left_out():
    (row,) = contents(some_stages([60]), "some", Shown())["demonstrations"]
    assert row["segments"] == [[0, 0], [20, 1], [40, 2]] and row["seconds"] is None
    assert row["idle"] == [[5, 15]] and row["corrected"] == [[0, 30]]


def test_truth_and_curves_come_back():
    stages = some_stages()
    rng = np.random.default_rng(0)
    truth = Truth(rng.integers(0, 2, 150), ("before", "after"), "phase")
    values = (rng.normal(size=(150, 3)) * [1, 100, 0]).astype(np.float32)
    values[3, 0] = np.nan
    curves = (Curves(values[:, :2], ("a", "b")), Curves(values[:, 2:], ("still",)))
    data = contents(stages, "some", Shown(truth, curves, reasons=("x", "y", "z")))
    assert data["truth"] == {"column": "phase", "names": ["before", "after"]}
    assert data["reasons"] == ["x", "y", "z"] and data["curve_step"] == 1
    rows = data["demonstrations"]
    assert np.array_equal(
        np.concatenate([labels_of(row["truth"], row["frames"]) for row in rows]), truth.labels
    )
    for place, axis in enumerate(data["curves"]):
        levels = np.concatenate([numbers(row["curves"][place]) for row in rows])
        wanted, low, high = values[:, place], axis["low"], axis["high"]
        assert np.array_equal(levels == 255, np.isnan(wanted))
        read = low + levels / 254 * (high - low)
        kept = levels < 255
        np.testing.assert_allclose(read[kept], wanted[kept], atol=(high - low) / 508 + 1e-5)


def test_curves_say_how_well_they_tell_the_stages_apart():
    stages = some_stages()
    noise = np.random.default_rng(0).normal(size=150)
    values = np.column_stack([noise, stages.labels, np.full(150, np.nan), stages.labels + 0.5 * noise])
    axes = contents(stages, "some", Shown(curves=(Curves(values, tuple("abcd")),)))["curves"]
    told = [axis["explained"] for axis in axes]
    assert told[1] == pytest.approx(1) and told[0] < 0.1 and told[2] == 0 and 0.4 < told[3] < 0.9


def test_long_curves_are_thinned_and_many_are_cut(monkeypatch):
    monkeypatch.setattr(module, "CURVE_BYTES", 400)
    monkeypatch.setattr(module, "DIMENSIONS", 5)
    values = np.arange(150.0)[:, None].repeat(8, 1)
    data = contents(some_stages(), "some", Shown(curves=(Curves(values, tuple("abcdefgh")),)))
    assert [axis["name"] for axis in data["curves"]] == list("abcde") and data["curve_step"] == 2
    first = data["demonstrations"][0]["curves"]
    assert len(first) == 5 and len(numbers(first[0])) == 30
    assert sum(len(numbers(one)) for row in data["demonstrations"] for one in row["curves"]) <= 400


def test_a_demonstration_of_20_000_frames_stays_small():
    stages = some_stages([20_000])
    values = np.random.default_rng(0).normal(size=(20_000, 7))
    shown = Shown(curves=(Curves(values, tuple("abcdefg")),))
    assert len(as_script(contents(stages, "long", shown))) < 250_000


@example("</script><script>alert(1)</script>")
@example("<!--<script>")
@example("\u2028\u2029\x00\ud800 ]]> &lt;")
@given(st.text(min_size=1))
def test_no_text_is_markup(text):
    written = as_script({"names": [text]})
    assert written.isascii() and not set(written) & set("<>&\n")
    assert json.loads(written) == {"names": [text]}


def test_what_is_no_number_is_refused():
    with pytest.raises(ValueError, match="not JSON compliant"):
        as_script({"fps": float("nan")})
