"""DAgger in worlds that show vectors and take vectors, and what is refused before anything is trained."""

import itertools
import json
import shutil
from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest

from dpmacro.data.demonstrations import Demonstrations
from dpmacro.data.lerobot.reader import WORLD_FILE, StoredDataset
from dpmacro.evaluation.recording import run_expert
from dpmacro.evaluation.run_writer import writing_runs
from dpmacro.policy.policy import MacroPolicy
from dpmacro.training import collection, dagger
from dpmacro.training.pictures import TrainingPictures
from dpmacro.worlds import recording_of
from dpmacro.worlds.base import GaveUp
from dpmacro.worlds.two_places import STATE, Expert
from tests.training.test_train import TINY, call

WORLD = {"id": "TwoGoals-v0", "max_steps": 60}
SEED = 20_000
SHORT = [
    "--dagger.iterations=1",
    "--dagger.episodes=2",
    "--dagger.validation_episodes=1",
    "--dagger.workers=1",
    f"--dagger.seed={SEED}",
    "--planner.order=auto",
]


def record(root, count):
    """The expert's runs in a file, called now this task and now that."""
    runs = filter(None, (run_expert(WORLD, seed) for seed in itertools.count()))
    with writing_runs(root, WORLD, recording_of(WORLD["id"])) as writer:
        for number, run in enumerate(itertools.islice(runs, count)):
            writer.add(replace(run, task=f"task {number % 2}"))
    return root


@pytest.fixture(scope="module")
def goals(tmp_path_factory):
    return record(tmp_path_factory.mktemp("goals") / "data", 4)


@pytest.fixture(scope="module")
def run(goals, tmp_path_factory):
    output = tmp_path_factory.mktemp("runs") / "goals"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(TrainingPictures, "show", lambda *given: None)
        call(patch, f"--dataset.root={goals}", f"--output_dir={output}", *TINY, *SHORT)
    return output


def test_gathered_vectors_are_the_teachers_where_the_planner_went(run, goals):
    stored, demonstrations = Demonstrations.load(run / "gathered/1"), Demonstrations.load(goals)
    policy = MacroPolicy.load(run / "iterations/0/checkpoints/last/pretrained_model")
    assert stored.action_names == demonstrations.action_names and stored.vector
    assert stored.state_names == demonstrations.state_names
    assert stored.world == WORLD and stored.fps == demonstrations.fps
    assert (stored.truth_name, stored.truth_classes) == ("phase", ("blue", "red"))
    env, planner, teacher = gym.make(**WORLD).unwrapped, policy.planner(), Expert()
    successes, driven = [], 0
    for seed, frames in zip((SEED, SEED + 1), stored.trajectories, strict=True):
        observation, info = env.reset(seed=seed)
        planner.reset(env)
        teacher.reset(env)
        for state, action in zip(stored.observations[STATE][frames], stored.actions[frames], strict=True):
            assert np.array_equal(state, observation[STATE])
            assert np.array_equal(action, teacher.act(observation, info))
            chosen = planner.act(observation, info)
            driven += np.abs(chosen - action).max() > 0.2
            observation, _, _, _, info = env.step(chosen)
        successes.append(info["is_success"])
    assert driven > 0, "a planner that does all that the teacher does shows nothing"
    store = StoredDataset.open(run / "gathered/1")
    told = store.columns(["next.success", "next.done", "driver"], store.episodes)
    ends = np.flatnonzero(told["next.done"])
    assert told["next.success"][ends].tolist() == successes and not told["driver"].any()


def test_later_iterations_keep_the_order_that_the_first_found(run):
    models = (run / "iterations" / number / "checkpoints/last/pretrained_model" for number in "01")
    assert [MacroPolicy.load(model).config.order for model in models] == ["chain", "chain"]


def refused(patch, capsys, tmp_path, *arguments):
    """The line that a script's mistake gets; nothing was trained."""
    with pytest.raises(SystemExit) as exit:
        call(patch, f"--output_dir={tmp_path / 'run'}", *arguments, *TINY, *SHORT)
    assert exit.value.code == 2 and not (tmp_path / "run").exists()
    told = [line for line in capsys.readouterr().err.splitlines() if "column/s" not in line]
    assert len(told) == 1
    return told[0]


def test_tasks_that_would_be_inputs_are_refused(tmp_path, monkeypatch, capsys):
    given = f"--dataset.root={record(tmp_path / 'ten', 10)}"
    said = refused(monkeypatch, capsys, tmp_path, given)
    assert "has 2 tasks, and no world shows the task of a frame: choose one by --dataset.task" in said


@pytest.mark.parametrize(
    ("world", "message"),
    [
        ({"id": "TwoFlags-v0"}, "the world TwoFlags-v0 shows no observation.state, which the policy sees"),
        ({**WORLD, "fog": 1}, "the world TwoGoals-v0 cannot be made with {'max_steps': 60, 'fog': 1}"),
    ],
)
def test_worlds_that_do_not_fit_are_refused(world, message, goals, tmp_path, monkeypatch, capsys):
    root = shutil.copytree(goals, tmp_path / "other")
    about = json.loads((root / WORLD_FILE).read_text())
    (root / WORLD_FILE).write_text(json.dumps({**about, "world": world}))
    assert message in refused(monkeypatch, capsys, tmp_path, f"--dataset.root={root}")


def test_a_teacher_that_gives_up_at_once_leaves_nothing_to_gather(goals, tmp_path, monkeypatch):
    monkeypatch.setattr(dagger, "gather", lambda *given: (visit for visit in [None, None]))
    monkeypatch.setattr(TrainingPictures, "show", lambda *given: None)
    given = f"--dataset.root={goals}", f"--output_dir={tmp_path / 'run'}", *TINY, *SHORT
    with pytest.raises(SystemExit) as exit:
        call(monkeypatch, *given)
    assert exit.value.code == 2
    assert list((tmp_path / "run/gathered").iterdir()) == []


def test_a_visit_ends_where_the_teacher_gives_up(run, monkeypatch):
    path = run / "iterations/0/checkpoints/last/pretrained_model"
    source, calls, act = collection.PlannerSource("policy", path), [], Expert.act

    def tired(self, *given):
        calls.append(given)
        if len(calls) % 4 == 0:
            raise GaveUp
        return act(self, *given)

    monkeypatch.setattr(Expert, "act", tired)
    visit = collection.visit(source, WORLD, {STATE: (10,)}, 0)
    assert len(visit.run.actions) == 3 and not visit.run.success
    calls += [None] * 3
    assert collection.visit(source, WORLD, {STATE: (10,)}, 0) is None


@pytest.mark.parametrize(
    ("one", "other", "agree"),
    [
        ([0.0, 0.0, 5.0], [0.19, -0.19, 500.0], True),
        ([0.0, 0.0, 0.0], [0.21, 0.0, 0.0], False),
        ([0.0, 0.0, 0.0], [0.0, -0.21, 0.0], False),
    ],
)
def test_vectors_agree_within_a_tenth_of_the_range(one, other, agree):
    """The third number has no bounds, and does not count."""
    space = gym.spaces.Box(np.float32([-1, -1, -np.inf]), np.float32([1, 1, np.inf]))
    assert collection._agree(space, np.float32(one), np.float32(other)) is agree


def test_classes_agree_where_they_are_equal():
    assert collection._agree(gym.spaces.Discrete(3), 1, 1)
    assert not collection._agree(gym.spaces.Discrete(3), 1, 2)
