"""How many macro-actions: the rule as a table, and searches as points."""

import pytest
import torch

from dpmacro.discovery.alternation import Alternated
from dpmacro.discovery.candidates import Judged, Task, Verdict
from dpmacro.discovery.model_order import Choice, Point, _best, choose, points
from dpmacro.discovery.result import Search
from dpmacro.switching.functions import SwitchFunctions

LENGTHS = torch.tensor([6, 4])


def point(macros, bound, gain, error=0.01, runnable=True):
    return Point(macros, bound, gain, error, runnable, 1.0)


def search(macros, bound, gain, error=0.01, detected=1.0, context=(0.0, 0.01), changes=(1, 1)):
    """A search whose best rival, not its first, changes so many times in either trajectory."""
    labels = torch.cat(
        [
            torch.arange(length).clamp(max=count) % macros
            for length, count in zip(LENGTHS, changes, strict=True)
        ]
    )
    task = Task(torch.zeros(10).long(), LENGTHS, torch.arange(2), 2, macros, bound, seed=0)
    none = SwitchFunctions([], torch.zeros(0), torch.zeros(0), torch.zeros(10, 0), None)
    worse = Verdict(0.0, 9.0, 0.9, 9.0, -9.0, 0.1, -9.0, 0.1)
    best = Verdict(detected, 1.0, 0.1, 1.0, gain, error, *context)
    judged = tuple(
        Judged(labels * used, verdict, torch.zeros(10, macros, 2), none)
        for used, verdict in ((0, worse), (1, best))
    )
    return Search(task, Alternated(labels[None], torch.zeros(1, 1)), judged, 1)


CASES = {
    "nothing was tried": ([], None),
    "the largest gain of those that can be run": ([point(2, 1, 0.1), point(3, 2, 0.3)], 1),
    "one that can be run before a larger gain": ([point(2, 1, 0.05), point(3, 2, 0.9, runnable=False)], 0),
    "one that can be run, however unsure": ([point(2, 1, 0.05, error=0.2)], 0),
    "within an error of the largest, the fewest macro-actions": (
        [point(4, 3, 0.30, error=0.05), point(3, 8, 0.26), point(2, 1, 0.24)],
        1,
    ),
    "exactly an error below the largest": ([point(3, 2, 0.75, error=0.25), point(2, 1, 0.5)], 1),
    "the error that counts is that of the largest": ([point(2, 1, 0.2, error=0.5), point(3, 2, 0.3)], 1),
    "then the fewest transitions": ([point(2, 4, 0.31, error=0.05), point(2, 1, 0.30), point(2, 2, 0.3)], 1),
    "then the larger gain": ([point(2, 1, 0.30, error=0.05), point(2, 1, 0.31, error=0.05)], 1),
    "fewer that cannot be run do not count": (
        [point(3, 2, 0.3, error=0.05), point(2, 1, 0.29, runnable=False)],
        0,
    ),
    "none can be run or gains more than its error": (
        [point(2, 1, 0.02, 0.02, runnable=False), point(3, 2, -0.1, runnable=False)],
        None,
    ),
    "none can be run: a gain beyond its error": (
        [point(2, 1, 0.02, 0.03, runnable=False), point(3, 2, 0.2, 0.03, runnable=False)],
        1,
    ),
    "none can be run: the fewest within an error": (
        [point(2, 1, 0.17, 0.03, runnable=False), point(3, 2, 0.18, 0.03, runnable=False)],
        0,
    ),
    "none can be run: within an error of the largest, but not beyond its own": (
        [point(2, 1, 0.17, 0.2, runnable=False), point(3, 2, 0.18, 0.03, runnable=False)],
        1,
    ),
}


@pytest.mark.parametrize("case", CASES)
def test_the_rule(case):
    found, chosen = CASES[case]
    assert _best(found) == chosen


def test_where_some_can_be_run_a_point_shows_the_gain_of_running():
    searches = [
        search(2, 1, 0.2, 0.02, context=(0.5, 0.05), changes=(1, 0)),
        search(3, 4, 0.1, 0.03, detected=0.4, context=(0.6, 0.06), changes=(4, 3)),
    ]
    assert points(searches) == [Point(2, 1, 0.2, 0.02, True, 0.5), Point(3, 4, 0.1, 0.03, False, 3.5)]


def test_where_none_can_be_run_a_point_shows_what_context_tells():
    searches = [
        search(2, 1, -0.2, 0.02, context=(0.5, 0.05)),
        search(3, 2, 0.1, 0.03, detected=0.4, context=(0.6, 0.06)),
    ]
    assert points(searches) == [Point(2, 1, 0.5, 0.05, False, 1.0), Point(3, 2, 0.6, 0.06, False, 1.0)]


def test_a_choice_knows_its_search():
    searches = [
        search(2, 1, 0.1, context=(0.9, 0.01)),
        search(3, 2, 0.4, error=0.05),
        search(4, 3, 0.44, error=0.05),
    ]
    choice = choose(searches)
    assert choice.search is searches[1] and choice.setting == (3, 2)
    assert choice.points == tuple(points(searches)) and choice.searches == tuple(searches)


@pytest.mark.parametrize(
    "searches",
    [[], [search(2, 1, -0.1, context=(0.01, 0.02)), search(3, 2, 0.5, detected=0.2, context=(-0.1, 0.0))]],
    ids=["none tried", "none better"],
)
def test_one_macro_action_is_an_answer(searches):
    choice = choose(searches)
    assert choice == Choice(tuple(searches), tuple(points(searches)), None)
    assert choice.search is None and choice.setting == (1, 0)
