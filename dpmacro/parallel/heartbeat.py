"""Ranks that are not heard of any more: a stopped process keeps its connections, and others wait for it.

A thread of every rank counts in the store by which ranks met, and reads what those of others have counted. A
rank that computes for hours counts on, since threads take turns; one that is stopped, or whose machine is,
does not. Nothing depends on clocks, so that ranks which sleep and wake together go on.
"""

import os
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import timedelta

import torch.distributed as dist

__all__ = ["heard_of"]

BEAT = 5.0  # seconds from one count to the next
SILENCE = 120.0  # seconds without one after which a rank is given up
ENDED = 2  # exit status, that of a rank whose connection to another is lost
GONE = 2**40  # subtracted from the count of a rank that leaves: below 0 for good


@contextmanager
def heard_of(rank: int, size: int, ending: Callable[[], None]) -> Iterator[None]:
    """Let others hear of this rank until the block is left; end the process where another falls silent.

    Args:
        rank: number of this rank.
        size: number of ranks.
        ending: called before the process ends, to clean up; the main thread waits for the other rank then,
            and no exception would reach it.
    """
    address = os.environ["MASTER_ADDR"], int(os.environ["MASTER_PORT"])
    patience = timedelta(seconds=SILENCE)
    store = dist.TCPStore(*address, is_master=False, wait_for_workers=False, timeout=patience)
    heart = _Heart(rank, size, store, ending)
    threads = [threading.Thread(target=work, daemon=True) for work in (heart.beat, heart.watch)]
    for thread in threads:
        thread.start()
    try:
        yield
    finally:
        heart.leaves.set()
        threads[0].join(BEAT)  # lest others wait for a rank that has ended


class _Heart:
    """What the threads of a rank share."""

    def __init__(self, rank: int, size: int, store: dist.TCPStore, ending: Callable[[], None]) -> None:
        self.leaves = threading.Event()
        self._rank, self._size, self._store, self._ending = rank, size, store, ending
        self._rounds = 0

    def beat(self) -> None:
        """Count, and compare what others have counted, until the rank leaves."""
        others = [other for other in range(self._size) if other != self._rank]
        known, misses = dict.fromkeys(others, 0), dict.fromkeys(others, 0)
        try:
            while not self.leaves.wait(BEAT):
                self._store.add(_key(self._rank), 1)
                for other in others:
                    now = self._store.add(_key(other), 0)
                    misses[other] = 0 if now != known[other] or now < 0 else misses[other] + 1
                    known[other] = now
                    if misses[other] * BEAT >= SILENCE:
                        self._end(f"rank {other} has not been heard of for {SILENCE:g} s")
                self._rounds += 1
            self._store.add(_key(self._rank), -GONE)
        except RuntimeError:  # the store has ended, and with it torchrun: meetings end by themselves
            self.leaves.set()

    def watch(self) -> None:
        """End the process where the store itself does not answer, so that `beat` waits for it."""
        known, misses = 0, 0
        while not self.leaves.wait(BEAT):
            misses = misses + 1 if self._rounds == known else 0
            known = self._rounds
            if misses * BEAT >= SILENCE + BEAT:
                self._end(f"the process in which ranks meet has not answered for {SILENCE:g} s")

    def _end(self, why: str) -> None:
        line = (
            f"\nerror: rank {self._rank} of {self._size} ends since {why}: it is stopped, or its machine is; "
            "train.py goes on by --resume=true\n"
        )
        # Below a progress bar; Python's own stderr is that of the leading rank alone.
        os.write(2, line.encode())
        self._ending()
        os._exit(ENDED)


def _key(rank: int) -> str:
    start = os.environ.get("TORCHELASTIC_RESTART_COUNT", "0")  # whose ranks count anew
    return f"dpmacro/heard/{start}/{rank}"
