"""How many macro-actions: the rule as a table, and discoveries as points."""

import pytest
import torch
from visible import functions_of

from dpmacro.boosting.losses.classes import ExponentialLoss
from dpmacro.discovery.alternation import Alternated
from dpmacro.discovery.candidates import Candidate
from dpmacro.discovery.criteria import standard_error
from dpmacro.discovery.model_order import Choice, Point, choose, points, searches
from dpmacro.discovery.result import Discovery
from dpmacro.discovery.task import Task
from tests.discovery.test_criteria import PAIRED, STEP, losses, scored

LENGTHS = torch.tensor([6, 4])
ALONE = 1.0  # loss of a single classifier
ERROR = standard_error(losses(0.0, STEP))  # of a spread of STEP; 0 where there is no spread


def discovery(macros, bound, gain, spread=0.0, recognised=1.0, context=0.0, doubt=0.0, changes=(1, 1)):
    """A discovery whose best candidate, not its first, changes so many times in either trajectory.

    `gain` is that of running it and `spread` that of its parts, or its loss; `context` and `doubt` are those
    of the labels that the frames around tell.
    """
    labels = torch.cat(
        [
            torch.arange(length).clamp(max=count) % macros
            for length, count in zip(LENGTHS, changes, strict=True)
        ]
    )
    causal = gain if isinstance(gain, torch.Tensor) else losses(ALONE - gain, spread)
    task = Task(torch.zeros(10).long(), LENGTHS, torch.arange(2), ExponentialLoss(2), macros, bound, seed=0)
    none = functions_of(torch.zeros(10, 0), ())
    worse = scored(9.0, 0.0, ALONE)
    best = scored(causal, recognised, ALONE, context=losses(ALONE - context, doubt))
    candidates = tuple(
        Candidate(labels * used, scores, torch.zeros(10, macros, 2), torch.ones(2), none)
        for used, scores in ((0, worse), (1, best))
    )
    return Discovery(task, Alternated(labels[None], torch.zeros(1, 1)), candidates, 1)


def unrun(macros, bound, context, doubt=0.0):
    """A discovery that cannot be run, though running it would gain much."""
    return discovery(macros, bound, 0.9, recognised=0.2, context=context, doubt=doubt)


CASES = {
    "nothing was tried": ([], None),
    "the largest gain of those that can be run": ([discovery(2, 1, 0.1), discovery(3, 2, 0.3)], 1),
    "one that can be run before a larger gain": (
        [discovery(2, 1, 0.05), discovery(3, 2, 0.9, recognised=0.4, context=0.9)],
        0,
    ),
    "one that can be run, however unsure": ([discovery(2, 1, 0.01, 2 * STEP)], 0),
    "within an error of the largest, the fewest macro-actions": (
        [discovery(4, 3, 0.30), discovery(3, 8, 0.28, STEP), discovery(2, 1, 0.24, STEP)],
        1,
    ),
    "almost an error below the largest": (
        [discovery(3, 2, 0.75), discovery(2, 1, 0.75 - 0.99 * ERROR, STEP)],
        1,
    ),
    "more than an error below the largest": (
        [discovery(3, 2, 0.75), discovery(2, 1, 0.75 - 1.01 * ERROR, STEP)],
        0,
    ),
    "the error that counts is that of the difference": (
        [discovery(2, 1, 0.29, 3 * STEP), discovery(3, 2, 0.3, 3 * STEP)],
        1,
    ),
    "then the fewest transitions": (
        [discovery(2, 4, 0.31), discovery(2, 1, 0.30, STEP), discovery(2, 2, 0.30, STEP)],
        1,
    ),
    "then the larger gain": ([discovery(2, 1, 0.30, STEP), discovery(2, 1, 0.31)], 1),
    "fewer that cannot be run do not count": (
        [discovery(3, 2, 0.3), discovery(2, 1, 0.29, STEP, recognised=0.4)],
        0,
    ),
    "none can be run or gains more than its error": (
        [unrun(2, 1, 0.9 * ERROR, STEP), unrun(3, 2, -0.1)],
        None,
    ),
    "none can be run: a gain beyond its error": ([unrun(2, 1, 0.9 * ERROR, STEP), unrun(3, 2, 0.2, STEP)], 1),
    "none can be run: the fewest within an error": ([unrun(2, 1, 0.17, STEP), unrun(3, 2, 0.18)], 0),
    "none can be run: within an error of the largest, but not beyond its own": (
        [unrun(2, 1, 0.17, 10 * STEP), unrun(3, 2, 0.18)],
        1,
    ),
}


@pytest.mark.parametrize("case", CASES)
def test_the_rule(case):
    found, chosen = CASES[case]
    assert choose(found).place == chosen


@pytest.mark.parametrize("case", PAIRED)
def test_the_rule_is_the_one_that_tells_candidates_apart(case):
    """Of two that do equally well the simpler is followed, though its loss is larger."""
    best, other, alike = PAIRED[case]
    assert choose([discovery(3, 2, best), discovery(2, 1, other)]).place == int(alike)


def test_where_some_can_be_run_a_point_shows_the_gain_of_running():
    found = points(
        [
            discovery(2, 1, 0.2, STEP, context=0.5, changes=(1, 0)),
            discovery(3, 4, 0.1, 2 * STEP, recognised=0.4, context=0.6, changes=(4, 3)),
        ]
    )
    assert_points(found, [(2, 1, 0.2, ERROR, True, 0.5), (3, 4, 0.1, 2 * ERROR, False, 3.5)])


def test_where_none_can_be_run_a_point_shows_what_context_tells():
    found = points(
        [
            discovery(2, 1, -0.2, context=0.5, doubt=STEP),
            discovery(3, 2, 0.1, recognised=0.4, context=0.6, doubt=2 * STEP),
        ]
    )
    assert_points(found, [(2, 1, 0.5, ERROR, False, 1.0), (3, 2, 0.6, 2 * ERROR, False, 1.0)])


def assert_points(found, wanted):
    assert len(found) == len(wanted)
    for point, values in zip(found, wanted, strict=True):
        assert isinstance(point, Point)
        assert tuple(vars(point).values()) == pytest.approx(values, abs=1e-5)


def test_a_choice_knows_its_discovery():
    tried = [discovery(2, 1, 0.1, context=0.9), discovery(3, 2, 0.43, STEP), discovery(4, 3, 0.44)]
    choice = choose(tried)
    assert choice.discovery is tried[1] and choice.setting == (3, 2)
    assert choice.points == tuple(points(tried)) and choice.discoveries == tuple(tried)


@pytest.mark.parametrize(
    "tried",
    [[], [unrun(2, 1, 0.9 * ERROR, STEP), unrun(3, 2, -0.1)]],
    ids=["none tried", "none better"],
)
def test_one_macro_action_is_an_answer(tried):
    choice = choose(tried)
    assert choice == Choice(tuple(tried), tuple(points(tried)), None)
    assert choice.discovery is None and choice.setting == (1, 0)


@pytest.mark.parametrize(
    ("max_transitions", "order", "vectors", "expected"),
    [
        (None, "free", False, [(2, 1), (2, 2), (3, 2), (3, 4)]),
        (None, "chain", False, [(2, 1), (3, 2)]),
        (5, "free", False, [(2, 5), (3, 5)]),
        (None, "free", True, [(3, 2)]),
        (None, "chain", True, [(3, 2)]),
        (5, "free", True, [(3, 5)]),
    ],
)
def test_the_searches_for_an_open_number(max_transitions, order, vectors, expected):
    assert searches(3, max_transitions, order, vectors) == expected
