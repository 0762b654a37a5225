"""Folders that one process at a time writes to, with processes that live and such that are killed."""

import json
import os
import signal
import subprocess
import sys
import textwrap
import warnings

import pytest

from dpmacro.utils import claims
from dpmacro.utils.claims import CLAIM, claimed

ENDED = 2**22 + 1  # more than any process's number


@pytest.fixture
def holder(tmp_path):
    """A process that holds a claim of tmp_path/"run" until it is killed."""
    code = """
        import sys, time
        from pathlib import Path
        from dpmacro.utils.claims import claimed
        with claimed(Path(sys.argv[1])):
            print("claimed", flush=True)
            time.sleep(100)
        """
    arguments = [sys.executable, "-c", textwrap.dedent(code), tmp_path / "run"]
    with subprocess.Popen(arguments, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None and process.stdout.readline() == "claimed\n"
        yield process
        process.kill()


def test_a_claim_and_what_it_made_go_with_the_block(tmp_path):
    with claimed(tmp_path / "a/b/c") as claim:
        assert claim == claims.Claim(tmp_path / "a/b/c") and (tmp_path / "a/b/c" / CLAIM).exists()
    assert not list(tmp_path.iterdir())
    with pytest.raises(RuntimeError), claimed(tmp_path / "a/b/c"):
        (tmp_path / "a/b/kept").touch()
        raise RuntimeError
    assert [path.name for path in tmp_path.rglob("*")] == ["a", "b", "kept"]


def test_a_folder_that_holds_something_is_claimed_as_well_for_runs_that_go_on(tmp_path):
    (tmp_path / "kept").touch()
    with claimed(tmp_path) as claim:
        assert claim.dead is None
    assert list(tmp_path.iterdir()) == [tmp_path / "kept"]


def test_a_second_process_is_refused_while_the_first_lives(holder, tmp_path):
    told = rf"^--out={tmp_path}/run: process {holder.pid} on .* writes to it; wait for that, or give another"
    with pytest.raises(ValueError, match=told), claimed(tmp_path / "run", "--out"):
        pass
    assert (tmp_path / "run" / CLAIM).exists() and holder.poll() is None


def test_this_process_is_refused_likewise_through_another_path(tmp_path):
    (tmp_path / "link").symlink_to(tmp_path / "run")
    with claimed(tmp_path / "run"):
        for name in ("run", "link", "run/../run"):
            with pytest.raises(ValueError, match="writes to it"), claimed(tmp_path / name):
                pass


def test_the_claim_of_a_killed_process_is_taken_over_and_its_temporary_files_go(holder, tmp_path):
    holder.send_signal(signal.SIGKILL)
    holder.wait()
    run, number = tmp_path / "run", holder.pid
    (run / "checkpoints").mkdir()
    mine = [run / f".file-{number}.json", run / f"checkpoints/.last-{number}"]
    mine[0].touch()
    mine[1].symlink_to("nowhere")
    others = [run / f".file-{number}1.json", run / f"file-{number}.json"]
    for path in others:
        path.touch()
    told = rf"process {number} was killed while it wrote to it; this one takes over and removes .*-{number}"
    with pytest.warns(UserWarning, match=told), claimed(run) as claim:
        assert claim.dead == number
        assert not any(os.path.lexists(path) for path in mine) and all(path.exists() for path in others)
        assert json.loads((run / CLAIM).read_text())["process"] == os.getpid()


def test_a_folder_that_is_named_at_the_end_is_claimed_beside_it(tmp_path):
    root = tmp_path / "data[1]"
    with claimed(root, "--root", beside=True), claimed(tmp_path / "data1", "--root", beside=True):
        assert not root.exists()
        with pytest.raises(ValueError, match=r"--root=.* writes to it"), claimed(root, "--root", beside=True):
            pass
    assert not list(tmp_path.iterdir())
    (tmp_path / f".data[1]{CLAIM}").write_text(json.dumps({"process": ENDED}))
    for name in (".data[1].x.partial", ".data1.x.partial"):
        (tmp_path / name / "dataset").mkdir(parents=True)
    with pytest.warns(UserWarning, match=r"removes .*data\[1\]\.x\.partial$"), claimed(root, beside=True):
        assert [path.name for path in tmp_path.glob(".*.partial")] == [".data1.x.partial"]


@pytest.mark.parametrize("text", ["", "{", "[1]", '{"process": "x"}', '{"process": -5}', "\0" * 5000])
def test_what_is_no_claim_is_written_over(tmp_path, text):
    (tmp_path / CLAIM).write_text(text)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with claimed(tmp_path) as claim:
            assert claim.dead is None


def test_folders_above_one_that_cannot_be_made_go_as_well(tmp_path):
    with pytest.raises(OSError, match="too long"), claimed(tmp_path / "a/b" / ("x" * 250), beside=True):
        pass
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("path", ["file", "file/run"])
def test_a_file_is_no_folder(tmp_path, path):
    (tmp_path / "file").touch()
    with pytest.raises((ValueError, OSError), match="file"), claimed(tmp_path / path):
        pass
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


@pytest.mark.parametrize(
    ("process", "host", "free"),
    [
        (os.getppid(), None, False),
        (ENDED, None, True),
        (ENDED, "elsewhere", False),
    ],
)
def test_without_locks_the_number_of_the_process_tells(tmp_path, monkeypatch, process, host, free):
    monkeypatch.setattr(claims, "locked", lambda file: None)
    about = {"process": process, "host": host or claims.socket.gethostname()}
    (tmp_path / CLAIM).write_text(json.dumps(about))
    if free:
        with pytest.warns(UserWarning, match="takes over"), claimed(tmp_path) as claim:
            assert claim.dead == ENDED
    else:
        with pytest.raises(ValueError, match=f"process {process} on "), claimed(tmp_path):
            pass


def test_of_many_that_start_at_once_one_writes(tmp_path):
    code = """
        import sys, time
        from pathlib import Path
        from dpmacro.utils.claims import claimed
        sys.stdin.readline()
        for turn in range(40):
            try:
                with claimed(Path(sys.argv[1])):
                    Path(sys.argv[1], "there").touch(exist_ok=False)
                    time.sleep(0.002)
                    Path(sys.argv[1], "there").unlink()
            except ValueError as error:
                assert "writes to it" in str(error)
        """
    arguments = [sys.executable, "-c", textwrap.dedent(code), str(tmp_path / "a/run")]
    pipes = {"stdin": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    processes = [subprocess.Popen(arguments, **pipes) for _ in range(4)]
    for process in processes:
        process.stdin.write("\n")
        process.stdin.flush()
    errors = [process.communicate(timeout=60)[1] for process in processes]
    assert errors == [""] * 4
    assert not [path for path in tmp_path.rglob("*") if path.is_file()]
