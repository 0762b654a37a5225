"""How many macro-actions? Discoveries with several Q and S, told apart by data that they left out."""

from collections.abc import Sequence
from dataclasses import dataclass

from jaxtyping import Float
from torch import Tensor

from dpmacro.discovery.criteria import equally_good, standard_error
from dpmacro.discovery.result import Discovery

__all__ = ["Choice", "Point", "choose", "points", "searches"]


@dataclass(frozen=True)
class Point:
    """One discovery on the selection chart; one macro-action is the zero of the gain."""

    macros: int
    max_transitions: int
    gain: float  # nats a frame over a single classifier on left-out data; see `points`
    error: float  # its standard error
    runnable: bool  # whether a policy can recognise the changes
    changes: float  # transitions used per trajectory


@dataclass(frozen=True)
class Choice:
    """Discoveries that were compared, and the one to follow."""

    discoveries: tuple[Discovery, ...]
    points: tuple[Point, ...]  # one for every discovery
    place: int | None  # of the discovery to follow; None for one macro-action

    @property
    def discovery(self) -> Discovery | None:
        """The one to follow; None for one macro-action."""
        return None if self.place is None else self.discoveries[self.place]

    @property
    def setting(self) -> tuple[int, int]:
        """Q and S to follow."""
        found = self.discovery
        return (1, 0) if found is None else (found.macros, found.max_transitions)


def searches(
    max_macros: int, max_transitions: int | None, order: str, vectors: bool
) -> list[tuple[int, int]]:
    """Q and S of every search for an open number of macro-actions.

    Of vectors there is one, with most macro-actions, whose result serves for all numbers of them
    (`refinement.fewer`). With S = 2Q - 2 it cuts where one macro-action's own course changes, and policies
    of such segmentations fail (docs/experiments.md).

    Args:
        max_macros: the largest Q.
        max_transitions: S; None for Q - 1, and of classes in a free order 2Q - 2, too.
        order: of macro-actions, "free" or "chain".
        vectors: whether actions are vectors rather than classes.
    """
    numbers = [max_macros] if vectors else range(2, max_macros + 1)
    times = (1,) if vectors or order == "chain" else (1, 2)
    if max_transitions is not None:
        return [(macros, max_transitions) for macros in numbers]
    return [(macros, k * (macros - 1)) for macros in numbers for k in times]


def points(discoveries: Sequence[Discovery]) -> list[Point]:
    """What left-out data says of each discovery.

    The gain is that of a policy which runs the segmentation, where any discovery found one that can be run;
    else that of labels which the frames around tell. The two are never compared with one another.
    """
    found = []
    for one, loss in zip(discoveries, _losses(discoveries), strict=True):
        scores = one.kept.scores
        saved = scores.alone - loss
        gain, error = float(saved.sum()), standard_error(saved)
        found.append(Point(one.macros, one.max_transitions, gain, error, scores.runnable, one.changes))
    return found


def choose(discoveries: Sequence[Discovery]) -> Choice:
    """The discovery to follow, or one macro-action.

    Where some can be run, the one of least loss; where none can, likewise of those whose gain exceeds its
    standard error. Of those that do equally well (`criteria.equally_good`), the one of fewest macro-actions,
    then of fewest transitions, then of least loss.
    """
    found, losses = points(discoveries), _losses(discoveries)
    eligible = [k for k, point in enumerate(found) if point.runnable]
    if not eligible:
        eligible = [k for k, point in enumerate(found) if point.gain > point.error]
    place = None
    if eligible:
        close = [eligible[k] for k in equally_good([losses[k] for k in eligible])]
        place = min(close, key=lambda k: (found[k].macros, found[k].max_transitions, -found[k].gain))
    return Choice(tuple(discoveries), tuple(found), place)


def _losses(discoveries: Sequence[Discovery]) -> list[Float[Tensor, " parts"]]:
    """The losses that the discoveries are compared by, of the parts of the data; see `points`."""
    scores = [one.kept.scores for one in discoveries]
    if any(one.runnable for one in scores):
        return [one.causal for one in scores]
    return [one.context for one in scores]
