"""Names of stages: those that the data gives, each with its reason, or those that a user gives."""

import unicodedata
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Int

from dpmacro.annotation.telling import Trait, plain, traits
from dpmacro.data.demonstrations import Demonstrations
from dpmacro.utils.checks import shown

__all__ = ["LONGEST_NAME", "StageName", "checked_names", "stage_names"]

LONGEST = 40  # characters of a name that the data gives
LONGEST_NAME = 80  # of one that a person gives
CUT = "…"


@dataclass(frozen=True)
class StageName:
    """What a stage is called and why."""

    name: str
    reason: str  # a sentence


def stage_names(
    demonstrations: Demonstrations,
    labels: Int[np.ndarray, " frames"],
    stages: int,
    names: Sequence[str] | None = None,
) -> tuple[StageName, ...]:
    """Names of the stages, distinct and of `LONGEST` characters at most, each with its reason.

    A stage is called by what sets its frames apart most: "gripper rises" where that dimension goes up in it,
    "shoulder low", "mostly turn left" (more than half of its actions), "more turn left". Nothing is said that
    the numbers do not say: whether a gripper that rises opens or closes, they do not. Where two would have
    the same name a second thing is named, and where that is the same, too, they get numbers. A single stage
    has the words of the task. The order of demonstrations changes nothing.

    Args:
        demonstrations: what was segmented.
        labels: stage of every frame, 0..stages-1.
        stages: how many there are; one without frames is called so.
        names: the user's own, used as they are.

    Raises ValueError naming the one of `names` that cannot be used.
    """
    if names is not None:
        return tuple(StageName(name, "The user gave it.") for name in checked_names(names, stages))
    if stages == 1:
        return (_whole(demonstrations),)
    found = traits(demonstrations, labels, stages)
    counts = np.bincount(labels, minlength=stages)
    named = [
        _named(own[:1], stage, bool(count))
        for stage, (own, count) in enumerate(zip(found, counts, strict=True))
    ]
    repeated = {name for name, count in Counter(one.name for one in named).items() if count > 1}
    for name in repeated:
        group = [stage for stage, one in enumerate(named) if one.name == name]
        for stage in group:
            others = {(one.name, one.verb) for other in group if other != stage for one in found[other]}
            second = [one for one in found[stage][1:] if (one.name, one.verb) not in others]
            if second:
                named[stage] = _named([found[stage][0], second[0]], stage, True)
    return _numbered(named)


def checked_names(names: Any, count: int | None = None, what: str = "names") -> tuple[str, ...]:
    """Names of stages that a person gave, as they are.

    Args:
        names: what should be a list of distinct texts that are not empty, of `LONGEST_NAME` characters at
            most, without control characters and the like, or spaces at their ends.
        count: how many there have to be.
        what: how messages call them.

    Raises ValueError naming the first that is not so.
    """
    if isinstance(names, str) or not isinstance(names, Sequence):
        raise ValueError(f"{what} are {shown(names)}: give a list of texts")
    if count is not None and len(names) != count:
        raise ValueError(
            f"{what} are {len(names)} ({shown(list(names))}) for {count} stages: give one for each stage"
        )
    known: dict[str, int] = {}
    for place, name in enumerate(names):
        where = f"{what}[{place}] is {shown(name)}"
        if not isinstance(name, str):
            raise ValueError(f"{where}: give a text")
        if not name.strip():
            raise ValueError(f"{where}: a name needs a character that can be seen")
        wrong = [one for one in name if not one.isprintable()]
        if wrong:
            raise ValueError(f"{where}, with {wrong[0]!a}, which nobody can see: leave it out")
        if name != name.strip():
            raise ValueError(f"{where}: leave out the spaces at its ends")
        if len(name) > LONGEST_NAME:
            raise ValueError(f"{where}, of {len(name)} characters: give {LONGEST_NAME} at most")
        same = known.setdefault(unicodedata.normalize("NFC", name), place)
        if same != place:
            raise ValueError(f"{where}, as {what}[{same}] is: give every stage a name of its own")
    return tuple(names)


def _whole(demonstrations: Demonstrations) -> StageName:
    """The name of a stage that is everything."""
    tasks = [plain(words) for words in dict.fromkeys(demonstrations.tasks)]
    if len(tasks) == 1 and tasks[0] and not tasks[0].isdecimal():
        return StageName(_cut_end(tasks[0], LONGEST), "There is one stage: it has the words of the task.")
    return StageName("whole demonstration", "There is one stage.")


def _named(own: Sequence[Trait], stage: int, used: bool) -> StageName:
    if not used:
        return StageName("no frames", "It holds no frame.")
    if not own:
        reason = "No dimension and no action of its frames is far from that of all frames."
        return StageName(f"stage {stage}", reason)
    room = LONGEST - 2 * (len(own) - 1) - sum(len(one.verb) + 1 for one in own)
    parts = []
    for left, one in zip(range(len(own), 0, -1), sorted(own, key=lambda one: len(one.name)), strict=True):
        name = _cut_middle(one.name, room // left)  # what a short name leaves is for the long one
        room -= len(name)
        parts.append((own.index(one), f"{one.verb} {name}" if one.first else f"{name} {one.verb}"))
    text = ", ".join(part for _, part in sorted(parts))
    return StageName(text, " ".join(one.reason for one in own))


def _numbered(named: Sequence[StageName]) -> tuple[StageName, ...]:
    """The names, a number after those that an earlier stage has, too."""
    taken, result = {one.name for one in named}, []
    given: set[str] = set()
    for one in named:
        name, number = one.name, 1
        while name in given or (number > 1 and name in taken):
            number += 1
            name = f"{_cut_end(one.name, LONGEST - len(f' {number}'))} {number}"
        given.add(name)
        more = " The number tells it from another stage of that name." if number > 1 else ""
        result.append(StageName(name, one.reason + more))
    return tuple(result)


def _cut_end(text: str, room: int) -> str:
    """A text cut to `room` characters, after a word where one ends near there."""
    if len(text) <= room:
        return text
    short = text[: room - 1]
    at_word = short.rsplit(" ", 1)[0] if text[room - 1] != " " else short
    return (at_word if len(at_word) > room // 2 else short).rstrip(" ,;:") + CUT


def _cut_middle(text: str, room: int) -> str:
    """A text cut to `room` characters; names of dimensions differ at their ends."""
    if len(text) <= room:
        return text
    head = (room - 1) // 2
    return text[:head].rstrip() + CUT + text[len(text) - (room - 1 - head) :].lstrip()
