"""Temporary folders: gone at the end, by a signal too, and swept after a process that was killed."""

import os
import signal
import subprocess
import sys
import tempfile
import textwrap

import pytest

from dpmacro.utils import temporary
from dpmacro.utils.temporary import temporary_folder


@pytest.fixture(autouse=True)
def place(tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    temporary._sweep.cache_clear()
    return tmp_path


def started(code, place):
    arguments = [sys.executable, "-c", textwrap.dedent(code)]
    environment = {**os.environ, "TMPDIR": str(place)}
    process = subprocess.Popen(arguments, stdout=subprocess.PIPE, text=True, env=environment)
    assert process.stdout is not None and process.stdout.readline() == "there\n"
    return process


HOLDS = """
    import time
    from dpmacro.utils.temporary import temporary_folder
    with temporary_folder() as folder:
        (folder / "texture.png").touch()
        print("there", flush=True)
        time.sleep(100)
    """


def test_a_folder_goes_with_the_block(place):
    with pytest.raises(KeyboardInterrupt), temporary_folder() as folder:
        (folder / "texture.png").touch()
        raise KeyboardInterrupt
    assert not list(place.iterdir())


def test_folders_of_killed_processes_are_swept_and_named_and_those_of_others_stay(place):
    living, killed = started(HOLDS, place), started(HOLDS, place)
    left = {path.parent for path in place.glob("*/texture.png")}
    killed.send_signal(signal.SIGKILL)
    killed.wait()
    (place / "dpmacro-files-new").mkdir()  # whose process has no lock yet
    swept = "removed temporary files of processes that were killed: "
    with pytest.warns(UserWarning, match=swept) as told, temporary_folder():
        pass
    [gone] = [path for path in left if not path.exists()]
    assert str(told[0].message).endswith(str(gone)) and (place / "dpmacro-files-new").exists()
    living.kill()
    living.wait()


def test_a_worker_that_is_told_to_end_removes_its_folders(place):
    code = """
        import multiprocessing, threading, time
        from dpmacro.utils import processes
        from dpmacro.utils.temporary import temporary_folder
        class Parent:
            def join(self):
                time.sleep(100)
        multiprocessing.parent_process = Parent
        processes._start_worker(None)
        with temporary_folder() as folder:
            print("there", flush=True)
            time.sleep(100)
        """
    worker = started(code, place)
    assert len(list(place.iterdir())) == 1
    worker.send_signal(signal.SIGTERM)
    assert worker.wait(20) == 128 + signal.SIGTERM
    assert not list(place.iterdir())
