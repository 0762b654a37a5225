"""The processes of one training and what they tell one another, on torch's own engine.

`torchrun --nproc_per_node=R` starts R ranks. Each runs the same program on the same scores; what is divided
among them (dpmacro/parallel/shares.py) is exchanged here, and all of them go on with the same numbers.
"""

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import timedelta
from typing import TypeVar

import torch
import torch.distributed as dist
from torch import Tensor

from dpmacro.parallel.heartbeat import heard_of

__all__ = ["ALONE", "Ranks", "joined"]

PATIENCE = timedelta(hours=2)  # for a rank that lives and is late; others are known earlier

T = TypeVar("T")


@dataclass(frozen=True)
class Ranks:
    """One of the processes, which has number `rank` of `size`; a training without others has one.

    Every method but `share_of` is a meeting: all ranks call the same ones in the same order. ConnectionError
    where another rank has ended.
    """

    rank: int = 0
    size: int = 1

    @property
    def leads(self) -> bool:
        """Whether this is the rank that writes and prints."""
        return self.rank == 0

    def share_of(self, pieces: Sequence[T]) -> Sequence[T]:
        """Those of some pieces of work that this rank does; no meeting."""
        return pieces[self.rank :: self.size]

    def gathered(self, own: Tensor) -> Tensor:
        """The tensors [...] of all ranks, of one shape, as [ranks ...]."""
        if self.size == 1:
            return own[None]
        sent = _sendable(own).contiguous()
        found = [torch.empty_like(sent) for _ in range(self.size)]
        with self._meeting():
            dist.all_gather(found, sent)
        return torch.stack(found).to(own.device)

    def summed(self, own: Tensor) -> Tensor:
        """The sum of all ranks' tensors, of one shape; `own` is overwritten."""
        if self.size == 1:
            return own
        sent = _sendable(own)
        with self._meeting():
            dist.all_reduce(sent)
        return own if sent is own else own.copy_(sent)

    def heard(self, value: T) -> list[T]:
        """What every rank has as `value`, a small object."""
        found = [value] * self.size
        if self.size > 1:
            with self._meeting():
                dist.all_gather_object(found, value)
        return found

    def told(self, value: T) -> T:
        """What the leading rank has as `value`; that of others counts for nothing."""
        if self.size == 1:
            return value
        found = [value]
        with self._meeting():
            dist.broadcast_object_list(found)
        return found[0]

    def check_alike(self, *tensors: Tensor) -> None:
        """Raise ValueError, on all ranks, unless the sums of these tensors are the same on all."""
        sums = [float(tensor.double().sum()) for tensor in tensors]
        if any(one != sums for one in self.heard(sums)):
            raise ValueError(
                "ranks have come to different results: their machines calculate differently, so train on "
                "machines of one kind"
            )

    @contextmanager
    def together(self) -> Iterator[None]:
        """Work without meetings, in which each rank has its own part: an error of one ends all alike.

        Raises the ValueError or OSError of the first rank that has one, on all ranks; those that have one of
        their own raise that.
        """
        error = None
        try:
            yield
        except (ValueError, OSError) as own:
            error = own
        found = self.heard(None if error is None else str(error))
        if error is not None:
            raise error
        for rank, told in enumerate(found):
            if told is not None:
                raise ValueError(f"rank {rank}: {told}")

    @contextmanager
    def _meeting(self) -> Iterator[None]:
        try:
            yield
        except RuntimeError as error:
            line = " ".join(str(error).split())[:200]
            raise ConnectionError(
                f"rank {self.rank} of {self.size} ends since another rank has ended, see what that one said "
                f"({line})"
            ) from error


def _sendable(tensor: Tensor) -> Tensor:
    """The tensor where the ranks' engine takes it: nccl on the rank's own GPU."""
    return tensor.cuda() if dist.get_backend() == "nccl" and not tensor.is_cuda else tensor


ALONE = Ranks()


@contextmanager
def joined(device: str = "cpu", ending: Callable[[], None] = lambda: None) -> Iterator[Ranks]:
    """All ranks that torchrun has started, until the block is left; `ALONE` where it has started none.

    Ranks on `device` "cpu" meet over gloo, those on GPUs over nccl, each rank with a GPU of its own. The
    process ends where another rank is stopped for long (dpmacro/parallel/heartbeat.py); `ending` cleans up
    before.

    Raises ValueError where a machine has fewer GPUs than ranks, ConnectionError where the ranks do not meet.
    """
    if int(os.environ.get("WORLD_SIZE", "1")) == 1 or "RANK" not in os.environ:
        yield ALONE
        return
    ranks, here = (
        Ranks(int(os.environ["RANK"]), int(os.environ["WORLD_SIZE"])),
        int(os.environ["LOCAL_RANK"]),
    )
    gpu = torch.device(device).type == "cuda"
    if gpu and here >= torch.cuda.device_count():
        raise ValueError(
            f"{os.environ['LOCAL_WORLD_SIZE']} ranks are on a machine with {torch.cuda.device_count()} GPUs: "
            "give --nproc_per_node=that, or --device=cpu"
        )
    if gpu:
        torch.cuda.set_device(here)
    with ranks._meeting():
        dist.init_process_group("nccl" if gpu else "gloo", timeout=PATIENCE)
    try:
        with heard_of(ranks.rank, ranks.size, ending):
            yield ranks
    finally:
        dist.destroy_process_group()
