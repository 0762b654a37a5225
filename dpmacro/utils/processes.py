"""Work spread over processes: results in order, Ctrl-C left to the parent, no worker that outlives it.

A worker that is told to end (SIGTERM) ends at once, and its temporary files go.
"""

import itertools
import multiprocessing
import os
import signal
import threading
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing.synchronize import Event
from types import FrameType
from typing import Any, TypeVar

from dpmacro.utils import temporary

__all__ = ["spread", "stopped"]

AHEAD = 4  # items a worker, so that none idles while the next result is long in coming
Item = TypeVar("Item")
Result = TypeVar("Result")


def spread(
    task: Callable[[Item], Result], items: Iterable[Item], workers: int
) -> Generator[Result, None, None]:
    """task(item) for every item, in their order, the same for any number of workers.

    Args:
        task: a function of a module, or a `functools.partial` of one; what it needs for many items it may
            keep in a `functools.cache`, which lives as long as its process.
        items: may be endless; at most `AHEAD` a worker are worked on before their result is asked for.
        workers: processes, 1 or more. Closing the generator, or an interrupt, ends them.

    Raises ValueError for workers < 1. What a task raises is raised here.
    """
    if workers < 1:
        raise ValueError(f"workers is {workers}, it must be at least 1")
    return _spread(task, items, workers)


def stopped() -> bool:
    """In a task: whether nobody waits for its result any more, so that it may return anything."""
    return _stop is not None and _stop.is_set()


def _spread(
    task: Callable[[Item], Result], items: Iterable[Item], workers: int
) -> Generator[Result, None, None]:
    context = multiprocessing.get_context("spawn")
    stop = context.Event()
    pool = ProcessPoolExecutor(workers, context, _start_worker, (stop,))
    waiting = iter(items)
    pending: deque[Future[Any]] = deque()

    def submit(most: int) -> None:
        with _deaf_to_interrupts():
            pending.extend(pool.submit(task, item) for item in itertools.islice(waiting, most))

    try:
        submit(AHEAD * workers)
        while pending:
            result = pending.popleft().result()
            submit(1)
            yield result
    finally:
        stop.set()
        pool.shutdown(cancel_futures=True)


@contextmanager
def _deaf_to_interrupts() -> Iterator[None]:
    """Processes that start in the block get no Ctrl-C before `_start_worker`; here it acts afterwards."""
    if not hasattr(signal, "pthread_sigmask"):  # on Windows
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


_stop: Event | None = None


def _start_worker(stop: Event) -> None:
    global _stop
    _stop = stop
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if hasattr(signal, "pthread_sigmask"):
        signal.pthread_sigmask(signal.SIG_UNBLOCK, [signal.SIGINT])
    signal.signal(signal.SIGTERM, _end)
    parent = multiprocessing.parent_process()
    assert parent is not None

    def end() -> None:
        parent.join()
        temporary.remove_all()
        os._exit(1)

    threading.Thread(target=end, daemon=True).start()


def _end(number: int, frame: FrameType | None) -> None:
    temporary.remove_all()
    os._exit(128 + number)
