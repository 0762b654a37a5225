"""Ranks as threads of one process, which meet at a barrier: quick enough for property tests."""

import threading
from concurrent.futures import ThreadPoolExecutor

import torch

from dpmacro.parallel import Ranks


class Room:
    """Where the threads meet."""

    def __init__(self, size):
        self.barrier = threading.Barrier(size, timeout=60)
        self.brought = [None] * size

    def exchanged(self, rank, value):
        """What every rank brings to this meeting."""
        self.brought[rank] = value
        self.barrier.wait()
        found = list(self.brought)
        self.barrier.wait()
        return found


class ThreadRanks(Ranks):
    """A rank that is a thread; its other methods are those of processes."""

    def __init__(self, rank, size, room):
        super().__init__(rank, size)
        object.__setattr__(self, "room", room)

    def gathered(self, own):
        return torch.stack(self.room.exchanged(self.rank, own.clone()))

    def summed(self, own):
        return own.copy_(torch.stack(self.room.exchanged(self.rank, own.clone())).sum(0, dtype=own.dtype))

    def told(self, value):
        return self.heard(value)[0]

    def heard(self, value):
        return self.room.exchanged(self.rank, value)


def on_ranks(size, work):
    """What `work(ranks)` returns on each of so many ranks."""
    room = Room(size)

    def one(rank):
        try:
            return work(ThreadRanks(rank, size, room))
        except BaseException:
            room.barrier.abort()
            raise

    with ThreadPoolExecutor(size) as threads:
        futures = [threads.submit(one, rank) for rank in range(size)]
        errors = [error for error in (future.exception() for future in futures) if error is not None]
        real = [error for error in errors if not isinstance(error, threading.BrokenBarrierError)]
        if errors:
            raise (real or errors)[0]
        return [future.result() for future in futures]
