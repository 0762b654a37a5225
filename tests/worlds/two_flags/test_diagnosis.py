"""Each cause of failure from a run made by hand that shows it, and from runs next to it that do not."""

import numpy as np
import pytest

from dpmacro.evaluation.rollouts import PlannerSource, run_episodes
from dpmacro.worlds import diagnosis_of
from dpmacro.worlds.base import Episode
from dpmacro.worlds.two_flags.diagnosis import (
    CAUSES,
    blue_step,
    cause,
    failure_causes,
    home_phases,
)
from dpmacro.worlds.two_flags.env import FORWARD, STEP, TURN_LEFT, TURN_RIGHT

F, L, R = FORWARD, TURN_LEFT, TURN_RIGHT
HOMES = {0: 0, 1: 1}


def run(outcome, actions, macros=0, blue=None, loop=0, way=STEP):
    """A run that reaches blue on step `blue`; a forward step covers `way` metres. `macros`: one or a row."""
    steps = len(actions)
    actions = np.array(actions, np.uint8)
    rewards = np.zeros(steps, np.float32)
    phases = np.zeros(steps, np.int8)
    if blue is not None:
        rewards[blue], phases[blue + 1 :] = 1, 1
    ahead = np.cumsum(way * (actions == F)) - way * (actions == F)
    return Episode(
        seed=0,
        outcome=outcome,
        actions=actions,
        phases=phases,
        macros=np.broadcast_to(macros, steps).astype(np.int8),
        rewards=rewards,
        loop=loop,
        positions=np.stack([ahead, np.zeros(steps)], 1).astype(np.float32),
    )


def won(macros, phases):
    episode = run("success", [F] * len(macros), macros)
    episode.phases[:] = phases
    return episode


@pytest.mark.parametrize(
    ("episode", "expected"),
    [
        (run("red_first", [F] * 9, [0] * 4 + [1] * 5), "changed_early"),
        (run("blue_never_reached", [L] * 700, [0] * 4 + [1] * 696, loop=600), "changed_early"),
        (run("red_never_reached", [L] * 700, 0, blue=50, loop=600), "change_missed"),
        (run("red_never_reached", [F] * 700, 0, blue=50, way=0), "change_missed"),
        (run("red_never_reached", [F] * 9, [0] * 3 + [1] * 3 + [0] * 3, blue=3), "change_missed"),
        (run("red_first", [F] * 9), "red_in_the_way"),
        (run("red_first", [F] * 9, [0] * 3 + [1] * 3 + [0] * 3), "red_in_the_way"),
        (run("red_first", [F] * 9, -1), "red_in_the_way"),
        (run("red_first", [F] * 9, [0] * 3 + [2] * 6), "red_in_the_way"),
        (run("blue_never_reached", [L] * 3 + [F] * 700, way=0), "pressed"),
        (run("blue_never_reached", [L] * 3 + [F, F, R] * 300, way=0.2 * STEP), "pressed"),
        (run("red_never_reached", [F] * 60, 1, blue=50, loop=1, way=0), "pressed"),
        (run("red_never_reached", [L] * 700, 1, blue=50, loop=600), "spins"),
        (run("blue_never_reached", [F] * 20 + [R] * 601, loop=600), "spins"),
        (run("blue_never_reached", [F] * 20 + [R] * 601), "spins"),
        (run("blue_never_reached", [F] * 20 + [L, R, L], loop=2), "dithers"),
        (run("blue_never_reached", [F] * 20 + [L, R] * 400), "dithers"),
        (run("blue_never_reached", [L] * 250 + [R] * 250 + [L], loop=500), "dithers"),
        (run("blue_never_reached", [L] * 3 + [F] * 700), "out_of_time"),
        (run("blue_never_reached", [L] * 3 + [F, F, R] * 300, way=0.3 * STEP), "out_of_time"),
        (run("blue_never_reached", [L] * 599), "out_of_time"),
        (run("red_never_reached", [F] * 599, 2, blue=50, way=0), "out_of_time"),
        (
            run("red_never_reached", [F] * 599 + [L], [0] * 20 + [1] * 580, blue=599),
            "out_of_time",
        ),  # on its last
    ],
)
def test_the_cause_of_a_failure(episode, expected):
    assert cause(episode, HOMES) == expected
    assert expected in CAUSES


HOMES_OF_FOUR = {0: 0, 1: 1, 2: 2, 3: 3}


@pytest.mark.parametrize(
    ("outcome", "reached", "macro", "expected"),
    [
        ("green_first", [2], 1, "green_in_the_way"),
        ("yellow_first", [2], 1, "yellow_in_the_way"),
        ("yellow_first", [2], 3, "changed_early"),
        ("green_first", [2], 2, "changed_early"),
        ("yellow_never_reached", [2, 4, 6], 1, "change_missed"),
        ("yellow_never_reached", [2, 4, 6], 3, "out_of_time"),
        ("red_never_reached", [2], 0, "change_missed"),
        ("red_never_reached", [2], 7, "out_of_time"),
    ],
)
def test_causes_among_four_flags(outcome, reached, macro, expected):
    episode = run(outcome, [F] * 9, macro)
    episode.rewards[reached] = 1
    assert cause(episode, HOMES_OF_FOUR) == expected


def test_homes_and_steps_among_four_flags():
    phases = [0] * 5 + [1] * 5 + [2] * 5 + [3] * 5
    episode = won(phases, phases)
    episode.rewards[[4, 9, 14, 19]] = 1
    assert home_phases([episode]) == HOMES_OF_FOUR
    failed = run("red_never_reached", [F] * 9, blue=3)
    assert diagnosis_of("FourFlags-v0").events([episode, failed]) == {
        "blue_steps": [4, 3],
        "red_steps": [9, None],
        "green_steps": [14, None],
    }


@pytest.mark.parametrize(
    ("world", "early", "missed"),
    [
        ("TwoFlags-v0", ["red"], ["blue", "red"]),
        ("FourFlags-v0", ["red", "green", "yellow"], ["blue", "red", "green", "yellow"]),
    ],
)
def test_outcomes_name_every_flag(world, early, missed):
    diagnosis = diagnosis_of(world)
    first, never = (
        [f"{flag}{end}" for flag in flags] for flags, end in ((early, "_first"), (missed, "_never_reached"))
    )
    assert list(diagnosis.outcomes) == ["success", *first, *never]
    told = [{"is_success": False, "failure": "", "phase": phase} for phase in range(len(missed))]
    assert [diagnosis.outcome(info) for info in told] == never


def test_where_the_world_tells_no_position_nothing_is_known_to_press():
    episode = run("blue_never_reached", [F] * 700, way=0)
    assert cause(Episode(**{**episode.__dict__, "positions": None}), {}) == "out_of_time"


def test_every_failure_has_one_cause_and_a_success_none():
    episodes = [
        won([0] * 10 + [1] * 10, [0] * 9 + [1] * 11),
        run("red_first", [F] * 9, [0] * 4 + [1] * 5),
        run("blue_never_reached", [L] * 601, loop=600),
    ]
    assert failure_causes(episodes) == ["", "changed_early", "spins"]
    assert failure_causes(episodes[1:]) == ["changed_early", "spins"]
    assert failure_causes([]) == []


@pytest.mark.parametrize(
    ("episodes", "homes"),
    [
        ([won([0] * 10 + [1] * 10, [0] * 9 + [1] * 11)], {0: 0, 1: 1}),
        ([won([2] * 4 + [0] * 6 + [3] * 4 + [1] * 6, [0] * 10 + [1] * 10)], {2: 0, 0: 0, 3: 1, 1: 1}),
        ([won([0, 1] * 10, [0] * 10 + [1] * 10)], {}),  # both in both phases
        ([won([0] * 4 + [1] * 10, [0] * 5 + [1] * 9), won([1] * 4, [0] * 4)], {0: 0}),
        ([won([0] * 8 + [1] * 2, [0] * 10), won([1] * 8, [1] * 8)], {0: 0, 1: 1}),  # 8 of 10 frames of 1
        ([won([0] * 20, [0] * 10 + [1] * 10)], {}),  # the baseline
        ([won([0] * 20, [0] * 19 + [1])], {}),  # still the baseline
        ([won([-1] * 20, [0] * 19 + [1])], {}),  # the teacher
        ([won([0] * 9 + [1], [0] * 9 + [1]), run("red_first", [F] * 9, 1)], {0: 0, 1: 1}),  # failures: no say
        ([run("red_first", [F] * 9, [3] * 5 + [2] * 4), run("red_first", [F], 3)], {3: 0, 2: 1}),
        ([run("red_never_reached", [F] * 9, 0, blue=1)], {}),
        ([], {}),
    ],
)
def test_homes(episodes, homes):
    assert home_phases(episodes) == homes


def test_steps_of_blue_and_of_the_first_change():
    episode = run("red_never_reached", [F] * 9, [0] * 6 + [1] + [0] * 2, blue=4)
    assert (blue_step(episode), episode.first_change) == (4, 6)
    assert episode.phases[4] == 0 and episode.phases[5] == 1
    unchanged = run("red_first", [F] * 9)
    assert blue_step(unchanged) is unchanged.first_change is None
    assert diagnosis_of("TwoFlags-v0").events([episode, unchanged]) == {"blue_steps": [4, None]}


@pytest.mark.parametrize(
    ("seed", "outcome", "expected"),
    [(53, "blue_never_reached", "spins"), (1, "red_first", "red_in_the_way")],
)
def test_causes_of_a_teacher(seed, outcome, expected):
    episodes = run_episodes(PlannerSource("teacher"), {"id": "TwoFlags-v0", "render_size": (64, 48)}, [seed])
    assert episodes[0].outcome == outcome and failure_causes(episodes) == [expected]


def test_an_avatar_at_a_wall_is_pressed():
    class Walker:
        def reset(self, env):
            pass

        def act(self, observation, info):
            return FORWARD

    class Walking(PlannerSource):
        def planner(self, world):
            return Walker()

    world = {"id": "TwoFlags-v0", "render_size": (64, 48), "max_steps": 640}
    episodes = run_episodes(Walking("teacher"), world, [165])  # four steps from a wall
    assert episodes[0].loop == 0 and failure_causes(episodes) == ["pressed"]
