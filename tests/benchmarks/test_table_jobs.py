"""Scripts as processes: a stamp for what succeeded, one line for what did not, nothing for an interrupt."""

import shlex
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "benchmarks"))  # as the script itself finds its neighbours

import table_jobs  # noqa: E402
from table_jobs import Job, forget, progress, read_stamp, run  # noqa: E402

WRITES = """\
import sys, pathlib, time
folder = pathlib.Path(sys.argv[-1])
folder.mkdir(parents=True)
(folder / "made").write_text(" ".join(sys.argv[1:-1]))
"""


@pytest.fixture
def job(tmp_path):
    def of(code, *options, episodes=None):
        (tmp_path / "script.py").write_text(code)
        folder = tmp_path / "made here/cell"
        return Job("doing it", str(tmp_path / "script.py"), folder, options, (str(folder),), episodes)

    return of


def ignored(done):
    pass


def test_what_succeeds_is_stamped_and_replaces_what_was_there(job):
    first = job(WRITES + "time.sleep(0.4)", "--a=1")
    (first.folder / "old").mkdir(parents=True)
    assert read_stamp(first.folder) is None
    started = time.perf_counter()
    stamp = run(first, "abc", 1, ignored)
    assert 0.4 <= stamp["seconds"] <= round(time.perf_counter() - started, 1) + 0.1
    assert read_stamp(first.folder) == stamp
    assert stamp["options"] == ["--a=1"] and stamp["commit"] == "abc"
    assert shlex.split(stamp["command"])[-2:] == ["--a=1", str(first.folder)]
    assert [path.name for path in first.folder.iterdir()] == ["made"]
    assert (first.folder / "made").read_text() == "--a=1"
    forget(first.folder)
    assert read_stamp(first.folder) is None and not first.folder.exists()


def test_a_script_has_the_threads_that_it_is_given(job, monkeypatch):
    monkeypatch.setenv("OMP_NUM_THREADS", "7")
    tells = job(WRITES + "import os\n(folder / 'threads').write_text(os.environ['OMP_NUM_THREADS'])")
    for threads in (1, 3):
        run(tells, "abc", threads, ignored)
        assert (tells.folder / "threads").read_text() == str(threads)


@pytest.mark.parametrize(
    ("code", "message"),
    [
        ("print('well'); raise SystemExit('error: no \\nroom ')", "exit status 1: room"),
        ("import sys; print('12/20 [\\r13/20 [', end=''); sys.exit(2)", r"exit status 2: 13/20 \["),
        ("import os, signal; os.kill(os.getpid(), signal.SIGKILL)", "exit status -9: it printed nothing"),
    ],
)
def test_a_failure_is_one_line_with_the_last_of_its_log(job, code, message):
    run(job(WRITES), "abc", 1, ignored)
    failing = job(WRITES + code)
    with pytest.raises(OSError, match=rf"^doing it failed with {message} \(all of it in .*/cell\.log\)$"):
        run(failing, "abc", 1, ignored)
    assert read_stamp(failing.folder) is None


def test_an_interrupt_ends_the_script_and_leaves_no_stamp(job, monkeypatch):
    monkeypatch.setattr(table_jobs, "PATIENCE", 0.2)
    monkeypatch.setattr(table_jobs, "POLL", 0.1)
    children = []
    popen = table_jobs.subprocess.Popen
    monkeypatch.setattr(
        table_jobs.subprocess, "Popen", lambda *a, **b: children.append(popen(*a, **b)) or children[-1]
    )
    endless = job(WRITES + "for k in range(99): print(f'{k}/99 [', flush=True), time.sleep(9)", episodes=99)

    def interrupted(done):
        if endless.folder.exists():
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run(endless, "abc", 1, interrupted)
    [child] = children
    assert child.poll() is not None
    assert endless.folder.exists() and read_stamp(endless.folder) is None


def test_an_interrupted_script_cleans_up_its_processes_too(job, monkeypatch):
    monkeypatch.setattr(table_jobs, "POLL", 0.1)
    cleans = job(
        WRITES
        + "import subprocess\n"
        + "other = subprocess.Popen([sys.executable, '-c', 'import time; time.sleep(99)'])\n"
        + "try:\n    (folder / 'ready').touch(), time.sleep(99)\n"
        + "except KeyboardInterrupt:\n    (folder / 'cleaned').write_text(str(other.wait()))\n"
    )

    def interrupted(done):
        if (cleans.folder / "ready").exists():
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run(replace(cleans, episodes=9), "abc", 1, interrupted)
    assert int((cleans.folder / "cleaned").read_text()) != 0
    assert read_stamp(cleans.folder) is None


def test_a_script_tells_how_far_it_is(job, monkeypatch):
    monkeypatch.setattr(table_jobs, "POLL", 0.05)
    told = []
    waiting = "for k in range(4): print(f'\\r {k}/3 [00:01', end='', flush=True), time.sleep(0.2)"
    run(job(WRITES + waiting, episodes=3), "abc", 1, told.append)
    assert told == sorted(told) and set(told) & {1, 2}
    silent = []
    run(job(WRITES + waiting), "abc", 1, silent.append)
    assert silent == []


@pytest.mark.parametrize(
    ("printed", "done"),
    [
        ("", 0),
        ("Evaluating:  50%|#####     | 25/50 [00:10<00:10]", 25),
        (" 1/50 [..\n 2/50 [..\n 7/100 [", 2),
        ("125/50 [", 125),
        ("objective 3/50", 0),
    ],
)
def test_progress_is_the_last_bar_of_that_total(printed, done):
    assert progress(printed, 50) == done


@pytest.mark.parametrize("text", ["", "[1]", '{"options": []}', "{"])
def test_half_a_stamp_is_none(tmp_path, text):
    (tmp_path / "cell").mkdir()
    (tmp_path / "cell.json").write_text(text)
    assert read_stamp(tmp_path / "cell") is None
