"""A process that is killed while it writes files."""

import multiprocessing
import os
import signal
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

PATIENCE = 300  # seconds
# Of a process that has no threads: one that pytest forks might wait for its parent's for ever.
_CONTEXT = multiprocessing.get_context("forkserver")


def killed(function: Callable[..., Any], arguments: Sequence[Any], at: int, before: bool = False) -> bool:
    """Call it in a process that is killed at its rename number `at`; whether it was."""
    _CONTEXT.set_forkserver_preload([function.__module__, "stopped"])
    process = _CONTEXT.Process(target=_call, args=(function, arguments, at, before))
    process.start()
    process.join(PATIENCE)
    assert process.exitcode in (0, -signal.SIGKILL), process.exitcode
    return process.exitcode != 0


def _call(function, arguments, at, before):
    rename, count = Path.replace, [0]

    def counted(self, target):
        count[0] += 1
        if count[0] == at and before:
            os.kill(os.getpid(), signal.SIGKILL)
        rename(self, target)
        if count[0] == at:
            os.kill(os.getpid(), signal.SIGKILL)

    Path.replace = counted
    function(*arguments)
