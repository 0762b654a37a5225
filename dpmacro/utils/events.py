"""TensorBoard's events of a run that goes on where they cannot be written: nothing else depends on them."""

import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from torch.utils.tensorboard import SummaryWriter

__all__ = ["Events", "doing_without"]


@contextmanager
def doing_without(folder: Path) -> Iterator[None]:
    """Where the file system does not let events be written in the block, a warning says so in one line.

    Args:
        folder: of the events.
    """
    try:
        yield
    except OSError as error:
        _warn(folder, error)


class Events(SummaryWriter):
    """A writer of events that gives up, with one warning, where the file system does not take them.

    Events that were written until then stay; those that come later are dropped.

    Args:
        folder: of the events, made where it does not exist.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._lost = False
        self._attempt(super().__init__, str(folder))

    def add_scalar(self, *given: Any, **options: Any) -> None:
        """As `SummaryWriter.add_scalar`."""
        self._attempt(super().add_scalar, *given, **options)

    def add_text(self, *given: Any, **options: Any) -> None:
        """As `SummaryWriter.add_text`."""
        self._attempt(super().add_text, *given, **options)

    def add_image(self, *given: Any, **options: Any) -> None:
        """As `SummaryWriter.add_image`."""
        self._attempt(super().add_image, *given, **options)

    def close(self) -> None:
        """Write what is waiting, and close the file."""
        self._attempt(super().close)

    def _attempt(self, act: Callable[..., None], *given: Any, **options: Any) -> None:
        if self._lost:
            return
        try:
            act(*given, **options)
        except OSError as error:
            self._lost = True
            _warn(self._folder, error)
            with suppress(OSError):  # what was waiting is lost, too
                super().close()


def _warn(folder: Path, error: OSError) -> None:
    warnings.warn(
        f"{folder}: TensorBoard's events cannot be written ({error.strerror or error}); nothing else depends "
        "on them, and the run goes on without; free some space there for those to come",
        stacklevel=1,  # a line on its own, and one alone, wherever it happens again
    )
