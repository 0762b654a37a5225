"""train.py: from a dataset to a run folder, and one line for every mistake."""

import errno
import importlib
import json
import re
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors import SafetensorError
from safetensors.torch import load_file

import train
from dpmacro.annotation.annotate import annotate
from dpmacro.boosting.crossfit import CLASSIFIER_FOLDS
from dpmacro.data.demonstrations import Demonstrations
from dpmacro.data.images import ImageTransform
from dpmacro.data.lerobot.reader import WORLD_FILE
from dpmacro.discovery.candidates import FINALISTS, LEADERS
from dpmacro.features.history import Recording
from dpmacro.features.memory import GIB, Plan
from dpmacro.metrics import segments
from dpmacro.policy.policy import MacroPolicy
from dpmacro.training import trainer as training
from dpmacro.training.data import TABLES
from dpmacro.training.options import DatasetOptions, PlannerOptions, TrainOptions
from dpmacro.training.run_folder import RunFolder
from dpmacro.utils import cli
from dpmacro.utils.hparams import read_scores
from tests.data.test_demonstrations import SPOILED, root  # noqa: F401  a fixture
from tests.utils.test_hparams import row

SMALL = [  # cut by the actions alone but for `trained`: judging by switch functions takes most of the time
    "--planner.switch_weight=0",
    "--planner.rounds=12",
    "--planner.restarts=4",
    "--planner.rectangles=150",
    "--planner.switch_rounds=5",
]
TINY = [option.replace("restarts=4", "restarts=1").replace("rounds=12", "rounds=4") for option in SMALL]
JOINT = [*SMALL[1:], "--planner.switch_weight=1", "--planner.restarts=2"]


def call(monkeypatch, *arguments):
    """Run the script's own path from arguments to exit status in this process."""
    monkeypatch.setattr(sys, "argv", ["train.py", *map(str, arguments)])
    cli.run(train.main, TrainOptions)


@pytest.fixture(scope="module")
def trained(recorded, tmp_path_factory) -> Path:
    """The run folder of a small DPBoost training."""
    output = tmp_path_factory.mktemp("runs") / "dpboost"
    with pytest.MonkeyPatch.context() as patch:
        call(patch, f"--dataset.root={recorded}", f"--output_dir={output}", *JOINT)
    return output


@pytest.fixture
def no_pictures(monkeypatch):
    """For tests that look at something else."""
    monkeypatch.setattr(training.TrainingPictures, "show", lambda *given: None)


@pytest.mark.parametrize(
    ("options", "settings"),
    [
        ({}, [(2, 1)]),
        ({"macros": 3, "max_transitions": 7}, [(3, 7)]),
        ({"type": "baseline", "macros": 3}, [(1, 0)]),
        ({"macros": "auto", "max_macros": 3}, [(1, 0), (2, 1), (2, 2), (3, 2), (3, 4)]),
        ({"macros": "auto", "max_macros": 3, "max_transitions": 5}, [(1, 0), (2, 5), (3, 5)]),
    ],
)
def test_the_searches_that_options_ask_for(recorded, tmp_path, options, settings):
    given = TrainOptions(DatasetOptions(root=recorded), PlannerOptions(rectangles=5, **options))
    trainer = training.Trainer(Demonstrations.load(recorded), given, RunFolder(tmp_path / "run"))
    assert trainer._settings == settings


def test_auto_tries_several_numbers_of_macro_actions(recorded, tmp_path, monkeypatch, capsys):
    choice = ["--planner.macros=auto", "--planner.max_macros=2", f"--output_dir={tmp_path / 'run'}"]
    call(monkeypatch, f"--dataset.root={recorded}", *choice, *TINY)
    told = capsys.readouterr().out
    for setting in ("Q=2 S=1", "Q=2 S=2"):
        assert told.count(setting) == 1
    assert (tmp_path / "run/figures/selection.png").exists()
    policy = MacroPolicy.load(tmp_path / "run/checkpoints/last/pretrained_model")
    marked = re.findall(r"Q=(\d) S=(\d) .*<-$", told, re.MULTILINE)
    if "one macro-action: no other gains anything" in told:
        assert not marked
        assert policy.config.macros == 1
    else:
        [(macros, bound)] = marked
        assert policy.config.macros <= int(macros)  # unused ones are pruned
        assert policy.config.max_transitions <= int(bound)


def test_a_run_folder_holds_what_lerobot_users_look_for(trained, recorded):
    checkpoint = trained / "checkpoints" / "000012"
    assert (trained / "checkpoints" / "last").resolve() == checkpoint.resolve()
    options = json.loads((checkpoint / "pretrained_model/train_config.json").read_text())
    assert options["dataset"]["root"] == str(recorded)
    assert options["planner"]["rounds"] == 12
    state = load_file(checkpoint / "training_state/segmentation.safetensors")
    assert len(state["labels"]) == int(state["lengths"].sum()) == 30
    pictures = {path.stem for path in (trained / "figures").iterdir()}
    assert pictures == {"timeline", "segmentation", "objective", "transitions", "pixels", "elbow"}
    assert not list(trained.rglob(".*")), "no temporary file stays"


def test_tensorboard_has_the_quantities_of_every_stage(trained):
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    events = EventAccumulator(str(trained / "tensorboard")).Reload()
    scalars = set(events.Tags()["scalars"])
    for stage in ("discover", "fit", "switch"):
        assert {f"loss/{stage}", f"accuracy/{stage}", f"time/{stage}_seconds_per_round"} <= scalars
    for name in (
        "label_changes",
        "mean_segment_frames",
        "occupancy_0",
        "occupancy_1",
        "agreement_with_truth",
    ):
        assert f"segmentation/fit/{name}" in scalars
    assert "selection/causal_loss" in scalars
    assert any(re.fullmatch(r"switch/recognised_\d_to_\d", name) for name in scalars)
    assert set(events.Tags()["images"]) == {
        f"figures/{name}"
        for name in ("timeline", "segmentation", "objective", "transitions", "pixels", "elbow")
    }
    assert len(events.Scalars("loss/fit")) == 12


def test_tensorboard_compares_trainings(trained, recorded):
    options, scores = row(trained / "tensorboard")
    assert options["dataset.root"] == str(recorded) and options["planner.rounds"] == 12
    assert options["world.id"] == "TwoFlags-v0"
    kept = read_scores(trained / "checkpoints/last/pretrained_model")
    assert scores == {f"score/{name}": pytest.approx(value) for name, value in kept.items()}
    assert kept["macro_actions"] == 2 and 0 <= kept["frame_accuracy"] <= 1 and kept["seconds"] > 0
    assert {"objective", "transitions", "recognised", "boundary_f1"} < set(kept)


def test_the_policy_sees_in_a_run_what_the_trainer_saw(trained, recorded):
    """Levels of a replayed episode, frame by frame as the planner computes them, equal those of the batch."""
    policy = MacroPolicy.load(trained / "checkpoints/last/pretrained_model")
    demonstrations = Demonstrations.load(recorded)
    (camera,) = policy.config.cameras
    images = torch.from_numpy(demonstrations.images)
    recording = Recording({camera: images}, torch.from_numpy(demonstrations.lengths))
    batch = policy.quantiser.levels(policy.features.values(recording.seen(policy.features)))
    for trajectory in demonstrations.trajectories:
        state = policy.initial_state(1)
        for n in range(trajectory.start, trajectory.stop):
            state = policy.act({camera: images[n : n + 1]}, state)[1]
            single = policy.quantiser.levels(policy.features.values(state.seen))
            assert torch.equal(single[:, 0], batch[:, n])


def test_a_seed_repeats_the_policy(trained, recorded, tmp_path, monkeypatch, no_pictures):
    call(monkeypatch, f"--dataset.root={recorded}", f"--output_dir={tmp_path / 'again'}", *JOINT)
    first, second = (
        load_file(folder / "checkpoints/last/pretrained_model/model.safetensors")
        for folder in (trained, tmp_path / "again")
    )
    assert first.keys() == second.keys()
    assert all(torch.equal(first[name], second[name]) for name in first)


@pytest.mark.parametrize("features", ["rectangles", "pixels"])
def test_the_baseline_is_one_classifier_without_switches(recorded, tmp_path, monkeypatch, features):
    call(
        monkeypatch,
        f"--dataset.root={recorded}",
        "--planner.type=baseline",
        f"--planner.features={features}",
        f"--output_dir={tmp_path / 'run'}",
        *TINY,
    )
    policy = MacroPolicy.load(tmp_path / "run/checkpoints/last/pretrained_model")
    assert (policy.config.type, policy.config.macros, policy.config.switches) == ("baseline", 1, ())


WAYS = {
    "convnets": (["--planner.learner=convnet", "--planner.switch_learner=convnet"], {"convnet"}),
    "few columns a round": (["--planner.drawn=20", "--planner.reuse=3"], {"stumps"}),
    "early stopping": (["--planner.early_stopping=true"], {"stumps"}),
}


@pytest.mark.parametrize("case", WAYS)
def test_every_way_to_boost_leaves_a_policy_of_its_kind(
    recorded, tmp_path, monkeypatch, capsys, no_pictures, case
):
    options, kinds = WAYS[case]
    options = [*options, "--planner.convnet.rounds=2", *TINY]
    call(monkeypatch, f"--dataset.root={recorded}", f"--output_dir={tmp_path}/run", *options)
    pretrained = tmp_path / "run/checkpoints/last/pretrained_model"
    names = {name.split(".")[1] for name in load_file(pretrained / "model.safetensors") if "actor" in name}
    assert names == kinds
    assert MacroPolicy.load(pretrained).config.macros == 2
    assert "all sorted" in capsys.readouterr().out


def test_a_policy_outlives_pictures_that_are_interrupted(recorded, tmp_path, monkeypatch):
    def interrupted(*given):
        raise KeyboardInterrupt

    monkeypatch.setattr(training.TrainingPictures, "show", interrupted)
    with pytest.raises(SystemExit):
        call(monkeypatch, f"--dataset.root={recorded}", f"--output_dir={tmp_path / 'run'}", *TINY)
    assert MacroPolicy.load(tmp_path / "run/checkpoints/last/pretrained_model").config.macros == 2


def test_one_demonstration_is_enough_and_no_other_judges_its_switch(recorded, tmp_path, monkeypatch, capsys):
    options = [f"--dataset.root={recorded}", "--dataset.episodes=[0]", f"--output_dir={tmp_path / 'run'}"]
    call(monkeypatch, *options, *TINY)
    printed = capsys.readouterr().out
    assert "of the changes in the demonstration it learned from" in printed and "left-out" not in printed


def test_more_actions_than_a_policy_holds_are_refused_before_any_work(recorded, tmp_path):
    demonstrations = Demonstrations.load(recorded)
    spoiled = replace(demonstrations, actions=np.where(demonstrations.actions == 1, 256, 0))
    options = TrainOptions(dataset=DatasetOptions(root=recorded))
    with pytest.raises(
        ValueError, match=r"has an action 256: number them from 0, a policy holds 256 at most"
    ):
        training.Trainer(spoiled, options, RunFolder(tmp_path / "run"))


def test_little_memory_draws_columns_and_says_so(recorded, tmp_path, monkeypatch, capsys, no_pictures):
    monkeypatch.setattr("dpmacro.features.memory.LIBRARIES", 0)
    monkeypatch.setattr("dpmacro.features.memory.LEAST_COLUMNS", 20)
    frames, height, width, _ = Demonstrations.load(recorded).images.shape
    tables = TABLES * 4 * 2 * (FINALISTS + LEADERS) * CLASSIFIER_FOLDS * 3  # 2 macro-actions, 3 actions
    limit = frames * (3 * height * width + tables + 150 + 4 * 100) / GIB
    monkeypatch.setattr("dpmacro.features.memory.VALUES", 1000)
    monkeypatch.setattr("dpmacro.features.memory.SAMPLED", 10)
    options = [f"--planner.memory_limit={limit:.9f}", *TINY]
    call(monkeypatch, f"--dataset.root={recorded}", f"--output_dir={tmp_path}/run", *options)
    assert re.search(r"columns +150 of 150, \d+ drawn at a time", capsys.readouterr().out)


@pytest.mark.parametrize(
    ("symmetric", "learner", "copies", "images"),
    [
        ("true", "stumps", 1, 0),
        ("false", "stumps", 0, 0),
        ("true", "convnet", 0, 3),
        ("false", "convnet", 0, 0),
    ],
)
def test_the_memory_of_mirror_images_is_planned(
    recorded, tmp_path, monkeypatch, symmetric, learner, copies, images
):
    given = []

    def noted(*asked):
        given.append(asked)
        raise ValueError("planned, and that is all that is looked at here")

    monkeypatch.setattr(Plan, "fitting", noted)
    options = [f"--dataset.symmetric={symmetric}", f"--planner.switch_learner={learner}", *SMALL]
    with pytest.raises(SystemExit):
        call(monkeypatch, f"--dataset.root={recorded}", f"--output_dir={tmp_path}/run", *options)
    [(demand, _)] = given
    assert demand.copies == copies
    scores = (2 if symmetric == "true" else 1) * 4 * 2  # of either direction of change
    assert demand.switch_bytes > scores + images * demand.frame_bytes
    assert demand.switch_bytes < 3000 + images * demand.frame_bytes


def switch_learners(monkeypatch):
    """The weak learners of switch functions that trainings will have made."""
    made, make = [], training.WeakLearners.for_switches

    def noted(*given):
        made.append(make(*given))
        return made[-1]

    monkeypatch.setattr(training.WeakLearners, "for_switches", noted)
    return made


def switch_frames(monkeypatch, *arguments):
    """Frames that the learner of the switch functions holds, in a training that goes no further."""
    held = []

    def noted(*given, switch_learner, **named):
        held.append(switch_learner.n_frames)
        raise ValueError("that is all that is looked at here")

    monkeypatch.setattr(training.DPBoost, "discover_levels", lambda *given, **named: None)
    monkeypatch.setattr(training.DPBoost, "fit_levels", noted)
    with pytest.raises(SystemExit):
        call(monkeypatch, *arguments, *TINY)
    [frames] = held
    return frames


@pytest.mark.parametrize(
    ("declared", "given", "copies"),
    [
        (False, [], 1),
        (True, [], 2),
        (False, ["--dataset.symmetric=true"], 2),
        (True, ["--dataset.symmetric=false"], 1),
        (True, ["--planner.recipe=paper"], 1),
        (True, ["--planner.macros=1"], 1),
    ],
)
def test_switch_functions_learn_from_mirror_images_of_a_symmetric_world(
    recorded, tmp_path, monkeypatch, declared, given, copies
):
    data = shutil.copytree(recorded, tmp_path / "data")
    about = json.loads((data / WORLD_FILE).read_text())
    (data / WORLD_FILE).write_text(json.dumps({**about, "symmetric": declared}))
    found = switch_frames(monkeypatch, f"--dataset.root={data}", f"--output_dir={tmp_path}/run", *given)
    assert found == copies * 30


def test_networks_mirror_images_and_need_no_mirrored_columns(recorded, tmp_path, monkeypatch):
    monkeypatch.setattr("dpmacro.training.learners.with_mirror_images", None)
    options = ["--planner.switch_learner=convnet", "--dataset.symmetric=true"]
    where = f"--dataset.root={recorded}", f"--output_dir={tmp_path}/run"
    assert switch_frames(monkeypatch, *where, *options) == 2 * 30


def test_shrunk_images_from_training_to_runs(recorded, tmp_path, monkeypatch, no_pictures):
    size = ["--dataset.image_size=[32,24]", *TINY]
    call(monkeypatch, f"--dataset.root={recorded}", f"--output_dir={tmp_path}/run", *size)
    path = tmp_path / "run/checkpoints/last/pretrained_model"
    config = MacroPolicy.load(path).config
    assert [(one.shape, one.stored_shape) for one in config.inputs.values()] == [((24, 32, 3), (48, 64))]
    monkeypatch.syspath_prepend(Path(train.__file__).parent / "datasets")
    for name, configuration, options in (
        ("annotate", "AnnotateOptions", [f"--dataset.root={recorded}"]),
        ("eval", "EvalOptions", ["--episodes=1", "--world.max_steps=9"]),
    ):
        script = importlib.import_module(name)
        output = f"--output_dir={tmp_path / name}"
        monkeypatch.setattr(sys, "argv", ["", f"--policy.path={path}", *options, output])
        cli.run(script.main, getattr(script, configuration))
    demonstrations = Demonstrations.load(recorded, transform=ImageTransform((32, 24)))
    labels = annotate(MacroPolicy.load(path), demonstrations).labels.numpy()
    told = json.loads((tmp_path / "annotate/segmentation.json").read_text())["demonstrations"]
    wanted = [part.tolist() for part in segments(labels, demonstrations.lengths)]
    assert [row["segments"] for row in told] == wanted
    assert json.loads((tmp_path / "eval/eval_info.json").read_text())["dpmacro"]["steps"] == [9]


def test_the_truth_may_change_as_often_as_it_likes(recorded):
    """The recorded demonstrations have 12, 7, 2 and 9 frames."""
    truth = np.concatenate([np.arange(length) // 4 for length in (12, 7, 2, 9)])
    demonstrations = replace(Demonstrations.load(recorded), truth=truth)
    told = "true phase   {} of frames agree; {} of 5 change points found within 10 frames, {} made"
    assert train.truth_report(truth, demonstrations) == told.format("100.0%", 5, 5)
    labels = np.concatenate([np.arange(length) // 6 for length in (12, 7, 2, 9)])
    assert train.truth_report(labels, demonstrations).endswith(
        "; 3 of 5 change points found within 10 frames, 3 made"
    )


MISTAKES = {
    "no root": ([], "give --dataset.root="),
    "missing dataset": (["--dataset.root={tmp}/nowhere"], "nowhere"),
    "no size": (
        ["--dataset.root={data}", "--dataset.image_size=[0,9]"],
        r"dataset\.image_size is \[0, 9\]: give",
    ),
    "too large a size": (
        ["--dataset.root={data}", "--dataset.image_size=[64,49]"],
        r"images are 64x48, image_size is 64x49: ask for smaller ones",
    ),
    "images that memory does not hold": (
        ["--dataset.root={data}", "--planner.memory_limit=2e-4"],
        r"30 images of 64x48 take 0\.00026 GiB, and there are 0\.0002 for them",
    ),
    "missing truth": (["--dataset.root={data}", "--dataset.truth=skill"], "no integer column 'skill'"),
    "missing episode": (["--dataset.root={data}", "--dataset.episodes=[7]"], "7"),
    "unknown option": (["--dataset.root={data}", "--planner.macro=2"], r"did you mean --planner\.macros\?"),
    "unreadable value": (
        ["--dataset.root={data}", "--planner.macros=two"],
        "planner.macros is 'two': give a number, or auto",
    ),
    "too few to try": (["--dataset.root={data}", "--planner.max_macros=1"], "planner.max_macros is 1"),
    "negative switch weight": (
        ["--dataset.root={data}", "--planner.switch_weight=-1"],
        "planner.switch_weight is -1",
    ),
    "auto with more macros than frames": (
        ["--dataset.root={data}", "--planner.macros=auto", "--planner.max_macros=31"],
        "planner.max_macros is 31 but",
    ),
    "no macros": (["--dataset.root={data}", "--planner.macros=0"], "planner.macros is 0"),
    "more macros than frames": (
        ["--dataset.root={data}", "--planner.macros=31", "--output_dir={tmp}/run"],
        "planner.macros is 31 but",
    ),
    "unknown planner": (["--dataset.root={data}", "--planner.type=act"], "planner.type is 'act'"),
    "unknown features": (["--dataset.root={data}", "--planner.features=hog"], "planner.features is 'hog'"),
    "no device": (["--dataset.root={data}", "--device=cuda:99"], "give --device=cpu"),
    "negative seed": (["--dataset.root={data}", "--seed=-1"], "seed is -1"),
    "seed that no generator takes": (
        ["--dataset.root={data}", f"--seed={2**63}"],
        "give 9223372036854775807 or less",
    ),
    "shrinkage": (["--dataset.root={data}", "--planner.shrinkage=0"], "planner.shrinkage is 0"),
    "unknown learner": (["--dataset.root={data}", "--planner.learner=forest"], "planner.learner is 'forest'"),
    "no rounds of networks": (
        ["--dataset.root={data}", "--planner.convnet.rounds=0"],
        r"planner\.convnet\.rounds is 0",
    ),
    "no memory": (
        ["--dataset.root={data}", "--planner.memory_limit=0.1", "--output_dir={tmp}/run"],
        r"memory_limit is 0\.1 GiB: 30 frames need 0\.65",
    ),
    "nothing to leave out": (
        [
            "--dataset.root={data}",
            "--dataset.episodes=[0]",
            "--planner.early_stopping=true",
            "--output_dir={tmp}/run",
        ],
        "early_stopping leaves demonstrations out",
    ),
    "existing folder": (["--dataset.root={data}", "--output_dir={data}"], "choose another --output_dir"),
}


@pytest.mark.parametrize("case", MISTAKES)
def test_a_mistake_gets_one_line_and_status_2(recorded, tmp_path, monkeypatch, capsys, case):
    arguments, message = MISTAKES[case]
    arguments = [argument.format(data=recorded, tmp=tmp_path) for argument in arguments]
    refused(monkeypatch, capsys, arguments, message)
    assert not list(tmp_path.iterdir()), "nothing is left behind"


@pytest.mark.parametrize("case", SPOILED)
def test_a_spoiled_dataset_gets_one_line_and_status_2(root, tmp_path, monkeypatch, capsys, case):  # noqa: F811
    spoil, message = SPOILED[case]
    spoil(root)
    refused(monkeypatch, capsys, [f"--dataset.root={root}", f"--output_dir={tmp_path / 'run'}"], message)
    assert not (tmp_path / "run").exists()


def refused(monkeypatch, capsys, arguments, message):
    with pytest.raises(SystemExit) as stop:
        call(monkeypatch, *arguments)
    lines = capsys.readouterr().err.strip().splitlines()
    assert stop.value.code == 2
    assert len(lines) == 1 and lines[0].startswith("error: ")
    assert re.search(message, lines[0])


def test_the_process_itself_exits_with_status_2_and_one_line():
    done = subprocess.run(
        [sys.executable, "train.py", "--dataset.root=nowhere"],
        cwd=Path(train.__file__).parent,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 2
    assert len(done.stderr.strip().splitlines()) == 1
    assert "nowhere" in done.stderr and "Traceback" not in done.stderr


def test_lengths_are_counted_per_demonstration(trained):
    lengths = load_file(trained / "checkpoints/last/training_state/segmentation.safetensors")["lengths"]
    assert np.array_equal(lengths.numpy(), [12, 7, 2, 9])


def told(capsys):
    """The line of an error, below progress bars."""
    return capsys.readouterr().err.replace("\r", "\n").strip().splitlines()[-1]


def test_a_second_training_is_refused_before_it_reads_anything(recorded, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(train, "read_demonstrations", lambda *given: pytest.fail("read"))
    with RunFolder.claimed(tmp_path / "run"), pytest.raises(SystemExit) as stop:
        call(monkeypatch, f"--dataset.root={recorded}", f"--output_dir={tmp_path / 'run'}")
    assert stop.value.code == 2
    assert re.fullmatch(
        rf"error: --output_dir={tmp_path}/run: process \d+ on .* writes to it; .*", told(capsys)
    )


def test_a_full_disk_at_a_checkpoint_says_what_is_not_saved(recorded, tmp_path, monkeypatch, capsys):
    def full(*given):
        raise SafetensorError("Error while serializing: I/O error: No space left on device (os error 28)")

    monkeypatch.setattr("dpmacro.training.run_folder.save_file", full)
    with pytest.raises(SystemExit) as stop:
        call(monkeypatch, f"--dataset.root={recorded}", f"--output_dir={tmp_path / 'run'}", *TINY)
    place = "checkpoints/000004/training_state/segmentation.safetensors: cannot be written (No space left"
    line = told(capsys)
    assert stop.value.code == 2 and place in line
    assert "what was found so far is safe" in line and "goes on; free some space or give" in line
    assert not (tmp_path / "run/checkpoints/last/pretrained_model/model.safetensors").exists()


def test_a_full_disk_after_the_policy_leaves_it_and_the_report(recorded, tmp_path, monkeypatch, capsys):
    def full(*given, **options):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("dpmacro.figures.style.Figure.savefig", full)
    monkeypatch.setattr(train, "write_row", full)
    monkeypatch.setattr(train, "write_scores", full)
    with pytest.raises(SystemExit) as stop:
        call(monkeypatch, f"--dataset.root={recorded}", f"--output_dir={tmp_path / 'run'}", *TINY)
    out, err = capsys.readouterr()
    assert stop.value.code == 2 and "objective " in out and "frames agree" in out
    last = f"{tmp_path}/run/checkpoints/last/pretrained_model"
    warned = f"warning: the picture timeline could not be made (OSError: [Errno {errno.ENOSPC}]"
    assert warned in err and f"; the policy is safe in {last}; free some space" in err
    assert MacroPolicy.load(Path(last)).config.macros == 2
