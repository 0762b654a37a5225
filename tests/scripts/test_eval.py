"""eval.py as a user runs it: in this process where that will do, as a command where processes matter."""

import importlib.util
import json
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import av
import pytest
import torch
from reaching import WORLD as REACH
from reaching import constant_policy
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from dpmacro.boosting.learners.stumps import StumpClassifier
from dpmacro.features.encoders.pixels import Pixels
from dpmacro.features.quantising import Quantiser
from dpmacro.metrics.success import wilson_interval
from dpmacro.policy.config import InputConfig, PolicyConfig
from dpmacro.policy.policy import MacroPolicy
from dpmacro.policy.recovery import RecoveringPlanner, Stretches
from dpmacro.utils import cli
from dpmacro.worlds.two_flags.diagnosis import OUTCOMES
from dpmacro.worlds.two_flags.env import ACTIONS
from tests.utils.test_hparams import row

SCRIPT = Path(__file__).parents[2] / "eval.py"
FIXED = {"flags": "fixed", "layout_seed": 3, "textures": "fixed", "start": "fixed", "start_spread": 0.1}
WORLD = {"id": "TwoFlags-v0", **FIXED, "teacher": "searching", "max_steps": 60, "render_size": [64, 48]}
SHORT = ["--world.max_steps=60", "--world.render_size=[64,48]"]


@pytest.fixture(scope="module")
def script():
    spec = importlib.util.spec_from_file_location("eval_script", SCRIPT)
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


def random_policy(world):
    """A policy that acts at random stumps' word and switches from macro-action 0 to 1 at some time."""
    generator = torch.Generator().manual_seed(0)

    def stumps(problems, classes):
        return StumpClassifier(
            torch.randint(18432, (4, problems), generator=generator),
            torch.randint(256, (4, problems), generator=generator).to(torch.uint8),
            torch.randn(4, problems, 2, classes, generator=generator),
        )

    pixels, inputs = Pixels.all("observation.image", 48, 64), {"observation.image": InputConfig((48, 64, 3))}
    cut = {"switches": ((0, 1),), "thresholds": (0.0,), "world": world}
    config = PolicyConfig("dpboost", 2, (0,), inputs, pixels.spec(), ACTIONS, 3, **cut)
    cuts = torch.arange(255, dtype=torch.int32).repeat(18432, 1)
    return MacroPolicy.compact(config, pixels, Quantiser(cuts), stumps(2, 3), stumps(1, 1))


def seeds_in(folder):
    """Those of the runs that an evaluation has kept."""
    lines = (folder / "runs.jsonl").read_text().splitlines()
    return [json.loads(line)["seed"] for line in lines[1:]]


@pytest.fixture(scope="module")
def policy(tmp_path_factory):
    folder = tmp_path_factory.mktemp("policy")
    random_policy(WORLD).save(folder)
    return folder


def call(script, monkeypatch, *options):
    monkeypatch.setattr(sys, "argv", ["eval.py", *map(str, options)])
    cli.run(script.main, script.EvalOptions)


def test_the_teacher_as_a_command(tmp_path):
    options = ["--policy.type=teacher", "--episodes=3", "--seed=7", "--workers=2", "--videos=2", *SHORT]
    command = [sys.executable, str(SCRIPT), *options, f"--output_dir={tmp_path}"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stderr
    assert "successes   0 of 3 runs" in done.stdout
    low, high = wilson_interval(0, 3)
    assert '      3     out of time\ntold by     info["is_success"]\nwritten to' in done.stdout
    assert f"0.0%, 95% Wilson interval {low:.1%} to {high:.1%}" in done.stdout
    assert "3/3" in done.stderr and "success 0%" in done.stderr

    info = json.loads((tmp_path / "eval_info.json").read_text())
    assert set(info) == {"per_task", "per_group", "overall", "dpmacro"}
    overall = info["overall"]
    assert (overall["n_episodes"], overall["pc_success"]) == (3, 0.0)
    assert overall["eval_ep_s"] == pytest.approx(overall["eval_s"] / 3)
    assert info["per_task"][0]["metrics"]["successes"] == [False] * 3
    assert info["per_group"]["TwoFlags-v0"]["video_paths"] == overall["video_paths"]
    ours = info["dpmacro"]
    assert ours["seeds"] == [7, 8, 9] and ours["steps"] == [60, 60, 60]
    assert ours["loops"] == [0, 0, 0] and ours["causes"] == ["out_of_time"] * 3
    assert ours["blue_steps"] == ours["first_changes"] == [None] * 3 and ours["last_macros"] == [-1] * 3
    assert set(ours["outcomes"]) <= set(OUTCOMES) and ours["interval_95"] == [low, high]
    assert ours["world"]["max_steps"] == 60 and ours["world"]["yaw_noise"] == 0.5
    assert (ours["planner"], ours["policy_path"]) == ("teacher", None)

    assert len(overall["video_paths"]) == 2
    for path in overall["video_paths"]:
        with av.open(path) as video:
            assert sum(1 for _ in video.decode(video=0)) == 60 + 45
    events = EventAccumulator(str(tmp_path / "tensorboard")).Reload()
    assert events.Scalars("eval/pc_success")[0].value == 0.0
    assert "eval/avg_sum_reward" in events.Tags()["scalars"]
    options, scores = row(tmp_path / "tensorboard")
    assert (options["evaluation.planner"], options["evaluation.first_seed"]) == ("teacher", 7)
    assert options["world.yaw_noise"] == 0.5
    assert scores["score/success"] == 0.0 and scores["score/success_high"] == pytest.approx(high)


def test_a_policy_runs_in_its_own_world_but_for_given_options(script, policy, tmp_path, monkeypatch, capsys):
    options = [f"--policy.path={policy}", "--episodes=2", "--world.yaw_noise=0", f"--output_dir={tmp_path}"]
    call(script, monkeypatch, *options)
    ours = json.loads((tmp_path / "eval_info.json").read_text())["dpmacro"]
    expected = {**WORLD, "ways": "any", "yaw_noise": 0.0, "renderer": "tiny"}
    assert ours["world"] == expected
    assert (ours["planner"], ours["policy_path"], ours["recovery"]) == ("dpboost", str(policy), False)
    assert sum(failure["runs"] for failure in ours["failures"]) == 2
    assert row(tmp_path / "tensorboard")[0]["world.id"] == WORLD["id"]
    assert {failure["macro"] for failure in ours["failures"]} <= {0, 1}
    assert ", macro-action " in capsys.readouterr().out

    call(script, monkeypatch, *options[:-1], f"--output_dir={tmp_path / 'again'}")
    again = json.loads((tmp_path / "again" / "eval_info.json").read_text())["dpmacro"]
    assert again == ours


@pytest.mark.parametrize(
    ("saved", "options", "runs"),
    [(True, [], True), (True, ["--policy.recovery=false"], False), (False, ["--policy.recovery=true"], True)],
)
def test_recovery_is_as_it_was_saved_unless_told(script, saved, options, runs, tmp_path, monkeypatch):
    policy = random_policy({**WORLD, "max_steps": 20})
    stretches = Stretches.of(torch.zeros(2).long(), torch.tensor([0, 1]), torch.tensor([2]))
    policy = replace(policy, config=replace(policy.config, recovery=saved), stretches=stretches)
    policy.save(tmp_path / "policy")
    made, init = [], RecoveringPlanner.__init__
    monkeypatch.setattr(RecoveringPlanner, "__init__", lambda *given: made.append(1) or init(*given))
    options = [f"--policy.path={tmp_path / 'policy'}", "--episodes=1", *options]
    call(script, monkeypatch, *options, f"--output_dir={tmp_path / 'out'}")
    ours = json.loads((tmp_path / "out" / "eval_info.json").read_text())["dpmacro"]
    assert ours["recovery"] is runs and bool(made) is runs


def test_recovery_of_a_policy_without_segments_is_refused(script, policy, tmp_path, monkeypatch, capsys):
    with pytest.raises(SystemExit):
        options = [f"--policy.path={policy}", "--policy.recovery=true", f"--output_dir={tmp_path / 'out'}"]
        call(script, monkeypatch, *options)
    error = capsys.readouterr().err
    assert error.startswith("error: ") and error.count("\n") == 1 and "run it without recovery" in error
    assert not (tmp_path / "out").exists()


def test_a_run_that_repeats_itself_ends_at_once(script, tmp_path, monkeypatch, capsys):
    """Red hides blue in this world, and the video, too, ends with the run."""
    options = [
        "--policy.type=teacher",
        "--episodes=1",
        "--seed=53",
        "--videos=1",
        "--world.render_size=[64,48]",
    ]
    call(script, monkeypatch, *options, f"--output_dir={tmp_path}")
    ours = json.loads((tmp_path / "eval_info.json").read_text())["dpmacro"]
    assert (ours["steps"], ours["loops"], ours["causes"]) == ([601], [600], ["spins"])
    printed = capsys.readouterr().out
    assert "causes\n      1     spins\nloops       1 of" in printed
    with av.open(str(tmp_path / "videos" / "TwoFlags-v0_0" / "eval_episode_0.mp4")) as video:
        assert sum(1 for _ in video.decode(video=0)) == 601 // 4 + 1 + 45


def test_a_success_has_no_cause(script, tmp_path, monkeypatch, capsys):
    options = ["--policy.type=teacher", "--episodes=1", "--seed=17", "--world.render_size=[64,48]"]
    call(script, monkeypatch, *options, f"--output_dir={tmp_path}")
    ours = json.loads((tmp_path / "eval_info.json").read_text())["dpmacro"]
    assert ours["causes"] == [""] and 0 < ours["blue_steps"][0] < ours["steps"][0] - 1
    assert "causes" not in capsys.readouterr().out


def test_failures_are_the_first_to_be_filmed(script, tmp_path, monkeypatch):
    filmed = []
    monkeypatch.setattr(
        script, "replay", lambda source, world, seed, every: filmed.append(seed) or (_ for _ in ())
    )
    monkeypatch.setattr("dpmacro.evaluation.videos.write_run", lambda path, moments, names: 0)
    episodes = [
        script.Episode(
            seed, outcome, *[torch.zeros(3).numpy().astype(kind) for kind in ("u1", "i1", "i1", "f4")]
        )
        for seed, outcome in enumerate(["success", "red_first", "success", "red_never_reached"])
    ]
    paths, wrong = script.write_videos(None, {"id": "Room-v0"}, episodes, 3, tmp_path)
    assert not wrong
    assert filmed == [1, 3, 0]
    assert [Path(path).name for path in paths] == [f"eval_episode_{index}.mp4" for index in (1, 3, 0)]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ([], "give either --policy.path"),
        (["--policy.type=teacher", "--policy.path=x"], "give either --policy.path"),
        (["--policy.type=wizard"], "--policy.type=wizard is unknown"),
        (["--policy.path=nowhere"], "nowhere holds no config.json"),
        (["--policy.type=teacher", "--episodes=0"], "--episodes=0: it must be at least 1"),
        (["--policy.type=teacher", "--workers=0"], "--workers=0: it must be at least 1"),
        (["--policy.type=teacher", "--videos=-1"], "--videos=-1: it must be at least 0"),
        (["--policy.type=teacher", "--seed=-1"], "--seed=-1: it must be at least 0"),
        (["--policy.type=teacher", "--episodes=many"], "many"),
        (["--policy.type=teacher", "--world.flags=none"], "choose 'random' or 'fixed'"),
        (["--policy.type=teacher", "--world.walls=3"], "TwoFlags has no option 'walls': choose among flags"),
        (["--policy.type=teacher", "--world.walls"], "--world.walls has no value: give one"),
        (["--policy.type=teacher", "--world.max_steps=many"], "max_steps is 'many': give a value like 3000"),
        (["--policy.type=teacher", "--world.observations=[arm]"], "--world.observations has 'arm'"),
        (["--policy.type=teacher", "--world.id=Nowhere-v0"], "world 'Nowhere-v0' has no teacher"),
        (["--policy.type=teacher", "--world.import=no_such"], "--world.import=no_such cannot be imported"),
        (["--policy.type=teacher", "--episods=3"], "did you mean --episodes?"),
        (["--policy.type=teacher", "--policy.recovery=false"], "--policy.recovery=False is for saved"),
        (["--segmentation", "--policy.path=x"], "unknown option --segmentation"),
    ],
)
def test_bad_options_are_one_line_and_status_2(options, message, script, tmp_path, monkeypatch, capsys):
    with pytest.raises(SystemExit) as exit_:
        call(script, monkeypatch, *options, f"--output_dir={tmp_path / 'out'}")
    error = capsys.readouterr().err
    assert exit_.value.code == 2
    assert error.startswith("error: ") and error.count("\n") == 1 and message in error
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("world", "message"),
    [
        ({"id": "Maze-v1"}, "there is no world 'Maze-v1'"),
        ({}, "name no world to run in: give one by --world.id="),
        ({"id": "TwoFlags-v0", "fog": 0.3}, "TwoFlags has no option 'fog'"),
        (
            {"id": "CartPole-v1"},
            "CartPole-v1 takes one of 2 actions, and the policy gives one of 3",
        ),
        ({"id": "MountainCar-v0"}, "the world MountainCar-v0 shows no observation.image"),
    ],
)
def test_a_policy_that_does_not_fit_its_world_is_refused(
    world, message, script, tmp_path, monkeypatch, capsys
):
    random_policy(world).save(tmp_path)
    with pytest.raises(SystemExit) as exit_:
        options = [f"--policy.path={tmp_path}", "--episodes=1", f"--output_dir={tmp_path / 'out'}"]
        call(script, monkeypatch, *options)
    assert not (tmp_path / "out").exists()
    error = capsys.readouterr().err
    assert exit_.value.code == 2 and error.count("\n") == 1 and message in error


@pytest.fixture
def reach(tmp_path):
    return constant_policy(tmp_path / "policy")


def test_a_policy_of_vectors_in_any_world(script, reach, tmp_path, monkeypatch, capsys):
    out, options = tmp_path / "out", ["--episodes=3", "--workers=2", "--videos=1", "--world.goal=2e0"]
    call(script, monkeypatch, f"--policy.path={reach}", *options, f"--output_dir={out}")
    printed = capsys.readouterr().out
    assert "sees        observation.state from agent_pos\n" in printed
    assert 'told by     info["success"]\n' in printed and "successes   3 of 3 runs" in printed
    assert "clipped     100.0% of steps had an action beyond what the world takes\n" in printed
    info = json.loads((out / "eval_info.json").read_text())
    ours = info["dpmacro"]
    assert ours["success_by"] == ['info["success"]'] and ours["world"] == {"id": REACH, "goal": 2.0}
    assert ours["clipped_share"] == 1 and ours["clipped_steps"] == ours["steps"]
    assert ours["first_successes"] == [steps - 1 for steps in ours["steps"]] and ours["periods"] == [0] * 3
    [video] = info["overall"]["video_paths"]
    assert Path(video).parent.name == "reaching_Reach-v0_0"
    with av.open(video) as film:
        assert sum(1 for _ in film.decode(video=0)) == ours["steps"][0] + 45


def test_another_world_takes_none_of_the_options_of_the_demonstrations(script, tmp_path, monkeypatch):
    policy = constant_policy(tmp_path / "policy", world={"id": "Elsewhere-v0", "fog": 1})
    options = [f"--world.id={REACH}", "--world.import=reaching", "--world.success=success", "--episodes=1"]
    options.append("--world.observations=[observation.state=agent_pos]")
    call(script, monkeypatch, f"--policy.path={policy}", *options, f"--output_dir={tmp_path / 'out'}")
    ours = json.loads((tmp_path / "out/eval_info.json").read_text())["dpmacro"]
    assert ours["world"] == {
        "id": REACH,
        "import": "reaching",
        "observations": {"observation.state": "agent_pos"},
        "success": "success",
    }
    assert ours["outcomes"] == ["success"]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--world.raise_at=2"], "raised RuntimeError: the arm fell off, at step 1 of the run of seed 2"),
        (["--world.nan_at=1"], "shows agent_pos with nan as number 1 at step 0 of the run of seed 2"),
    ],
)
def test_runs_before_an_error_are_kept(script, reach, options, message, tmp_path, monkeypatch, capsys):
    out = tmp_path / "out"
    given = [f"--policy.path={reach}", "--seed=0", "--episodes=5", f"--output_dir={out}"]
    with pytest.raises(SystemExit) as exit_:
        call(script, monkeypatch, *given, "--world.bad_seed=2", *options)
    last = capsys.readouterr().err.splitlines()[-1]
    assert exit_.value.code == 2 and message in last
    assert last.endswith(f"the 2 runs before it are kept in {out / 'runs.jsonl'}")
    assert [path.name for path in out.iterdir()] == ["runs.jsonl"]
    assert seeds_in(out) == [0, 1]
    with pytest.raises(SystemExit):
        call(script, monkeypatch, *given)
    error = capsys.readouterr().err
    assert "was begun with world.bad_seed 2, and now it is left out; run the command" in error


def test_runs_before_an_interrupt_are_kept(script, reach, tmp_path, monkeypatch, capsys):
    def interrupted(source, world, seeds, workers, before):
        yield from script.iter_episodes(source, world, seeds[:2], 1)
        raise KeyboardInterrupt

    monkeypatch.setattr(script, "run", interrupted)
    with pytest.raises(SystemExit) as exit_:
        call(script, monkeypatch, f"--policy.path={reach}", f"--output_dir={tmp_path / 'out'}")
    assert exit_.value.code == 130
    assert seeds_in(tmp_path / "out") == [10000, 10001]
    assert f"the same command with --output_dir={tmp_path / 'out'} goes on" in capsys.readouterr().err


def test_an_error_before_the_first_run_leaves_no_folder(script, reach, tmp_path, monkeypatch, capsys):
    options = [f"--policy.path={reach}", "--world.nan_at=0", f"--output_dir={tmp_path / 'out'}"]
    with pytest.raises(SystemExit):
        call(script, monkeypatch, *options)
    error = capsys.readouterr().err.splitlines()[-1]
    assert "nan" in error and "kept" not in error and not (tmp_path / "out").exists()


def test_videos_of_a_world_without_pictures_are_refused(script, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("reaching.Reach.metadata", {"render_modes": []})
    policy = constant_policy(tmp_path / "policy")
    with pytest.raises(SystemExit):
        options = ["--videos=2", f"--output_dir={tmp_path / 'out'}"]
        call(script, monkeypatch, f"--policy.path={policy}", *options)
    assert "--videos=2, and the world reaching:Reach-v0 renders no pictures" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_results_outlive_videos_that_are_interrupted(script, tmp_path, monkeypatch):
    def interrupted(*given):
        raise KeyboardInterrupt

    monkeypatch.setattr(script, "write_videos", interrupted)
    with pytest.raises(SystemExit):
        call(
            script,
            monkeypatch,
            "--policy.type=teacher",
            "--episodes=1",
            "--videos=1",
            *SHORT,
            f"--output_dir={tmp_path}",
        )
    info = json.loads((tmp_path / "eval_info.json").read_text())
    assert len(info["dpmacro"]["outcomes"]) == 1 and info["overall"]["video_paths"] == []


def test_results_outlive_a_reader_who_closes_the_pipe(tmp_path):
    options = ["--policy.type=teacher", "--episodes=1", *SHORT, f"--output_dir={tmp_path}"]
    command = [sys.executable, "-u", str(SCRIPT), *options]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL) as running:
        running.stdout.close()
        assert running.wait(timeout=60) == 2
    assert json.loads((tmp_path / "eval_info.json").read_text())["dpmacro"]["seeds"] == [10000]


def test_a_folder_by_date_ends_in_the_name_whatever_it_holds(script):
    assert script.default_output_dir("100%Success").name.endswith("_100%Success")


def test_results_are_never_overwritten(script, tmp_path, monkeypatch, capsys):
    (tmp_path / "eval_info.json").write_text("{}")
    with pytest.raises(SystemExit) as exit_:
        call(script, monkeypatch, "--policy.type=teacher", f"--output_dir={tmp_path}")
    assert exit_.value.code == 2 and "already holds an eval_info.json" in capsys.readouterr().err
    assert (tmp_path / "eval_info.json").read_text() == "{}"


def test_a_broken_policy_is_refused(script, policy, tmp_path, monkeypatch, capsys):
    shutil.copytree(policy, tmp_path / "broken")
    (tmp_path / "broken" / "model.safetensors").write_bytes(b"no")
    with pytest.raises(SystemExit) as exit_:
        call(script, monkeypatch, f"--policy.path={tmp_path / 'broken'}")
    error = capsys.readouterr().err
    assert exit_.value.code == 2 and error.count("\n") == 1 and "model.safetensors cannot be read" in error


def test_a_mistake_as_a_command(tmp_path):
    command = [sys.executable, str(SCRIPT), "--policy.type=wizard"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False, cwd=tmp_path)
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1)
    assert "--policy.type=wizard is unknown" in done.stderr


def test_a_worker_imports_neither_torch_nor_scipy(script):
    """It imports the script anew, and a teacher has no use for either."""
    code = (
        "import sys, importlib.util as u\n"
        f"spec = u.spec_from_file_location('worker', {str(SCRIPT)!r})\n"
        "module = sys.modules['worker'] = u.module_from_spec(spec)\n"
        "spec.loader.exec_module(module)\n"
        "sys.exit(bool({'torch', 'scipy.stats'} & set(sys.modules)))"
    )
    assert subprocess.run([sys.executable, "-c", code], timeout=60, check=False).returncode == 0
