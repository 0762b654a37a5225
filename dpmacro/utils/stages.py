"""A long computation that goes on where it was stopped: the results of its stages, and rounds of the next.

<folder>/00007.pt        what the seventh stage returned
<folder>/00008.0002.pt   rounds of the eighth, which was not over

A computation that is begun anew with the same inputs calls the same stages in the same order. Those whose
results are in the folder return them at once; in the one that was running, boosting rounds that are there are
taken as they were found (`Journal`) instead of being searched for. All else is computed once more, and so the
end is that of a computation which nothing stopped, bit for bit.

Of ranks that compute together the leading one keeps the files, and tells the others what is in them.
"""

from collections import deque
from collections.abc import Callable, Iterable
from contextvars import ContextVar, Token
from dataclasses import dataclass
from functools import wraps
from io import BytesIO
from pathlib import Path
from pickle import UnpicklingError
from types import TracebackType
from typing import Any, ParamSpec, TypeVar

import torch
from torch import Tensor

from dpmacro.parallel import ALONE, Ranks
from dpmacro.utils.files import replacing

__all__ = ["Journal", "Stages", "journal", "stage", "storable"]

P = ParamSpec("P")
T = TypeVar("T")

_STORABLE: list[type] = []
_RUNNING: ContextVar["Stages | None"] = ContextVar("stages", default=None)


def storable(kind: type[T]) -> type[T]:
    """Let results of stages hold instances of this class; files with others are refused."""
    _STORABLE.append(kind)
    return kind


def stage(function: Callable[P, T]) -> Callable[P, T]:
    """Make the function a stage where `Stages` are being kept; elsewhere, and in a stage, it just runs.

    Its result, built of tensors, numbers, texts, tuples, lists, dicts and `storable` classes, follows from
    its arguments alone.
    """

    @wraps(function)
    def staged(*args: P.args, **kwargs: P.kwargs) -> T:
        running = _RUNNING.get()
        if running is None:
            return function(*args, **kwargs)
        return running.run(function.__name__, lambda: function(*args, **kwargs))

    return staged


def journal() -> "Journal | None":
    """A journal for one more series of boosting rounds; None outside stages."""
    running = _RUNNING.get()
    return None if running is None or running.rounds is None else running.rounds.begun()


class Stages:
    """Keeps the stages that are called while it is entered.

    Args:
        folder: of their files, made where it does not exist.
        every: rounds after which those of the running stage are written, too; 0 for never.
        ranks: who compute together.

    Raises ValueError while it is entered where a file cannot be read or is that of another computation.
    """

    def __init__(self, folder: Path, every: int, ranks: Ranks = ALONE) -> None:
        if ranks.leads:
            folder.mkdir(parents=True, exist_ok=True)
        self.folder, self.every, self.ranks = folder, every, ranks
        self.rounds: _Rounds | None = None  # of the stage that runs
        self._number = 0
        self._token: Token | None = None

    def __enter__(self) -> "Stages":
        self._token = _RUNNING.set(self)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        assert self._token is not None, "entered"
        _RUNNING.reset(self._token)

    def run(self, name: str, compute: Callable[[], T]) -> T:
        """The result of the next stage, from its file or computed."""
        if self.rounds is not None:
            return compute()
        self._number += 1
        file = self.folder / f"{self._number:05d}.pt"
        stored = self.ranks.told(self._stored(file, name) if self.ranks.leads else None)
        if stored is not None:
            return stored["result"]
        self.rounds = _Rounds(self.folder, self._number, self.every, self.ranks)
        try:
            result = compute()
            if self.ranks.leads:
                _write(file, {"stage": name, "result": result})
                self.rounds.remove()
        finally:
            self.rounds = None
        return result

    def _stored(self, file: Path, name: str) -> dict[str, Any] | None:
        """What the file of this stage holds; None where there is none."""
        if not file.exists():
            return None
        stored = _read(file)
        if not isinstance(stored, dict) or stored.get("stage") != name:
            raise ValueError(
                f"{file} is of another computation than {name}: the run was begun by another version of "
                "dpmacro, so begin anew in another --output_dir"
            )
        return stored


@dataclass(frozen=True)
class _Record:
    """A round, and the generator after it."""

    hypotheses: Any
    generator: Tensor
    free: bool  # whether the next round can begin without the learner's memory of this one


class _Rounds:
    """The rounds of one stage, of one series after another."""

    def __init__(self, folder: Path, number: int, every: int, ranks: Ranks) -> None:
        self._folder, self._number, self._every = folder, number, every if ranks.leads else 0
        self._series = 0
        self._known: dict[int, dict[int, _Record]] = {}
        self._new: list[tuple[int, int, _Record]] = []
        rows = [row for file in self._files() for row in _read(file)] if ranks.leads else []
        for series, place, *record in ranks.told(rows):
            self._known.setdefault(series, {})[place] = _Record(*record)

    def begun(self) -> "Journal":
        """The journal of the next series."""
        self._series += 1
        known = self._known.pop(self._series, {})
        usable = len(known)
        while not self._known and usable and not known[usable - 1].free:
            usable -= 1  # the last series goes on where no memory is needed
        return Journal(self, self._series, [known[place] for place in range(usable)])

    def note(self, series: int, place: int, record: _Record) -> None:
        """Keep a round, in a file once there are enough."""
        if self._every == 0:
            return
        self._new.append((series, place, record))
        if len(self._new) >= self._every:
            rows = [(*where, one.hypotheses, one.generator, one.free) for *where, one in self._new]
            _write(self._folder / f"{self._number:05d}.{len(self._files()):04d}.pt", rows)
            self._new.clear()

    def remove(self) -> None:
        """Remove the files: the stage is over."""
        for file in self._files():
            file.unlink()

    def _files(self) -> list[Path]:
        return sorted(self._folder.glob(f"{self._number:05d}.*.pt"))


class Journal:
    """The rounds of one series, those that are known to begin with."""

    def __init__(self, rounds: _Rounds, series: int, known: Iterable[_Record]) -> None:
        self._rounds, self._series, self._known = rounds, series, deque(known)
        self._place = 0

    def known(self, generator: torch.Generator) -> Any:
        """The hypotheses of the next round, the generator as that round left it; None where it is new."""
        if not self._known:
            return None
        record = self._known.popleft()
        self._place += 1
        generator.set_state(record.generator)
        return record.hypotheses

    def note(self, hypotheses: Any, generator: torch.Generator, free: bool) -> None:
        """Keep a round that is new; `free` as in `_Record`."""
        record = _Record(hypotheses, generator.get_state(), free)
        self._rounds.note(self._series, self._place, record)
        self._place += 1


def _write(file: Path, value: Any) -> None:
    whole = BytesIO()
    torch.save(value, whole)  # which, of a file that may not grow, raises an error without its reason
    with replacing(file) as path:
        path.write_bytes(whole.getbuffer())


def _read(file: Path) -> Any:
    try:
        with torch.serialization.safe_globals(_STORABLE):
            return torch.load(file, weights_only=True)
    except (UnpicklingError, RuntimeError, EOFError, KeyError) as error:
        line = " ".join(str(error).split())[:200]
        raise ValueError(
            f"{file} cannot be read ({line}): remove it, and that stage is computed anew"
        ) from error
