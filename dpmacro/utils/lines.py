"""What a script says on standard error: a line for an error, for a warning, and for a thread that failed."""

import sys
import threading
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TextIO

from tqdm import tqdm

from dpmacro.utils.files import NO_SPACE

__all__ = ["in_a_line", "say", "threads_in_a_line", "warnings_in_a_line"]

EVENTS = "TensorBoard's events"  # what threads write that name no file
WORD, LINE = 300, 1400  # letters of a word, and of a line, at most
PACKAGE = Path(__file__).resolve().parents[1]


def in_a_line(error: ValueError | OSError) -> str:
    """What went wrong in one line; the remedy of a full disk, where a part of the package gave none."""
    text = str(error)
    if isinstance(error, OSError) and error.errno in NO_SPACE:
        place = error.filename or "a file"
        text = f"{place}: cannot be written ({error.strerror}); free some space there and run it again"
    line = " ".join(_shortened(word, WORD) for word in text.split())
    line = "".join(letter if letter.isprintable() else repr(letter)[1:-1] for letter in line)
    return _shortened(line, LINE)


def say(line: str) -> None:
    """Write a line to standard error; progress bars are cleared for it and drawn again below."""
    tqdm.write(line, file=sys.stderr)


def _shortened(text: str, letters: int) -> str:
    """Of a text that is longer, the two ends."""
    return text if len(text) <= letters else f"{text[: letters // 2]}…{text[-letters // 2 :]}"


@contextmanager
def warnings_in_a_line(script: str) -> Iterator[None]:
    """A warning that the package or the script raises is a line on stderr; others stay as they are."""
    with warnings.catch_warnings():
        show_others = warnings.showwarning

        def show(
            message: Warning | str,
            category: type[Warning],
            filename: str,
            lineno: int,
            file: TextIO | None = None,
            line: str | None = None,
        ) -> None:
            own = filename == script or PACKAGE in Path(filename).resolve().parents
            if own and issubclass(category, (UserWarning, RuntimeWarning)):
                say(f"warning: {' '.join(str(message).split())}")
            else:
                show_others(message, category, filename, lineno, file, line)

        warnings.showwarning = show
        yield


@contextmanager
def threads_in_a_line() -> Iterator[None]:
    """A thread that ends for lack of space says so in a line; a bug in one keeps its traceback.

    A thread that keeps its error in `exception`, as TensorBoard's does, hands it to those it works for.
    """
    show_others = threading.excepthook

    def show(arguments: threading.ExceptHookArgs) -> None:
        error = arguments.exc_value
        if isinstance(error, OSError) and getattr(arguments.thread, "exception", None) is error:
            return
        if isinstance(error, OSError) and error.errno in NO_SPACE:
            event = error if error.filename else OSError(error.errno, error.strerror, EVENTS)
            say(f"warning: {in_a_line(event)}")
        else:
            show_others(arguments)

    threading.excepthook = show
    try:
        yield
    finally:
        threading.excepthook = show_others
