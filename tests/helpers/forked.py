"""Scripts in processes that have what is slow to import, each with a process group of its own."""

import multiprocessing
import os
import runpy
import sys
import traceback
from pathlib import Path

_CONTEXT = multiprocessing.get_context("forkserver")
PRELOADED = [
    "forked",
    "dpmacro.annotation.exports.dataset",
    "dpmacro.annotation.page.write",
    "dpmacro.annotation.recordings",
    "dpmacro.annotation.report",
    "dpmacro.evaluation.result",
    "dpmacro.evaluation.videos",
    "dpmacro.training.trainer",
    "dpmacro.worlds.two_places",
    "h5py",
    "lerobot.datasets.lerobot_dataset",
    "pandas",
    "scipy.ndimage",
    "scipy.stats",
]


class Forked:
    """A script that runs in a folder; `pid` is that of its process, and of its group."""

    def __init__(self, options, folder):
        _CONTEXT.set_forkserver_preload(PRELOADED)
        log = folder.with_name(f"{folder.name}.log")
        grouped, told = _CONTEXT.Pipe(duplex=False)
        self._process = _CONTEXT.Process(target=_run, args=([*options], str(folder), str(log), told))
        self._process.start()
        self.pid = self._process.pid
        assert grouped.recv()

    def wait(self, timeout):
        """The exit status; None where it still runs after so many seconds."""
        self._process.join(timeout)
        return self._process.exitcode


def _run(options, folder, log, told):
    os.setsid()
    told.send(True)
    told.close()
    os.chdir(folder)
    output = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_APPEND)
    os.dup2(output, 1)
    os.dup2(output, 2)
    script = Path(__file__).resolve().parents[2] / options[0]
    sys.argv = [str(script), *options[1:]]
    try:
        runpy.run_path(str(script), run_name="__main__")
    except Exception:
        traceback.print_exc()
        raise
