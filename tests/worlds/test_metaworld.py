"""Meta-World: experts that solve their tasks, stages that are the line that returned, seeds that repeat."""

import sys
from itertools import groupby

import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from dpmacro.worlds import metaworld
from dpmacro.worlds.base import Expert
from dpmacro.worlds.metaworld import STATE, TASKS, MetaWorld, ScriptedExpert, check_task, run_expert

PICK = "pick-place-v3"


@pytest.fixture
def installed():
    pytest.importorskip("metaworld")


@pytest.mark.usefixtures("installed")
@pytest.mark.parametrize("task", TASKS)
def test_the_expert_solves_the_task_in_several_stages(task):
    for seed in range(3):
        run = run_expert(task, seed, 0.1)
        assert run is not None
        frames = len(run.actions)
        assert run.states.shape == (frames, 39) and run.actions.shape == (frames, 4)
        assert run.states.dtype == run.actions.dtype == run.rewards.dtype == np.float32
        assert run.stages.shape == run.rewards.shape == (frames,) and run.stages.dtype == np.int64
        assert np.abs(run.actions).max() <= 1
        assert len(set(run.stages)) >= 3 and set(run.stages) <= set(range(len(TASKS[task])))


@pytest.mark.usefixtures("installed")
def test_stages_come_in_the_order_of_the_task():
    run = run_expert(PICK, 0)
    named = [TASKS[PICK][stage] for stage, _ in groupby(run.stages.tolist())]
    assert named == ["approach", "descend", "grasp", "carry"]
    run = run_expert("assembly-v3", 0)
    named = [TASKS["assembly-v3"][stage] for stage, _ in groupby(run.stages.tolist())]
    assert named == ["approach", "descend", "lift", "carry", "place"]


def traced(policy, state):
    """The line of `_desired_pos` that returns, seen by Python's tracing: another way to the same stage."""
    code, lines = type(policy)._desired_pos.__code__, []

    def inside(frame, event, value):
        if event == "return":
            lines.append(frame.f_lineno)
        return inside

    before = sys.gettrace()
    sys.settrace(lambda frame, event, value: inside if frame.f_code is code else None)
    try:
        policy.get_action(state)
    finally:
        sys.settrace(before)
    return lines[-1]


@pytest.mark.usefixtures("installed")
@pytest.mark.filterwarnings("ignore:Constant")
@pytest.mark.parametrize("task", TASKS)
def test_a_stage_is_the_line_that_returned(task):
    from metaworld.policies import ENV_POLICY_MAP

    run = run_expert(task, 5, 0.1)
    lines = [traced(ENV_POLICY_MAP[task](), state) for state in run.states]
    pairs = set(zip(lines, run.stages.tolist(), strict=True))
    assert len(pairs) == len(set(lines)) == len(set(run.stages))
    assert [stage for _, stage in sorted(pairs)] == sorted(set(run.stages.tolist()))


@pytest.mark.usefixtures("installed")
@pytest.mark.parametrize("task", TASKS)
def test_a_seed_repeats_the_run_whatever_ran_before(task):
    first = run_expert(task, 1, 0.1)
    other = run_expert(task, 2, 0.1)
    np.random.seed(0)  # noqa: NPY002  what the package would draw from if left alone
    again = run_expert(task, 1, 0.1)
    for name in ("states", "actions", "stages", "rewards"):
        assert np.array_equal(getattr(first, name), getattr(again, name)), name
    assert not np.array_equal(first.states[0], other.states[0])


@pytest.mark.usefixtures("installed")
def test_the_told_actions_are_clean_and_the_gripper_is_not_disturbed(monkeypatch):
    done = []

    def step(self, action, original=MetaWorld.step):
        done.append(action)
        return original(self, action)

    monkeypatch.setattr(MetaWorld, "step", step)
    run = run_expert(PICK, 3, 0.1)
    difference = np.array(done) - run.actions
    assert np.all(difference[:, 3] == 0)
    assert difference[:, :3].std() == pytest.approx(0.1, rel=0.3)
    expert = ScriptedExpert(PICK)
    for state, action, stage in zip(run.states, run.actions, run.stages, strict=True):
        assert np.array_equal(expert.act({STATE: state}, {}), action) and expert.stage == stage


@pytest.mark.usefixtures("installed")
@pytest.mark.filterwarnings("ignore")
def test_the_world_is_an_environment_and_its_expert_an_expert():
    env = MetaWorld(PICK)
    check_env(env, skip_render_check=True)
    expert = ScriptedExpert(PICK)
    assert isinstance(expert, Expert)
    observation, info = env.reset(seed=0)
    expert.reset(env)
    assert expert.stage == -1 and not info["is_success"]
    ended = False
    while not ended:
        observation, _, ended, truncated, info = env.step(expert.act(observation, info))
        assert not truncated and info["is_success"] == ended
    env.close()


@pytest.mark.usefixtures("installed")
def test_who_does_nothing_fails_when_time_is_up():
    env = MetaWorld(PICK, max_steps=7)
    for _ in range(2):
        env.reset(seed=0)
        ends = [env.step(np.zeros(4, np.float32))[2:] for _ in range(7)]
        assert [(ended, truncated) for ended, truncated, _ in ends] == [(False, False)] * 6 + [(False, True)]
        assert not any(info["is_success"] for *_, info in ends)


@pytest.mark.usefixtures("installed")
def test_a_run_that_fails_is_none():
    assert run_expert(PICK, 0, noise=30.0) is None


@pytest.mark.usefixtures("installed")
def test_another_version_of_an_expert_is_refused(monkeypatch):
    monkeypatch.setitem(metaworld.TASKS, PICK, ("approach", "carry"))
    with pytest.raises(ValueError, match=r"^task pick-place-v3: its expert has 4 stages in this version"):
        ScriptedExpert(PICK)


@pytest.mark.parametrize("call", [check_task, run_expert, MetaWorld, ScriptedExpert])
def test_what_is_no_task_is_refused(call):
    with pytest.raises(ValueError, match=r"^task is 'fly-v3': choose from pick-place-v3, "):
        call("fly-v3", *([0] if call is run_expert else []))


def test_without_metaworld_the_remedy_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "metaworld", None)
    with pytest.raises(ValueError, match=r"pip install -e '\.\[metaworld\]'"):
        run_expert(PICK, 0)
