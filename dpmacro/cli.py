"""The scripts' front door: options in, one line and exit status 2 for a user's mistake.

Options are LeRobot's own kind (draccus): ``--group.field=value`` for every field of a dataclass,
``--config_path=file.json`` for a whole file of them, later flags overriding it.
"""

import difflib
import sys
from collections.abc import Callable, Sequence
from typing import NoReturn, TypeVar

from draccus.argparsing import ArgumentParser
from draccus.utils import DecodingError, DraccusException

Config = TypeVar("Config")

USAGE_ERROR = 2
INTERRUPTED = 130


def parse(config_class: type[Config], arguments: Sequence[str] | None = None) -> Config:
    """The options on the command line (or in `arguments`) as a validated `config_class`.

    Raises ValueError with one line for an unknown option, an unreadable value, or a value that the
    dataclass itself refuses.
    """
    arguments = sys.argv[1:] if arguments is None else list(arguments)
    parser: ArgumentParser = ArgumentParser(config_class, allow_abbrev=False)

    def fail(message: str) -> NoReturn:
        raise ValueError(_with_suggestion(message, parser))

    parser.parser.error = fail
    try:
        return parser.parse_args(arguments)
    except (DraccusException, DecodingError) as error:
        raise ValueError(_root_message(error)) from error


def run(main: Callable[[Config], None], config_class: type[Config]) -> None:
    """Parse the options, call `main`, and turn a user's mistake into one line and exit status 2.

    A mistake is a ValueError or an OSError; anything else is a bug and keeps its traceback.
    """
    try:
        main(parse(config_class))
    except (ValueError, OSError) as error:
        line = " ".join(str(error).split())
        print(f"error: {line}", file=sys.stderr)
        sys.exit(USAGE_ERROR)
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        sys.exit(INTERRUPTED)


def _root_message(error: BaseException) -> str:
    """The message of the ValueError that a dataclass raised, where draccus wrapped one up."""
    cause: BaseException | None = None if isinstance(error, DecodingError) else error
    while cause is not None:
        if isinstance(cause, ValueError) and not isinstance(cause, DraccusException):
            return str(cause)
        cause = cause.__cause__ or cause.__context__
    return str(error)


def _with_suggestion(message: str, parser: ArgumentParser) -> str:
    """`unrecognized arguments: --episode=3` with the nearest option that exists."""
    known = [option for action in parser.parser._actions for option in action.option_strings]
    if not message.startswith("unrecognized arguments"):
        return message
    given = message.split(": ", 1)[1].split()[0].split("=")[0]
    near = difflib.get_close_matches(given, known, n=1)
    remedy = f"did you mean {near[0]}?" if near else "see --help for the options there are"
    return f"unknown option {given}: {remedy}"
