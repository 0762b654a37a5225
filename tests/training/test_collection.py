"""Runs of a planner with the teacher's word on every frame."""

import numpy as np
import pytest
import torch
from noise import ACTIONS

from dpmacro.boosting.learners.stumps import StumpClassifier
from dpmacro.evaluation.rollouts import PlannerSource
from dpmacro.features.kinds import make_features
from dpmacro.features.quantising import Quantiser
from dpmacro.policy.config import InputConfig, PolicyConfig
from dpmacro.policy.policy import MacroPolicy
from dpmacro.training.collection import gather, visit
from dpmacro.worlds.two_flags.env import FORWARD, TURN_LEFT, TURN_RIGHT

CAMERA = "observation.image"
INPUTS = {CAMERA: (48, 64, 3)}
WORLD = {"id": "TwoFlags-v0", "render_size": (64, 48)}
SHORT_SEED = 29  # the teacher's run is short; found by trying
HIDDEN_SEED = 53  # no blue flag is to be seen from the start


def stubborn(folder, action):
    """A saved policy that always does the same."""
    features = make_features("rectangles", 48, 64, 1, torch.Generator())
    votes = torch.nn.functional.one_hot(torch.tensor(action), len(ACTIONS)).float().expand(1, 1, 2, -1)
    actor = StumpClassifier(torch.zeros(1, 1, dtype=torch.int64), torch.zeros(1, 1, dtype=torch.uint8), votes)
    inputs = {CAMERA: InputConfig((48, 64, 3))}
    config = PolicyConfig("baseline", 1, (0,), inputs, features.spec(), ACTIONS, len(ACTIONS))
    quantiser = Quantiser(torch.arange(255, dtype=torch.int32)[None])
    MacroPolicy.compact(config, features, quantiser, actor, None).save(folder)
    return PlannerSource("policy", folder, recovery=False)


@pytest.fixture(scope="module")
def spun(tmp_path_factory):
    source = stubborn(tmp_path_factory.mktemp("left"), TURN_LEFT)
    return visit(source, WORLD, INPUTS, SHORT_SEED)


def test_the_planner_drives_until_it_turns_in_circles_then_the_teacher_until_a_reward(spun):
    wheel = np.flatnonzero(np.diff(spun.taught)) + 1
    assert not spun.taught[0]
    assert 600 <= wheel[0] <= 602  # a whole turn, seen to be one
    [first, second] = np.flatnonzero(spun.run.rewards > 0)
    assert wheel[1] == first + 1  # the planner is given back the wheel
    assert spun.taught[second]
    assert spun.run.success


def test_every_frame_has_the_teachers_action(spun):
    assert (spun.run.actions[~spun.taught & spun.agreed] == TURN_LEFT).all()
    assert (spun.run.actions[~spun.agreed] != TURN_LEFT).all()
    assert set(spun.run.actions[spun.taught].tolist()) >= {FORWARD, TURN_LEFT}
    assert not spun.agreed[~spun.taught].all(), "a spinner goes past the flag that the teacher walks to"


def test_frame_t_is_seen_before_step_t(spun):
    before = spun.run.truth["phase"][np.flatnonzero(spun.run.rewards > 0)]
    assert before.tolist() == [0, 1]
    assert spun.run.observations[CAMERA].shape == (len(spun.run.actions), 48, 64, 3)
    assert np.array_equal(
        spun.run.observations[CAMERA][0], spun.run.observations[CAMERA][600]
    )  # after a whole turn


def test_a_run_ends_where_the_teacher_turns_in_circles_too(tmp_path):
    lost = visit(stubborn(tmp_path, TURN_RIGHT), WORLD, INPUTS, HIDDEN_SEED)
    assert not lost.run.success
    assert 1200 <= len(lost.run.actions) <= 1206
    assert (lost.run.truth["phase"] == 0).all()


def test_the_teacher_that_the_world_names_is_asked(tmp_path):
    """The searching teacher finds the flag that is hidden, from wherever the planner leaves it."""
    found = visit(stubborn(tmp_path, TURN_RIGHT), {**WORLD, "teacher": "searching"}, INPUTS, HIDDEN_SEED)
    assert (found.run.truth["phase"] == 1).any() and found.taught.any()
    assert FORWARD in found.run.actions[found.taught]


def test_runs_do_not_depend_on_the_number_of_processes(tmp_path):
    source, world = stubborn(tmp_path, FORWARD), {**WORLD, "max_steps": 40}
    runs = [[one.run for one in gather(source, world, INPUTS, range(3), workers)] for workers in (1, 2)]
    for one, other in zip(*runs, strict=True):
        assert np.array_equal(one.observations[CAMERA], other.observations[CAMERA])
        assert np.array_equal(one.actions, other.actions)
    assert [len(run.actions) for run in runs[0]] == [40] * 3
