"""A process that writes labels and is killed on the way."""

import multiprocessing
import os
import signal
from pathlib import Path

from dpmacro.annotation.exports.dataset import write_labels

# Of a process that has no threads: one that pytest forks might wait for its parent's for ever.
_CONTEXT = multiprocessing.get_context("forkserver")


def killed(arguments, at, before=False):
    """Call `write_labels` in a process that is killed at the rename number `at`; whether it was."""
    _CONTEXT.set_forkserver_preload(["dpmacro.annotation.exports.dataset", "stopped"])
    process = _CONTEXT.Process(target=_write, args=(arguments, at, before))
    process.start()
    process.join(60)
    assert process.exitcode in (0, -signal.SIGKILL), process.exitcode
    return process.exitcode != 0


def _write(arguments, at, before):
    rename, count = Path.replace, [0]

    def counted(self, target):
        count[0] += 1
        if count[0] == at and before:
            os.kill(os.getpid(), signal.SIGKILL)
        rename(self, target)
        if count[0] == at:
            os.kill(os.getpid(), signal.SIGKILL)

    Path.replace = counted
    write_labels(*arguments)
