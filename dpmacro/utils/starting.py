"""Imported by a script before all else: Ctrl-C while its libraries are imported prints one line.

Some libraries turn an interrupt of their import into an error of their own, so the process ends at once;
there is nothing to clean up yet. `dpmacro.utils.cli.run` takes Ctrl-C over. Processes that a script starts
import it as well and leave Ctrl-C to their parent.
"""

import os
import signal
import sys
import threading
from types import FrameType

__all__ = ["end"]

INTERRUPTED = 130
FORKED = "--multiprocessing-fork"  # in the command line of a process that `multiprocessing` spawned


def end(number: int, frame: FrameType | None) -> None:
    """Say that the process was interrupted, and end it with exit status 130."""
    os.write(2, b"interrupted\n")
    os._exit(INTERRUPTED)


if threading.current_thread() is threading.main_thread():
    if FORKED in sys.orig_argv:
        signal.signal(signal.SIGINT, signal.SIG_IGN)
    elif signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, end)
