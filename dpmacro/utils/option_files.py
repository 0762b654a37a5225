"""The options that a dataclass has, by their names, and which of a file's are none of them."""

import difflib
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields, is_dataclass
from pathlib import Path
from types import UnionType
from typing import Any, Union, get_args, get_origin, get_type_hints

__all__ = [
    "OTHERS",
    "check_known",
    "option_types",
    "paths_as_text",
    "refuse_groups_beside_options",
    "refuse_truths_as_numbers",
]

OTHERS = "OTHERS"  # of a group of options
QUOTES = ("'", '"')
TRUTHS = ("true", "false", "yes", "no", "on", "off")  # of YAML


def option_types(config_class: type, above: str = "") -> dict[str, Any]:
    """The type of every option, by its name as a command line has it, without dashes."""
    found: dict[str, Any] = {}
    hints = get_type_hints(config_class)
    for one in fields(config_class):
        kind = hints[one.name]
        if isinstance(kind, type) and is_dataclass(kind):
            found |= option_types(kind, f"{above}{one.name}.")
        else:
            found[f"{above}{one.name.rstrip('_')}"] = kind
    return found


def check_known(config_class: type, values: Mapping[str, Any], path: str) -> None:
    """Raise ValueError, one line, for a name in a file of options that is no option of the dataclass."""
    for group, name, owner in _unknown(config_class, values, ""):
        known = [one.name for one in fields(owner)]
        near = difflib.get_close_matches(name, known, n=1)
        if hasattr(owner, OTHERS):
            remedy = f"give it within {group}{getattr(owner, OTHERS)}"
        elif near:
            remedy = f"did you mean {group}{near[0]}?"
        else:
            remedy = f"remove it; there are {', '.join(f'{group}{one}' for one in known)}"
        raise ValueError(f"--config_path={path} holds {group}{name}, which is no option: {remedy}")


def paths_as_text(arguments: Sequence[str], config_class: type) -> list[str]:
    """The arguments, values of paths in quotes: a folder may be called 007, true or [1]."""
    kinds = option_types(config_class)
    names = {f"--{name}" for name, kind in kinds.items() if Path in (kind, *get_args(kind))}
    quoted: list[str] = []
    for place, argument in enumerate(arguments):
        option, given, value = argument.partition("=")
        if given and option in names:
            quoted.append(f"{option}={_quoted(value)}")
        elif place and arguments[place - 1] in names and not argument.startswith("--"):
            quoted.append(_quoted(argument))
        else:
            quoted.append(argument)
    return quoted


def refuse_truths_as_numbers(arguments: Sequence[str], config_class: type) -> None:
    """Raise ValueError for --seed=true, which would be 1."""
    kinds = option_types(config_class)
    numbers = {f"--{name}" for name, kind in kinds.items() if _members(kind) & {int, float}}
    for place, argument in enumerate(arguments):
        option, given, value = argument.partition("=")
        if not given and place and arguments[place - 1] in numbers:
            option, value = arguments[place - 1], argument
        if option in numbers and value.strip().lower() in TRUTHS:
            raise ValueError(f"{option}={value} is no number: give one, or leave it out")


def refuse_groups_beside_options(arguments: Sequence[str], config_class: type) -> None:
    """Raise ValueError where a group of options is given as a whole, and one of its options as well."""
    given = [argument.partition("=")[0] for argument in arguments if argument.startswith("--")]
    for group in {name.rpartition(".")[0] for name in option_types(config_class)} - {""}:
        inner = [name for name in given if name.startswith(f"--{group}.")]
        if f"--{group}" in given and inner:
            raise ValueError(f"--{group} is given beside {inner[0]}: give the options of {group} one by one")


def _members(kind: Any) -> set[Any]:
    """The types that a value of this type may have."""
    return set(get_args(kind)) if get_args(kind) and get_origin(kind) in (Union, UnionType) else {kind}


def _quoted(value: str) -> str:
    """A text as YAML reads it back; without a change where that is done already, and null for no path."""
    if value == "null" or (len(value) > 1 and value[0] in QUOTES and value[-1] == value[0]):
        return value
    return json.dumps(value)


def _unknown(config_class: type, values: Mapping[str, Any], above: str) -> Iterator[tuple[str, str, type]]:
    """Groups and names of what is no option, with the group's class."""
    hints = get_type_hints(config_class)
    known = {one.name for one in fields(config_class)}
    for name, value in values.items():
        if name not in known:
            yield above, str(name), config_class
            continue
        kind = hints[name]
        if isinstance(kind, type) and is_dataclass(kind) and isinstance(value, Mapping):
            yield from _unknown(kind, value, f"{above}{name}.")
