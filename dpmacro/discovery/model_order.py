"""How many macro-actions? Searches with several Q and S, told apart by data that they left out."""

from collections.abc import Sequence
from dataclasses import dataclass

from dpmacro.discovery.result import Search

__all__ = ["Choice", "Point", "choose", "points"]


@dataclass(frozen=True)
class Point:
    """One search on the selection chart; one macro-action is the zero of the gain."""

    macros: int
    max_transitions: int
    gain: float  # nats a frame over a single classifier on left-out data; see `points`
    error: float  # its standard error
    runnable: bool  # whether a planner can recognise the changes
    changes: float  # transitions used per trajectory


@dataclass(frozen=True)
class Choice:
    """Searches that were compared, and the one to follow."""

    searches: tuple[Search, ...]
    points: tuple[Point, ...]  # one for every search
    place: int | None  # of the search to follow; None for one macro-action

    @property
    def search(self) -> Search | None:
        """The search to follow; None for one macro-action."""
        return None if self.place is None else self.searches[self.place]

    @property
    def setting(self) -> tuple[int, int]:
        """Q and S to follow."""
        return (1, 0) if self.search is None else (self.search.macros, self.search.max_transitions)


def points(searches: Sequence[Search]) -> list[Point]:
    """What left-out data says of each search.

    The gain is that of a planner which runs the segmentation, where any search found one that can be run;
    else that of labels which the frames around tell. The two are never compared with one another.
    """
    verdicts = [search.kept.verdict for search in searches]
    if any(verdict.runnable for verdict in verdicts):
        gains = [(verdict.gain, verdict.gain_error) for verdict in verdicts]
    else:
        gains = [(verdict.context_gain, verdict.context_error) for verdict in verdicts]
    return [
        Point(search.macros, search.max_transitions, *gain, search.kept.verdict.runnable, search.changes)
        for search, gain in zip(searches, gains, strict=True)
    ]


def choose(searches: Sequence[Search]) -> Choice:
    """The search to follow, or one macro-action.

    Where some can be run, the largest gain; where none can, the largest gain if it exceeds its standard
    error. Of those within a standard error of the largest, the fewest macro-actions, then transitions.
    """
    found = points(searches)
    return Choice(tuple(searches), tuple(found), _best(found))


def _best(found: Sequence[Point]) -> int | None:
    eligible = [k for k, point in enumerate(found) if point.runnable]
    if not eligible:
        eligible = [k for k, point in enumerate(found) if point.gain > point.error]
    if not eligible:
        return None
    best = max((found[k] for k in eligible), key=lambda point: point.gain)
    close = [k for k in eligible if found[k].gain >= best.gain - best.error]
    return min(close, key=lambda k: (found[k].macros, found[k].max_transitions, -found[k].gain))
