"""Outcomes of a world that names none, and what a world's own diagnosis says instead."""

from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest

from dpmacro.evaluation.rollouts import PlannerSource, run_episodes
from dpmacro.worlds import diagnosis_of
from dpmacro.worlds.base import (
    ENDED,
    NO_PHASE,
    OUT_OF_TIME,
    SUCCESS,
    Episode,
    Expert,
    GenericDiagnosis,
    Planner,
)
from dpmacro.worlds.two_flags.diagnosis import OUTCOMES, TwoFlagsDiagnosis
from dpmacro.worlds.two_flags.teacher import Teacher


class Counting(gym.Env):
    """Ends well after `goal` steps; its info says nothing of phases, states or failures."""

    observation_space = gym.spaces.Dict({"pixels": gym.spaces.Box(0, 255, (1,), np.uint8)})
    action_space = gym.spaces.Discrete(2)

    def __init__(self, render_mode=None, goal=3):
        self.render_mode, self.goal = render_mode, goal

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.steps = 0
        return {"pixels": np.zeros(1, np.uint8)}, {"is_success": False}

    def step(self, action):
        self.steps += 1
        done = self.steps == self.goal
        return {"pixels": np.zeros(1, np.uint8)}, float(done), done, self.steps == 5, {"is_success": done}


gym.register("Counting-v0", Counting, disable_env_checker=True, order_enforce=False)


class Still(Planner):
    def reset(self, env):
        pass

    def act(self, observation, info):
        return 0


class Standing(PlannerSource):
    def planner(self, world):
        return Still()


@pytest.mark.parametrize(("goal", "outcome", "steps"), [(3, SUCCESS, 3), (9, OUT_OF_TIME, 5)])
def test_a_world_without_names_for_its_failures_runs_as_well(goal, outcome, steps):
    (episode,) = run_episodes(Standing("teacher"), {"id": "Counting-v0", "goal": goal}, [0])
    assert (episode.outcome, episode.steps, episode.success) == (outcome, steps, goal == 3)
    assert episode.phases.tolist() == [NO_PHASE] * steps and episode.macros.tolist() == [-1] * steps
    diagnosis = diagnosis_of("Counting-v0")
    assert isinstance(diagnosis, GenericDiagnosis) and outcome in diagnosis.outcomes
    causes = ["" if goal == 3 else "out_of_time"]
    assert diagnosis.causes([episode]) == causes and diagnosis.events([episode]) == {}


@pytest.mark.parametrize(
    ("outcome", "facts", "cause"),
    [
        (SUCCESS, {"first_success": 1}, ""),
        (OUT_OF_TIME, {"first_success": 1, "period": 1}, "success_lost"),
        (OUT_OF_TIME, {"loop": 4}, "cycle"),
        (OUT_OF_TIME, {"period": 2}, "cycle"),
        (OUT_OF_TIME, {"period": 1}, "no_motion"),
        (OUT_OF_TIME, {}, "out_of_time"),
        (ENDED, {}, "ended"),
        (ENDED, {"period": 1}, "no_motion"),
    ],
)
def test_generic_causes(outcome, facts, cause):
    episode = Episode(0, outcome, *[np.zeros(3, kind) for kind in (np.uint8, np.int8, np.int8, np.float32)])
    assert GenericDiagnosis().causes([replace(episode, **facts)]) == [cause]


@pytest.mark.parametrize(
    ("success", "terminated", "outcome"),
    [(True, True, SUCCESS), (True, False, SUCCESS), (False, True, ENDED), (False, False, OUT_OF_TIME)],
)
def test_generic_outcomes(success, terminated, outcome):
    assert GenericDiagnosis().outcome({"is_success": success, "terminated": terminated}) == outcome


def test_two_flags_has_a_diagnosis_of_its_own():
    diagnosis = diagnosis_of("TwoFlags-v0")
    assert isinstance(diagnosis, TwoFlagsDiagnosis) and diagnosis.outcomes == OUTCOMES
    for info, outcome in (
        ({"is_success": True, "failure": "", "phase": 1}, "success"),
        ({"is_success": False, "failure": "red_first", "phase": 0}, "red_first"),
        ({"is_success": False, "failure": "", "phase": 0}, "blue_never_reached"),
        ({"is_success": False, "failure": "", "phase": 1}, "red_never_reached"),
    ):
        assert diagnosis.outcome(info) == outcome


def test_the_teacher_is_an_expert():
    assert isinstance(Teacher(), Expert) and not isinstance(TwoFlagsDiagnosis(), Planner)
