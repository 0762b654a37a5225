"""What sets the frames of a stage apart: dimensions of actions and states, and actions that are classes.

Deviations are in standard deviations of all frames: the mean over a stage's frames, less the mean over all
frames, divided by the deviation of all frames. Numbers that are not finite count nowhere.
"""

import unicodedata
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import groupby

import numpy as np
from jaxtyping import Float, Int, Num

from dpmacro.data.demonstrations import Demonstrations
from dpmacro.data.vectors import EPSILON

__all__ = ["Trait", "plain", "traits"]

TELLING = 0.1  # standard deviations below which nothing sets a stage apart
DIGITS = 6  # of a deviation: the order in which frames are added up changes those after them
SPAN = 0.25  # seconds on either side of a frame between which a dimension's change is taken


@dataclass(frozen=True)
class Trait:
    """One thing that sets the frames of a stage apart.

    Attributes:
        name: of a dimension or a class, in one line; "action 3" where the data names none.
        verb: what it does, always true of the mean over the stage's frames: "rises", "falls", "high" or "low"
            after a dimension's name, "mostly" or "more" before that of a class.
        deviation: in standard deviations of all frames, `TELLING` or more off 0.
        reason: a sentence with the numbers.
    """

    name: str
    verb: str
    deviation: float
    reason: str

    @property
    def first(self) -> bool:
        """Whether the verb stands before the name."""
        return self.verb in ("mostly", "more")


@dataclass(frozen=True)
class Vectors:
    """The numbers of a feature, or how they change, with their names and what they are of."""

    values: Num[np.ndarray, "frames dims"]
    names: tuple[str, ...]
    what: str  # "action" or "state"


def traits(
    demonstrations: Demonstrations, labels: Int[np.ndarray, " frames"], stages: int
) -> list[list[Trait]]:
    """What sets the frames of every stage apart, the most telling first; [] where nothing does.

    Classes of actions come before everything else, then the dimensions of actions and states: how high they
    are, and of states, or of actions where there are no states, how they change. The order in which
    demonstrations stand changes nothing.

    Args:
        demonstrations: what was seen and done.
        labels: stage of every frame, 0..stages-1.
        stages: how many there are; some may have no frames.
    """
    found: list[list[Trait]] = [[] for _ in range(stages)]
    seen = [
        Vectors(values, _names(demonstrations.state_names.get(key, ()), values.shape[1], _last(key)), "state")
        for key, values in demonstrations.observations.items()
        if values.ndim == 2
    ]
    done: list[Vectors] = []
    if demonstrations.vector:
        actions = demonstrations.actions
        done.append(
            Vectors(actions, _names(demonstrations.action_names, actions.shape[1], "action"), "action")
        )
    else:
        for stage, own in enumerate(_classes(demonstrations, labels, stages)):
            found[stage] += own
    parts = []
    for one in seen or done:
        moving = _changes(one.values, demonstrations.lengths, demonstrations.fps)
        parts.append(_dimensions(replace(one, values=moving), labels, stages, True))
    parts += [_dimensions(one, labels, stages, False) for one in (*done, *seen)]
    for stage, own in enumerate(found):
        own += sorted((one for part in parts for one in part[stage]), key=lambda one: -abs(one.deviation))
    return [[next(same) for _, same in groupby(own, lambda one: (one.name, one.verb))] for own in found]


def plain(text: str) -> str:
    """A text in one line of characters that can be seen, those with accents in one way."""
    shown = (one if one.isprintable() else " " for one in unicodedata.normalize("NFC", text))
    return " ".join("".join(shown).split())


def _last(key: str) -> str:
    """The last part of a feature's name."""
    return plain(key.rsplit(".", 1)[-1]) or "state"


def _names(names: Sequence[str], count: int, what: str) -> tuple[str, ...]:
    """Names of dimensions in one line; with what they are of where they are numbers, or missing."""
    given = [plain(name) for name in names] if len(names) == count else [""] * count
    return tuple(
        f"{what} {name or k}" if not name or name.isdecimal() else name for k, name in enumerate(given)
    )


def _classes(
    demonstrations: Demonstrations, labels: Int[np.ndarray, " frames"], stages: int
) -> Iterator[list[Trait]]:
    """The actions that each stage has more of than all frames, the most telling first."""
    count = max(len(demonstrations.action_names), int(demonstrations.actions.max()) + 1)
    names = _names(demonstrations.action_names, count, "action")
    overall = np.bincount(demonstrations.actions, minlength=count) / len(labels)
    spread = np.sqrt(overall * (1 - overall))
    for stage in range(stages):
        held = labels == stage
        shares = np.bincount(demonstrations.actions[held], minlength=count) / max(int(held.sum()), 1)
        deviations = np.round((shares - overall) / np.where(spread > 0, spread, np.inf), DIGITS)
        yield [
            Trait(
                names[action],
                "mostly" if shares[action] > 0.5 else "more",
                float(deviations[action]),
                f"Of its actions {shares[action]:.0%} are {names[action]}, of all {overall[action]:.0%}.",
            )
            for action in np.argsort(-deviations, kind="stable").tolist()
            if deviations[action] >= TELLING
        ]


def _dimensions(
    vectors: Vectors, labels: Int[np.ndarray, " frames"], stages: int, changes: bool
) -> list[list[Trait]]:
    """What sets every stage apart in these dimensions, or in how they change."""
    names, what = vectors.names, vectors.what
    means, deviations = _deviations(vectors.values, labels, stages)
    found: list[list[Trait]] = [[] for _ in range(stages)]
    for stage, dim in np.argwhere(np.abs(deviations) >= TELLING).tolist():
        off, up = float(deviations[stage, dim]), bool(deviations[stage, dim] > 0)
        if changes and (means[stage, dim] if up else -means[stage, dim]) < TELLING:
            continue  # it falls less than elsewhere, say: no word for that is short
        verbs = ("falls", "rises") if changes else ("low", "high")
        of = names[dim] if names[dim].startswith(f"{what} ") else f"{what} {names[dim]}"
        reason = (
            f"The mean {'change ' if changes else ''}of {of} is {abs(off):.1f} standard deviations "
            f"{'above' if up else 'below'} that of all frames."
        )
        found[stage].append(Trait(names[dim], verbs[up], off, reason))
    return found


def _deviations(
    values: Num[np.ndarray, "frames dims"], labels: Int[np.ndarray, " frames"], stages: int
) -> tuple[Float[np.ndarray, "stages dims"], Float[np.ndarray, "stages dims"]]:
    """Mean of every dimension over each stage, and how far that is off the mean over all frames.

    Both in standard deviations of all frames; 0 where nothing is known, or a dimension is constant.
    """
    known = np.isfinite(values)
    size = np.abs(values, where=known, out=np.zeros(values.shape)).max(0, initial=0)
    scaled = np.divide(values, size, where=known & (size > 0), out=np.zeros(values.shape))
    counts = np.maximum(known.sum(0), 1)
    mean = scaled.sum(0) / counts
    centred = np.where(known, scaled - mean, 0)
    spread = np.sqrt((centred**2).sum(0) / counts)
    varies = spread > EPSILON
    means, deviations = np.zeros((2, stages, values.shape[1]))
    for stage in range(stages):
        held = labels == stage
        shown = known[held].sum(0)
        unit = np.maximum(shown, 1) * np.where(varies, spread, np.inf)
        means[stage], deviations[stage] = scaled[held].sum(0) / unit, centred[held].sum(0) / unit
    return means.round(DIGITS), deviations.round(DIGITS)


def _changes(
    values: Num[np.ndarray, "frames dims"], lengths: Int[np.ndarray, " demonstrations"], fps: int | float
) -> Float[np.ndarray, "frames dims"]:
    """Change a frame around every frame, over `SPAN` on either side or what its demonstration has of it."""
    reach = max(round(fps * SPAN), 1)
    ends = np.repeat(np.cumsum(lengths), lengths)
    starts, frames = ends - np.repeat(lengths, lengths), np.arange(len(values))
    last, first = np.minimum(frames + reach, ends - 1), np.maximum(frames - reach, starts)
    wide = values.astype(np.float64)
    with np.errstate(invalid="ignore"):  # infinite less infinite is no number
        return (wide[last] - wide[first]) / np.maximum(last - first, 1)[:, None]
