"""Meta-World: experts that solve their tasks, stages that are the line that returned, seeds that repeat."""

import sys
from itertools import groupby

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from jaxtyping import TypeCheckError

from dpmacro.evaluation.recording import run_expert
from dpmacro.evaluation.rollouts import PlannerSource, replay, run_episodes
from dpmacro.worlds import EXPERTS, expert_of, metaworld
from dpmacro.worlds.base import Expert
from dpmacro.worlds.metaworld import FAMILY, STATE, TASKS, MetaWorld, ScriptedExpert, check_task, recording

PICK = "pick-place-v3"


def run_task(task, seed, noise=0.0):
    return run_expert({"id": FAMILY + task}, seed, noise)


@pytest.fixture
def installed():
    pytest.importorskip("metaworld")


@pytest.mark.usefixtures("installed")
@pytest.mark.parametrize("task", TASKS)
def test_the_expert_solves_the_task_in_several_stages(task):
    solved = 0
    for seed in range(3):
        run = run_task(task, seed, 0.1)
        if run is None:
            continue
        solved += 1
        frames, states, stages = len(run.actions), run.observations[STATE], run.truth["stage"]
        assert states.shape == (frames, 39) and run.actions.shape == (frames, 4)
        assert states.dtype == run.actions.dtype == run.rewards.dtype == np.float32
        assert stages.shape == run.rewards.shape == (frames,) and stages.dtype == np.int64
        assert np.abs(run.actions).max() <= 1
        assert len(set(stages)) >= 3 and set(stages) <= set(range(len(TASKS[task])))
    assert solved >= 2


@pytest.mark.usefixtures("installed")
def test_stages_come_in_the_order_of_the_task():
    run = run_task(PICK, 0)
    named = [TASKS[PICK][stage] for stage, _ in groupby(run.truth["stage"].tolist())]
    assert named == ["approach", "descend", "grasp", "carry"]
    run = run_task("assembly-v3", 0)
    named = [TASKS["assembly-v3"][stage] for stage, _ in groupby(run.truth["stage"].tolist())]
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

    run = run_task(task, 5, 0.1)
    stages = run.truth["stage"].tolist()
    lines = [traced(ENV_POLICY_MAP[task](), state) for state in run.observations[STATE]]
    pairs = set(zip(lines, stages, strict=True))
    assert len(pairs) == len(set(lines)) == len(set(stages))
    assert [stage for _, stage in sorted(pairs)] == sorted(set(stages))


@pytest.mark.usefixtures("installed")
@pytest.mark.parametrize("task", TASKS)
def test_a_seed_repeats_the_run_whatever_ran_before(task):
    first = run_task(task, 1, 0.1)
    other = run_task(task, 0, 0.1)
    np.random.seed(0)  # noqa: NPY002  what the package would draw from if left alone
    again = run_task(task, 1, 0.1)
    for name in ("actions", "rewards"):
        assert np.array_equal(getattr(first, name), getattr(again, name)), name
    assert np.array_equal(first.observations[STATE], again.observations[STATE])
    assert np.array_equal(first.truth["stage"], again.truth["stage"])
    assert not np.array_equal(first.observations[STATE][0], other.observations[STATE][0])


@pytest.mark.usefixtures("installed")
def test_the_told_actions_are_clean_and_the_gripper_is_not_disturbed(monkeypatch):
    done = []

    def step(self, action, original=MetaWorld.step):
        done.append(action.astype(np.float64))
        return original(self, action)

    monkeypatch.setattr(MetaWorld, "step", step)
    run = run_task(PICK, 3, 0.1)
    difference = np.array(done) - run.actions
    assert np.all(difference[:, 3] == 0)
    assert difference[:, :3].std() == pytest.approx(0.1, rel=0.3)
    expert = ScriptedExpert()
    expert.reset(MetaWorld(PICK))
    for state, action, stage in zip(run.observations[STATE], run.actions, run.truth["stage"], strict=True):
        assert np.array_equal(expert.act({STATE: state}, {}), action) and expert.stage == stage


@pytest.mark.usefixtures("installed")
@pytest.mark.filterwarnings("ignore")
def test_the_world_is_an_environment_and_its_expert_an_expert():
    env = MetaWorld(PICK)
    check_env(env, skip_render_check=True)
    expert = expert_of(FAMILY + PICK)
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
    assert run_task(PICK, 0, noise=30.0) is None


@pytest.mark.usefixtures("installed")
def test_another_version_of_an_expert_is_refused(monkeypatch):
    env = MetaWorld(PICK)
    monkeypatch.setitem(metaworld.TASKS, PICK, ("approach", "carry"))
    metaworld._expert.cache_clear()
    with pytest.raises(ValueError, match=r"^task pick-place-v3: its expert has 4 stages in this version"):
        ScriptedExpert().reset(env)


@pytest.mark.usefixtures("installed")
def test_pictures_have_the_size_asked_for_and_show_the_state(recwarn):
    source, world = PlannerSource("teacher"), {"id": FAMILY + "hammer-v3"}
    env = MetaWorld("hammer-v3", render_mode="rgb_array", pixels=True, image_size=32)
    first, _ = env.reset(seed=1)
    check_env(env, skip_render_check=True)
    second, _ = env.reset(seed=1)
    assert first["pixels"].shape == (32, 32, 3) and np.array_equal(first["pixels"], second["pixels"])
    assert not np.array_equal(first["pixels"], env.reset(seed=2)[0]["pixels"])
    assert env.render().shape == (480, 480, 3) and env.render().std() > 20
    env.close()
    views = [moment.view for moment in replay(source, {**world, "max_steps": 3}, 0, every=2)]
    assert [view is not None for view in views] == [True, False, True]
    [blind] = run_episodes(source, {**world, "max_steps": 3}, [0])
    [seeing] = run_episodes(source, {**world, "max_steps": 3, "pixels": True, "image_size": 16}, [0])
    assert np.array_equal(blind.actions, seeing.actions)


@pytest.mark.usefixtures("installed")
def test_the_expert_runs_alike_in_one_process_and_in_two():
    source, world = PlannerSource("teacher"), {"id": FAMILY + "coffee-push-v3"}
    alone, together = (run_episodes(source, world, [3, 4], workers) for workers in (1, 2))
    for one, other in zip(alone, together, strict=True):
        assert one.success and one.success_by == 'info["is_success"]' and one.first_success == one.steps - 1
        assert one.actions.dtype == np.float32 and one.actions.shape == (one.steps, 4)
        assert np.array_equal(one.actions, other.actions) and one.outcome == other.outcome


@pytest.mark.usefixtures("installed")
@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"max_steps": 0}, "max_steps is 0: give 1 or more"),
        ({"max_steps": True}, "max_steps is True"),
        ({"pixels": 1}, "pixels is 1: choose true or false"),
        ({"image_size": 4096}, "image_size is 4096: give 16 to 480 pixels"),
        ({"shadows": "no"}, "shadows is 'no'"),
        ({"render_mode": "human"}, "render_mode is 'human': choose None or 'rgb_array'"),
    ],
)
def test_options_are_checked(options, message):
    try:
        with pytest.raises(ValueError, match=f"^Meta-World: {message}"):
            MetaWorld(PICK, **options)
    except TypeCheckError:
        pytest.skip("annotations are checked at run time, before the option is")


@pytest.mark.usefixtures("installed")
def test_its_expert_teaches_no_other_world():
    class Elsewhere(gym.Env):
        unwrapped = object()

    with pytest.raises(ValueError, match="the teacher was given object: it teaches Meta-World only"):
        ScriptedExpert().reset(Elsewhere())


def test_the_noise_of_earlier_recordings_is_no_option_of_the_world():
    assert metaworld.complete_options({"noise": 0.1, "max_steps": 3}) == {"max_steps": 3}
    assert FAMILY in EXPERTS


@pytest.mark.parametrize("call", [check_task, MetaWorld, recording])
def test_what_is_no_task_is_refused(call):
    with pytest.raises(ValueError, match=r"^task is 'fly-v3': choose from pick-place-v3, "):
        call("fly-v3")


def test_without_metaworld_the_remedy_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "metaworld", None)
    with pytest.raises(ValueError, match=r"pip install -e '\.\[metaworld\]'"):
        MetaWorld(PICK)
