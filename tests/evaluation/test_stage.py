"""Policies of vectors in a world that nobody has told about: what fits, what happens, and what goes wrong."""

import numpy as np
import pytest
from reaching import STATE, WORLD, constant_policy

from dpmacro.evaluation.rollouts import PlannerSource, iter_episodes, run_episodes
from dpmacro.evaluation.stage import Stage, config_of, inputs_of
from dpmacro.policy.policy import MacroPolicy
from dpmacro.worlds import diagnosis_of
from dpmacro.worlds.base import NO_PHASE, WorldError


@pytest.fixture(scope="module")
def source(tmp_path_factory):
    return PlannerSource("policy", constant_policy(tmp_path_factory.mktemp("policy")), False)


def test_a_run_of_vectors_holds_what_was_done(source):
    [episode] = run_episodes(source, {"id": WORLD}, [4])
    assert episode.success and episode.success_by == 'info["success"]'
    assert episode.first_success == episode.steps - 1
    assert episode.actions.dtype == np.float32 and episode.actions.tolist() == [[0.5, 0, 1]] * episode.steps
    assert episode.clipped == episode.steps, "2 is beyond what the world takes"
    assert set(episode.phases.tolist()) == {NO_PHASE} and set(episode.macros.tolist()) == {0}
    assert (episode.loop, episode.period) == (0, 0)


def test_actions_within_the_box_are_not_clipped(tmp_path):
    source = PlannerSource("policy", constant_policy(tmp_path, (1.0, -1.0, 0.25)), False)
    [episode] = run_episodes(source, {"id": WORLD}, [4])
    assert episode.clipped == 0 and episode.actions[0].tolist() == [1.0, -1.0, 0.25]


@pytest.mark.parametrize(
    ("options", "outcome", "cause", "told"),
    [
        ({"key": "is_success"}, "success", "", 'info["is_success"]'),
        ({"key": None}, "success", "", "a reward above 0 on the step that ends the run"),
        ({"key": None, "success": 1}, "success", "", "rewards of 1 or more in sum"),
        ({"key": "won", "success": "won"}, "success", "", 'info["won"]'),
        ({"ends": False}, "success", "", 'info["success"]'),
        ({"goal": 99}, "out_of_time", "out_of_time", 'info["success"]'),
        ({"ends": False, "loses_at": 30}, "out_of_time", "success_lost", 'info["success"]'),
        ({"key": None, "success": 2}, "ended", "ended", "rewards of 2 or more in sum"),
    ],
)
def test_success_and_causes_where_a_world_names_none(source, options, outcome, cause, told):
    world = {"id": WORLD, **options}
    [episode] = run_episodes(source, world, [0])
    assert (episode.outcome, episode.success_by) == (outcome, told)
    assert diagnosis_of(WORLD).causes([episode]) == [cause]


@pytest.mark.parametrize(("push", "cause"), [(0.0, "no_motion"), (0.5, "out_of_time")])
def test_who_stands_still_is_seen_to(tmp_path, push, cause):
    source = PlannerSource("policy", constant_policy(tmp_path, (push, 0.0, 0.0)), False)
    [episode] = run_episodes(source, {"id": WORLD, "goal": 99}, [0])
    assert diagnosis_of(WORLD).causes([episode]) == [cause]


@pytest.mark.parametrize("workers", [1, 2])
@pytest.mark.parametrize(
    ("options", "message"),
    [
        (
            {"raise_at": 3},
            "Reach-v0 raised RuntimeError: the arm fell off, at step 2 of the run of seed 2",
        ),
        (
            {"nan_at": 3},
            "agent_pos with nan as number 1 at step 2 of the run of seed 2: correct the world",
        ),
        ({"shape_at": 3}, r"shows agent_pos of shape \(2,\) and type float64 at step 2 of the run of seed 2"),
        ({"nan_at": 0}, "agent_pos with nan as number 1 at the start of the run of seed 2"),
        ({"success": "won"}, "the info of the world reaching:Reach-v0 has no 'won' to tell success"),
    ],
)
def test_what_goes_wrong_in_mid_run_is_a_line_after_the_runs_before_it(source, options, message, workers):
    if workers == 2 and "raise_at" not in options:
        return
    done = []
    with pytest.raises(WorldError, match=message) as refused:
        for episode in iter_episodes(source, {"id": WORLD, "bad_seed": 2, **options}, range(4), workers):
            done.append(episode.seed)  # noqa: PERF401  those before the error are wanted
    assert done == ([] if "success" in options else [0, 1])
    assert "\n" not in str(refused.value)


def test_a_world_that_ends_its_process_is_named(source):
    world = {"id": WORLD, "exit_at": 2}
    with pytest.raises(WorldError, match="a process that ran the world reaching:Reach-v0 ended in mid-run"):
        run_episodes(source, world, [0, 1], workers=2)


@pytest.mark.parametrize(
    ("made", "message"),
    [
        ({"size": 5}, r"shows agent_pos of shape \(3,\), and the policy was trained with observation.state"),
        ({"action": (0.0, 0.0)}, "takes vectors of 3 numbers, and the policy gives vectors of 2 numbers"),
    ],
)
def test_a_policy_that_does_not_fit_is_refused_before_a_run(tmp_path, made, message):
    policy = MacroPolicy.load(constant_policy(tmp_path, **made))
    with pytest.raises(WorldError, match=message):
        Stage(policy.planner(), {"id": WORLD})


def test_names_of_observations_lead_to_the_inputs(tmp_path, source):
    planner = source.planner(WORLD)
    assert inputs_of(config_of(planner)) == {STATE: (3,)}
    stage = Stage(planner, {"id": WORLD, "observations": {STATE: "agent_pos"}})
    assert stage.sees.told() == ["observation.state from agent_pos"]
    with pytest.raises(WorldError, match=r"has observation\.state=legs, and the world .* shows agent_pos"):
        Stage(planner, {"id": WORLD, "observations": {STATE: "legs"}})
