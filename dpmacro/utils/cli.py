"""The scripts' command lines: options as dataclasses, and one line and exit status 2 for a user's mistake.

Options are LeRobot's own kind (draccus): ``--group.field=value`` for every field of a dataclass,
``--config_path=file.json`` for a whole file of them, later flags overriding it. A group whose class names a
field in `OTHERS` takes options of any name as well. A field that ends in an underscore is given without it.
"""

import difflib
import inspect
import os
import re
import signal
import sys
import time
from argparse import ArgumentParser as Argparse
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import Field, fields, replace
from pathlib import Path
from typing import Any, NoReturn, TypeVar

from draccus import cfgparsing
from draccus.argparsing import ArgumentParser
from draccus.parsers.decoding import decode
from draccus.utils import DecodingError, DraccusException
from draccus.wrappers.docstring import get_attribute_docstring
from yaml import YAMLError

from dpmacro.utils import interrupts, starting
from dpmacro.utils.lines import in_a_line, say, threads_in_a_line, warnings_in_a_line
from dpmacro.utils.option_files import (
    OTHERS,
    check_known,
    paths_as_text,
    refuse_groups_beside_options,
    refuse_truths_as_numbers,
)
from dpmacro.utils.starting import INTERRUPTED

__all__ = ["hold", "parse", "run", "sentence_of"]

Config = TypeVar("Config")
Result = TypeVar("Result")

USAGE_ERROR = 2
SAYING = 10.0  # seconds that the first of several ranks has to say what is wrong
SIGNALLED = 128  # and the number of a signal: the exit status of a process that it ended
EXPONENT = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)[eE][-+]?\d+")
UNFIT = re.compile(r"`(?P<name>[^`]*)`: Failed when parsing value='?(?P<value>.*?)'? into field ", re.DOTALL)
BARE_LIST = re.compile(r"input for a list type|Expected \d+ items|has no len\(\)")


class _PathError(ValueError):
    """A path that cannot be one."""


def _path(value: Any, path: Sequence[str] = ()) -> Path:
    """A path, also one that reads like a number or a date; a shell leaves the ~ of --root=~/x to us."""
    name = ".".join(path)
    if isinstance(value, bool | list | dict):
        raise _PathError(f"{name} is {value}: give a path")
    if str(value) == "":
        raise _PathError(f"{name} is empty: give a path, like ./ for this folder, or leave it out")
    return Path(str(value)).expanduser()


decode.register(Path, _path)


def parse(config_class: type[Config], arguments: Sequence[str] | None = None) -> Config:
    """The options on the command line (or in `arguments`) as a validated `config_class`.

    Raises ValueError with one line for an unknown option, an unreadable value, or a value that the
    dataclass itself refuses.
    """
    arguments = sys.argv[1:] if arguments is None else list(arguments)
    arguments = [re.sub("^--config_path=~(?=/|$)", f"--config_path={Path.home()}", one) for one in arguments]
    parser: ArgumentParser = ArgumentParser(config_class, allow_abbrev=False)
    _drop_underscores(parser)

    def fail(message: str) -> NoReturn:
        raise ValueError(_with_suggestion(message, parser))

    parser.parser.error = fail
    refuse_groups_beside_options(arguments, config_class)
    refuse_truths_as_numbers(arguments, config_class)
    arguments = paths_as_text(arguments, config_class)
    file = _check_readable(arguments, config_class)
    arguments, others = _apart(arguments, config_class, parser)
    try:
        return _with_others(parser.parse_args(arguments), others)
    except (DraccusException, DecodingError) as error:
        raise ValueError(_root_message(error, arguments, file)) from error


def sentence_of(config_class: type, option: Field) -> dict[str, Any]:
    """Metadata that gives a field of another class the sentence that this field of `config_class` has."""
    return {"custom_args": {"help": get_attribute_docstring(config_class, option.name).docstring_below}}


def run(main: Callable[[Config], None], config_class: type[Config]) -> None:
    """Parse the options, call `main`, and turn a user's mistake into one line and exit status 2.

    A mistake is a ValueError or an OSError; anything else is a bug and keeps its traceback. A UserWarning or
    RuntimeWarning of this package, or of `main`'s own file, becomes one line as well. Ctrl-C, and signals
    that end a process, unwind `main` and become a line and the exit status that shells give.
    """
    try:
        with interrupts.terminating(), warnings_in_a_line(inspect.getfile(main)), threads_in_a_line():
            if signal.getsignal(signal.SIGINT) is starting.end:
                signal.signal(signal.SIGINT, signal.default_int_handler)
            with _holding():
                main(parse(config_class))
    except (ValueError, OSError) as error:
        if os.environ.get("RANK", "0") == "0" or isinstance(error, ConnectionError):
            say(f"error: {in_a_line(error)}")  # once, where torchrun has started several
        else:
            time.sleep(SAYING)  # torchrun ends the others once one has ended, and the first has to say it
        sys.exit(USAGE_ERROR)
    except interrupts.Terminated as error:
        say(f"ended by {error}")
        sys.exit(SIGNALLED + error.number)
    except KeyboardInterrupt:
        say("interrupted")
        sys.exit(INTERRUPTED)


def hold(context: AbstractContextManager[Result]) -> Result:
    """Enter a context that `run` leaves after its `main`, whatever ends that."""
    if not _held:
        raise RuntimeError("nothing is run: call this within the `main` that is given to `run`")
    return _held[-1].enter_context(context)


_held: list[ExitStack] = []


@contextmanager
def _holding() -> Iterator[None]:
    with ExitStack() as stack:
        _held.append(stack)
        try:
            yield
        finally:
            _held.remove(stack)


def _drop_underscores(parser: ArgumentParser) -> None:
    """`--world.import_`, whose field may not be called as a word of Python, becomes `--world.import`."""
    known = parser.parser._option_string_actions
    for action in parser.parser._actions:
        for name in [name for name in action.option_strings if name.endswith("_")]:
            action.option_strings[action.option_strings.index(name)] = name.rstrip("_")
            known[name.rstrip("_")] = known.pop(name)


def _apart(
    arguments: Sequence[str], config_class: type, parser: ArgumentParser
) -> tuple[list[str], dict[str, dict[str, Any]]]:
    """The arguments that are listed, and the others of groups that take any, as values by group and name.

    A group takes any where its class names the field for them, a mapping, in `OTHERS`.
    """
    known = parser.parser._option_string_actions
    taking = {one.name for one in fields(config_class) if hasattr(one.type, OTHERS)}
    listed: list[str] = []
    others: dict[str, dict[str, Any]] = {}
    waiting = list(arguments)
    while waiting:
        argument = waiting.pop(0)
        option, given, value = argument.partition("=")
        group, _, name = option.removeprefix("--").partition(".")
        if not option.startswith("--") or group not in taking or option in known or not name:
            listed.append(argument)
            continue
        if not given:
            if not waiting or waiting[0].startswith("--"):
                raise ValueError(f"{option} has no value: give one, like {option}=1")
            value = waiting.pop(0)
        others.setdefault(group, {})[name] = _value(value)
    return listed, others


def _value(text: str) -> Any:
    """What YAML makes of a text; also of a number like 1e-3, which YAML wants a point in."""
    return float(text) if EXPONENT.fullmatch(text) else cfgparsing.parse_string(text)


def _with_others(config: Config, others: dict[str, dict[str, Any]]) -> Config:
    made: Any = config
    for group, given in others.items():
        own = getattr(made, group)
        name = getattr(own, OTHERS)
        made = replace(made, **{group: replace(own, **{name: {**getattr(own, name), **given}})})
    return made


def _check_readable(arguments: Sequence[str], config_class: type) -> str | None:
    """The path of a file of options, if one is given.

    Raises ValueError for a value, or a file of options, that is not written as YAML or JSON is, and for a
    file that holds what is no option.
    """
    for argument in arguments:
        value = argument.partition("=")[2] if argument.startswith("--") else argument
        try:
            cfgparsing.parse_string(value)
        except (YAMLError, ValueError, DraccusException) as error:  # ValueError: a day that no month has
            raise ValueError(
                f"{argument} cannot be read ({_problem(error)}): close brackets and quotes, and put a text "
                "with special characters into quotes of its own"
            ) from error
    files = Argparse(add_help=False, allow_abbrev=False)
    files.add_argument("--config_path", nargs="?")
    path = files.parse_known_args(arguments)[0].config_path
    if path is None:
        return None
    try:
        with Path(path).open() as file:
            found = cfgparsing.load_config(file, file=path)
    except (YAMLError, ValueError, DraccusException) as error:
        raise ValueError(
            f"--config_path={path} cannot be read ({_problem(error)}): give a JSON file"
        ) from error
    if not isinstance(found, dict):
        raise ValueError(
            f"--config_path={path} holds a {type(found).__name__}, no options: give a run's train_config.json"
        )
    check_known(config_class, found, path)
    return path


def _problem(error: BaseException) -> str:
    """What is wrong, without the text that it is wrong in; draccus from 0.11 on wraps it up."""
    while error.__cause__ is not None:
        error = error.__cause__
    return str(getattr(error, "problem", None) or error)


def _root_message(error: BaseException, arguments: Sequence[str], file: str | None) -> str:
    """The message of the ValueError that a dataclass raised, where draccus wrapped one up.

    Of a value that cannot be read the option and, where no argument gives it, the file.
    """
    if BARE_LIST.search(str(error)):
        return f"{str(error).strip()}; write it in brackets, like '[0,1,2]'"
    cause: BaseException | None = error
    while cause is not None:
        own = not isinstance(cause, DraccusException | DecodingError)
        if isinstance(cause, _PathError) or (
            isinstance(cause, ValueError) and own and not isinstance(error, DecodingError)
        ):
            return str(cause)
        cause = cause.__cause__ or cause.__context__
    message = str(error)
    if found := UNFIT.match(message):
        message = f"`{found['name']}`: {found['value']} is nothing that it can be, see --help"
    name = message.partition("`")[2].partition("`")[0]
    if file is not None and name and not any(one.startswith(f"--{name}") for one in arguments):
        message = f"--config_path={file}: {message}"
    return message


def _with_suggestion(message: str, parser: ArgumentParser) -> str:
    """`unrecognized arguments: --episode=3` with the nearest option that exists."""
    known = [option for action in parser.parser._actions for option in action.option_strings]
    if not message.startswith("unrecognized arguments"):
        return message
    given = message.split(": ", 1)[1].split()[0].split("=")[0]
    near = difflib.get_close_matches(given, known, n=1)
    remedy = f"did you mean {near[0]}?" if near else "see --help for the options there are"
    return f"unknown option {given}: {remedy}"
