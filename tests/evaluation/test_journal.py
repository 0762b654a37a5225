"""Lines that are on disk once they are added, and runs as such lines."""

import json

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from dpmacro.evaluation import journal
from dpmacro.evaluation.journal import Journal
from dpmacro.evaluation.kept_episodes import KeptEpisodes
from dpmacro.evaluation.run_lines import episode_of, line_of
from dpmacro.worlds.base import Episode

ABOUT = {"world": {"id": "Room-v0", "size": (3, 4)}, "seed": 7}
ANY = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=3), inner, max_size=3),
)


def opened(path, about=ABOUT):
    return Journal(path, about, "remove it")


def test_lines_are_there_again(tmp_path):
    path = tmp_path / "a/b/runs.jsonl"
    first = opened(path)
    first.add({"run": 1})
    first.add({"run": 2})
    again = opened(path)
    assert first.lines == again.lines == [{"run": 1}, {"run": 2}]
    again.add({"run": 3})
    assert opened(path).lines == [{"run": 1}, {"run": 2}, {"run": 3}]
    assert [path.name for path in path.parent.iterdir()] == ["runs.jsonl"]


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=40, deadline=None)
@given(cut=st.integers(0, 200))
def test_wherever_a_file_was_cut_its_whole_lines_are_kept(tmp_path, cut):
    path = tmp_path / "runs.jsonl"
    path.unlink(missing_ok=True)
    whole = opened(path)
    for run in range(3):
        whole.add({"run": run, "text": "é" * run})
    text = path.read_bytes()[:cut]
    path.write_bytes(text)
    left = opened(path)
    assert left.lines == whole.lines[: max(text.count(b"\n") - 1, 0)]
    left.add({"run": 9})
    assert opened(path).lines == [*left.lines[:-1], {"run": 9}]


@pytest.mark.parametrize(
    ("now", "message"),
    [
        ({**ABOUT, "seed": 8}, "was begun with seed 7, and now it is 8; run the command"),
        ({**ABOUT, "seed": 7.0}, "was begun with seed 7, and now it is 7.0"),
        ({"world": {"id": "Room-v0"}, "seed": 7}, r"with world.size \[3, 4\], and now it is left out"),
        ({**ABOUT, "noise": 0.5}, "with noise left out, and now it is 0.5"),
    ],
)
def test_other_work_is_refused(tmp_path, now, message):
    opened(tmp_path / "runs.jsonl").add({"run": 1})
    before = (tmp_path / "runs.jsonl").read_bytes()
    with pytest.raises(ValueError, match=message) as raised:
        opened(tmp_path / "runs.jsonl", now)
    assert "\n" not in str(raised.value) and (tmp_path / "runs.jsonl").read_bytes() == before


def test_work_of_which_nothing_was_done_is_no_hindrance(tmp_path):
    opened(tmp_path / "runs.jsonl")
    opened(tmp_path / "runs.jsonl", {"seed": 8}).add({"run": 1})
    assert opened(tmp_path / "runs.jsonl", {"seed": 8}).lines == [{"run": 1}]
    with pytest.raises(ValueError, match="was begun with seed 8"):
        opened(tmp_path / "runs.jsonl")


@pytest.mark.parametrize(
    ("line", "message"),
    [
        (b"{", "line 2: is no JSON"),
        (b"\0\0", "line 2: is no JSON"),
        (b"\xff", "line 2: is no JSON"),
        (b"[" * 100_000, "line 2: is no JSON"),
        (b"9" * 5000, "line 2: is no JSON"),
        (b"3", "line 2: holds a int and no object; remove it"),
    ],
)
def test_damaged_lines_are_refused(tmp_path, line, message):
    path = tmp_path / "runs.jsonl"
    opened(path)
    path.write_bytes(path.read_bytes() + line + b"\n")
    with pytest.raises(ValueError, match=message) as raised:
        opened(path)
    assert "\n" not in str(raised.value)


def test_files_beyond_all_measure_are_not_read(tmp_path, monkeypatch):
    opened(tmp_path / "runs.jsonl")
    monkeypatch.setattr(journal, "LARGEST", 10)
    with pytest.raises(ValueError, match="has more than 10 bytes, which no run writes; remove it"):
        opened(tmp_path / "runs.jsonl")


def run_of_noise(seed=7, steps=5, vectors=False, positions=True):
    rng = np.random.default_rng(seed)
    actions = rng.normal(size=(steps, 3)).astype(np.float32) if vectors else rng.integers(0, 3, steps)
    places = rng.normal(size=(steps, 2)).astype(np.float32) if positions else None
    labels = [rng.integers(-1, 3, steps).astype(np.int8) for _ in range(2)]
    rewards = rng.normal(size=steps).astype(np.float32)
    return Episode(seed, "failure", actions, *labels, rewards, 2, places, 3, 1, steps - 1, "its word")


def same(one, other):
    for name, value in vars(one).items():
        now = getattr(other, name)
        if isinstance(value, np.ndarray):
            assert value.dtype == now.dtype and np.array_equal(value, now), name
        else:
            assert value == now and type(value) is type(now), name


@pytest.mark.parametrize("vectors", [False, True])
@pytest.mark.parametrize("positions", [False, True])
def test_runs_come_back_as_they_were(vectors, positions):
    run = run_of_noise(vectors=vectors, positions=positions)
    same(run, episode_of(json.loads(json.dumps(line_of(run)))))


@settings(max_examples=200, deadline=None)
@given(data=st.data())
def test_any_other_line_is_refused_or_a_run(data):
    line = line_of(run_of_noise(steps=3))
    groups = [line, *(value for value in line.values() if isinstance(value, dict))]
    group = data.draw(st.sampled_from(groups))
    name = data.draw(st.sampled_from(sorted(group)))
    if data.draw(st.booleans()):
        group[name] = data.draw(ANY | st.integers(10**9, 10**12) | st.lists(st.integers(0, 10**9)))
    else:
        del group[name]
    try:
        run = episode_of(line)
    except ValueError as error:
        assert "\n" not in str(error)
    else:
        assert len(run.actions) == len(run.phases) == len(run.macros) == len(run.rewards) == 3


def test_claims_beyond_measure_are_refused_before_they_are_unpacked():
    line = line_of(run_of_noise())
    line["steps"] = 10**8
    for name in ("actions", "phases", "macros", "rewards"):
        line[name]["shape"][0] = 10**8
    with pytest.raises(ValueError, match="actions are 800,000,000 bytes"):
        episode_of(line)


def test_kept_runs_are_those_of_the_seeds(tmp_path):
    kept = KeptEpisodes(tmp_path, {}, range(7, 10))
    for seed in (7, 8):
        kept.add(run_of_noise(seed))
    again = KeptEpisodes(tmp_path, {}, range(7, 10))
    assert again.earlier == 2 and again.seconds == pytest.approx(kept.seconds)
    for one, other in zip(kept.episodes, again.episodes, strict=True):
        same(one, other)
    with pytest.raises(ValueError, match="its seeds are not one after the other; give another --output_dir"):
        KeptEpisodes(tmp_path, {}, range(8, 10))
    text = (tmp_path / "runs.jsonl").read_text()
    (tmp_path / "runs.jsonl").write_text(text.replace('"outcome": "failure"', '"outcome": 3', 1))
    with pytest.raises(ValueError, match=r"runs\.jsonl, line 2: outcome is '3': a text was written; give"):
        KeptEpisodes(tmp_path, {}, range(7, 10))


def test_a_full_disk_does_not_end_an_evaluation(tmp_path, monkeypatch):
    kept = KeptEpisodes(tmp_path, {}, range(7, 10))
    kept.add(run_of_noise(7))
    with monkeypatch.context() as patched:
        patched.setattr("os.fsync", lambda *_: (_ for _ in ()).throw(OSError(28, "No space left on device")))
        kept.add(run_of_noise(8))
    kept.add(run_of_noise(9))
    assert kept.unwritten is not None and len(kept.episodes) == 3
    again = KeptEpisodes(tmp_path, {}, range(7, 10))
    assert [episode.seed for episode in again.episodes] in ([7], [7, 8])


def test_an_evaluation_without_runs_leaves_no_folder(tmp_path):
    KeptEpisodes(tmp_path / "out", {}, range(3)).drop_if_empty()
    assert list(tmp_path.iterdir()) == []
    kept = KeptEpisodes(tmp_path / "out", {}, range(7, 9))
    kept.add(run_of_noise(7))
    kept.drop_if_empty()
    assert (tmp_path / "out/runs.jsonl").exists()
