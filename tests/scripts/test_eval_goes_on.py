"""What eval.py makes of an evaluation that was stopped, that could not be written, or that is over."""

import json
import shutil

import numpy as np
import pytest
from reaching import Reach, constant_policy

from tests.helpers.limited import limited
from tests.scripts.test_eval import call, script  # noqa: F401  a fixture

TIMES = ("eval_s", "eval_ep_s")


@pytest.fixture
def reach(tmp_path):
    return constant_policy(tmp_path / "policy")


@pytest.fixture
def ran(script, monkeypatch):  # noqa: F811
    """The seeds of the runs that were made."""
    seeds, run = [], script.iter_episodes
    monkeypatch.setattr(
        script, "iter_episodes", lambda *given: seeds.extend(given[2]) or run(given[0], given[1], given[2], 1)
    )
    return seeds


def info_of(folder):
    info = json.loads((folder / "eval_info.json").read_text())
    assert info["overall"]["eval_s"] > 0
    info["overall"] |= dict.fromkeys(TIMES)
    return info


def stop(script, monkeypatch, after, *options):  # noqa: F811
    """Call it, and stop it after so many runs as a kill does: the last line is written in part."""

    def add(kept, episode):
        add_whole(kept, episode)
        if len(kept.episodes) == after:
            with kept.path.open("ab") as file:
                file.write(b'{"seed": 9, "outco')
            raise MemoryError

    with monkeypatch.context() as patched:
        add_whole = script.KeptEpisodes.add
        patched.setattr(script.KeptEpisodes, "add", add)
        with pytest.raises(MemoryError):
            call(script, patched, *options)


def test_finished_runs_are_not_made_again(script, reach, ran, tmp_path, monkeypatch, capsys):  # noqa: F811
    options = [f"--policy.path={reach}", "--episodes=5", "--seed=3"]
    call(script, monkeypatch, *options, f"--output_dir={tmp_path / 'alone'}")
    out = tmp_path / "out"
    ran.clear()
    for after in (2, 4):
        stop(script, monkeypatch, after, *options, f"--output_dir={out}")
        assert [path.name for path in out.iterdir()] == ["runs.jsonl"]
    assert ran == [3, 4, 5, 6, 7, 5, 6, 7]
    ran.clear()
    call(script, monkeypatch, *options, f"--output_dir={out}")
    told, bars = capsys.readouterr()
    assert ran == [7] and f"goes on     4 of 5 runs are kept in {out / 'runs.jsonl'}" in told
    assert "5/5" in bars and info_of(out) == info_of(tmp_path / "alone")
    with pytest.raises(SystemExit):
        call(script, monkeypatch, *options, f"--output_dir={out}")
    assert "already holds an eval_info.json" in capsys.readouterr().err and ran == [7]


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        (["--seed=4"], "was begun with seed 3, and now it is 4; run the command that it was begun with"),
        (["--episodes=6"], "was begun with episodes 5, and now it is 6"),
        (["--world.goal=2"], "was begun with world.goal left out, and now it is 2"),
        (["policy"], "was begun with policy "),
    ],
)
def test_runs_of_another_evaluation_are_refused(
    script,  # noqa: F811
    reach,
    tmp_path,
    monkeypatch,
    capsys,
    changed,
    message,
):
    options = [f"--policy.path={reach}", "--episodes=5", "--seed=3", f"--output_dir={tmp_path / 'out'}"]
    stop(script, monkeypatch, 2, *options)
    before = (tmp_path / "out/runs.jsonl").read_bytes()
    if changed == ["policy"]:
        shutil.rmtree(reach)
        constant_policy(reach, action=(0.25, 0.0, 2.0))
        changed = []
    capsys.readouterr()
    with pytest.raises(SystemExit) as exit_:
        call(script, monkeypatch, *options, *changed)
    error = capsys.readouterr().err
    assert exit_.value.code == 2 and error.startswith("error: ") and error.count("\n") == 1
    assert message in error and "give another --output_dir" in error
    assert (tmp_path / "out/runs.jsonl").read_bytes() == before


def test_the_same_policy_may_lie_elsewhere(script, reach, ran, tmp_path, monkeypatch):  # noqa: F811
    options = ["--episodes=3", f"--output_dir={tmp_path / 'out'}"]
    stop(script, monkeypatch, 2, f"--policy.path={reach}", *options)
    ran.clear()
    call(script, monkeypatch, f"--policy.path={reach.rename(tmp_path / 'moved')}", *options, "--workers=2")
    assert ran == [10002]


def test_videos_can_be_made_afterwards(script, reach, ran, tmp_path, monkeypatch, capsys):  # noqa: F811
    out, both = tmp_path / "out", tmp_path / "both"
    options = [f"--policy.path={reach}", "--episodes=3", "--world.goal=0.9"]
    call(script, monkeypatch, *options, f"--output_dir={out}")
    before = info_of(out)
    ran.clear()
    call(script, monkeypatch, *options, f"--output_dir={out}", "--videos=1")
    [first] = out.glob("videos/*/*.mp4")
    written = first.stat().st_mtime_ns
    call(script, monkeypatch, *options, f"--output_dir={out}", "--videos=2")
    assert not ran and first.stat().st_mtime_ns == written, "what is there is not made again"
    assert "successes   3 of 3 runs" in capsys.readouterr().out
    now = info_of(out)
    assert now["overall"]["video_paths"] == [
        str(out / f"videos/reaching_Reach-v0_0/eval_episode_{k}.mp4") for k in range(2)
    ]
    assert now["dpmacro"] == before["dpmacro"]
    call(script, monkeypatch, *options, f"--output_dir={both}", "--videos=2")
    videos = [sorted(folder.glob("videos/*/*.mp4")) for folder in (out, both)]
    assert [path.read_bytes() for path in videos[0]] == [path.read_bytes() for path in videos[1]]


def test_a_run_that_cannot_be_repeated_gets_no_video(
    script,  # noqa: F811
    reach,
    tmp_path,
    monkeypatch,
    capsys,
):
    options = [f"--policy.path={reach}", "--episodes=3", f"--output_dir={tmp_path / 'out'}"]
    call(script, monkeypatch, *options)
    reset = Reach.reset

    def farther(world, *, seed=None, options=None):
        seen, info = reset(world, seed=seed)
        if seed == 10001:
            world.place[0], seen = 0.0, {"agent_pos": np.array([0.0, 0.0, 1.0])}
            world.goal = 9.0
        return seen, info

    monkeypatch.setattr(Reach, "reset", farther)
    with pytest.raises(SystemExit) as exit_:
        call(script, monkeypatch, *options, "--videos=3")
    error = capsys.readouterr().err.splitlines()[-1]
    assert exit_.value.code == 2 and "no video: the run of seed 10001 cannot be repeated: step " in error
    paths = info_of(tmp_path / "out")["overall"]["video_paths"]
    assert [path[-5] for path in paths] == ["0", "2"]
    assert len(list((tmp_path / "out").glob("videos/*/*"))) == 2


def test_results_are_told_though_they_cannot_be_written(
    script,  # noqa: F811
    reach,
    ran,
    tmp_path,
    monkeypatch,
    capsys,
):
    """The largest file that may be written holds the run, but not TensorBoard's events or eval_info.json."""
    out = tmp_path / "out"
    options = [f"--policy.path={reach}", "--episodes=1", f"--output_dir={out}"]
    with limited(1400), pytest.raises(SystemExit) as exit_:
        call(script, monkeypatch, *options)
    told = capsys.readouterr()
    assert exit_.value.code == 2 and "successes   1 of 1 runs" in told.out
    last = told.err.splitlines()[-1]
    assert f"error: not written to {out}: " in last and "eval_info.json (" in last
    assert f"run the same command with --output_dir={out}: it goes on from runs.jsonl" in last
    assert not (out / "eval_info.json").exists()
    ran.clear()
    call(script, monkeypatch, *options)
    assert not ran and info_of(out)["dpmacro"]["seeds"] == [10000]


def test_runs_that_cannot_be_kept_are_told_too(
    script,  # noqa: F811
    reach,
    tmp_path,
    monkeypatch,
    capsys,
):
    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("dpmacro.evaluation.journal.Journal.add", full)
    with pytest.raises(SystemExit) as exit_:
        options = ["--episodes=3", f"--output_dir={tmp_path / 'out'}"]
        call(script, monkeypatch, f"--policy.path={reach}", *options)
    told = capsys.readouterr()
    assert exit_.value.code == 2 and "successes   3 of 3 runs" in told.out
    last = told.err.splitlines()[-1]
    assert last.endswith("out: runs.jsonl (No space left on device); all else is there")
    assert info_of(tmp_path / "out")["dpmacro"]["seeds"] == [10000, 10001, 10002]
