"""Ctrl-C, and signals that end a process: held back until a block is done, and cleaned up after alike."""

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any

__all__ = ["ENDING", "Terminated", "held_back", "terminating"]

# Of a system that shuts down, a scheduler whose time is up, and a terminal that is closed.
ENDING = tuple(getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name))


class Terminated(KeyboardInterrupt):
    """A signal that ends the process, raised as Ctrl-C is, so that the same is cleaned up.

    Attributes:
        number: of the signal.
    """

    def __init__(self, number: int) -> None:
        super().__init__(signal.Signals(number).name)
        self.number = number


@contextmanager
def terminating() -> Iterator[None]:
    """Signals that end a process raise `Terminated` in the block, unless something else was to happen.

    Outside the main thread, where no signal acts, nothing changes.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    own = [number for number in ENDING if signal.getsignal(number) is signal.SIG_DFL]
    for number in own:
        signal.signal(number, _terminate)
    try:
        yield
    finally:
        for number in own:
            signal.signal(number, signal.SIG_DFL)


@contextmanager
def held_back() -> Iterator[None]:
    """Ctrl-C, and signals that raise `Terminated`, act once the block is left.

    Outside the main thread, where they never act, nothing changes.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    handlers: dict[int, Any] = {
        number: handler
        for number, handler in ((number, signal.getsignal(number)) for number in (signal.SIGINT, *ENDING))
        if callable(handler)
    }
    caught: list[tuple[int, FrameType | None]] = []
    for number in handlers:
        signal.signal(number, lambda number, frame: caught.append((number, frame)))
    try:
        yield
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
    if caught:
        handlers[caught[0][0]](*caught[0])


def _terminate(number: int, frame: FrameType | None) -> None:
    raise Terminated(number)
