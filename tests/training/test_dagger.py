"""DAgger from a dataset to a run folder, with real runs in small worlds."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest
from safetensors.numpy import load_file
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from dpmacro.data.demonstrations import Demonstrations
from dpmacro.data.lerobot.reader import WORLD_FILE, StoredDataset
from dpmacro.policy.policy import MacroPolicy
from dpmacro.training import dagger
from dpmacro.training.pictures import TrainingPictures
from tests.training.test_train import SMALL, call

DAGGER = [
    "--dagger.iterations=2",
    "--dagger.episodes=2",
    "--dagger.validation_episodes=2",
    "--planner.rounds=3",
    "--planner.switch_rounds=2",
    "--planner.restarts=1",
    "--dagger.workers=1",
]


@pytest.fixture(scope="module")
def short_world(recorded, tmp_path_factory):
    """The recorded noise, from a world whose runs are short."""
    root = tmp_path_factory.mktemp("short") / "two_flags"
    shutil.copytree(recorded, root)
    about = json.loads((root / WORLD_FILE).read_text())
    about["world"].update(max_steps=25, render_size=[64, 48])
    about["symmetric"] = True
    (root / WORLD_FILE).write_text(json.dumps(about))
    return root


@pytest.fixture(scope="module", params=["dpboost", "baseline"])
def run(request, short_world, tmp_path_factory):
    """The run folder of every kind of planner; the baseline's images are shrunk, those it gathers, too."""
    size = ["--dataset.image_size=[32,24]"] if request.param == "baseline" else []
    output = tmp_path_factory.mktemp("runs") / request.param
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(TrainingPictures, "show", lambda *given: None)
        call(
            patch,
            f"--dataset.root={short_world}",
            f"--planner.type={request.param}",
            f"--output_dir={output}",
            *size,
            *SMALL,
            *DAGGER,
        )
    return output


def test_the_runs_of_every_iteration_are_a_lerobot_dataset(run):
    assert sorted(path.name for path in (run / "gathered").iterdir()) == ["1", "2"]
    for root in (run / "gathered").iterdir():
        gathered = Demonstrations.load(root)
        assert gathered.lengths.tolist() == [25, 25]
        assert gathered.images.shape[1:] == (48, 64, 3), "as the world shows them"
        assert gathered.truth_name == "phase"
        driver = Demonstrations.load(root, truth="driver")
        assert driver.truth_classes == ("planner", "teacher")
        assert driver.truth[0] == 0
        assert gathered.world["max_steps"] == 25 and gathered.symmetric
        store = StoredDataset.open(root)
        columns = store.columns(["next.done", "next.success"], store.episodes)
        assert columns["next.done"].sum() == 2 and not columns["next.success"].any()


def test_every_iteration_is_a_run_and_trains_on_more(run):
    lengths = []
    for number in range(3):
        folder = run / "iterations" / str(number) / "checkpoints/last"
        MacroPolicy.load(folder / "pretrained_model")
        lengths.append(len(load_file(folder / "training_state/segmentation.safetensors")["lengths"]))
    assert lengths == [4, 6, 8]


def test_the_best_planner_is_the_runs_own(run):
    """No iteration can succeed in 25 steps: of equals the first is kept."""
    best = run / "checkpoints/last/pretrained_model/model.safetensors"
    assert (
        best.read_bytes()
        == (run / "iterations/0/checkpoints/last/pretrained_model/model.safetensors").read_bytes()
    )


def test_a_better_planner_is_kept_and_patience_ends(short_world, tmp_path, monkeypatch):
    successes = [1, 2, 0, 2]
    validated = dagger._validated

    def counted(number, *given):
        return replace(validated(number, *given), successes=successes[number])

    monkeypatch.setattr(dagger, "_validated", counted)
    monkeypatch.setattr(TrainingPictures, "show", lambda *given: None)
    given = [f"--dataset.root={short_world}", f"--output_dir={tmp_path / 'run'}", *SMALL, *DAGGER]
    small = [option.replace("dagger.iterations=2", "dagger.iterations=9") for option in given]
    call(monkeypatch, *small, "--planner.type=baseline", "--dagger.episodes=1")
    models = [
        folder / "checkpoints/last/pretrained_model/model.safetensors"
        for folder in (tmp_path / "run", *(tmp_path / "run/iterations" / str(n) for n in range(4)))
    ]
    kept, *own = (model.read_bytes() for model in models)
    assert [kept == model for model in own] == [False, True, False, False], "of equals, the earlier"
    assert len(list((tmp_path / "run/iterations").iterdir())) == 4, "two without a new best are enough"
    events = EventAccumulator(str(tmp_path / "run/tensorboard")).Reload()
    assert [event.value for event in events.Scalars("dagger/pc_success")] == [50, 100, 0, 100]


def test_success_and_agreement_are_logged(run):
    events = EventAccumulator(str(run / "tensorboard"))
    events.Reload()
    assert [event.value for event in events.Scalars("dagger/trajectories")] == [4, 6, 8]
    assert np.isnan(events.Scalars("dagger/agreement")[0].value)
    agreement = [event.value for event in events.Scalars("dagger/agreement")[1:]]
    assert len(agreement) == 2 and all(0 <= value <= 1 for value in agreement)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--dagger.iterations=-1"], "dagger.iterations is -1: give 0 or more"),
        (["--dagger.episodes=0"], "dagger.episodes is 0: give 1 or more"),
        (["--dagger.iterations=1", "--dagger.seed=5010"], "dagger.seed is 5010"),
    ],
)
def test_mistakes_get_one_line(arguments, message, short_world, tmp_path, monkeypatch, capsys):
    with pytest.raises(SystemExit) as exit:
        call(monkeypatch, f"--dataset.root={short_world}", f"--output_dir={tmp_path / 'run'}", *arguments)
    assert exit.value.code == 2
    told = capsys.readouterr().err.strip().splitlines()
    assert message in told[-1]


def test_a_dataset_of_another_world_has_no_teacher(recorded, tmp_path, monkeypatch, capsys):
    root = tmp_path / "elsewhere"
    shutil.copytree(recorded, root)
    (root / WORLD_FILE).write_text(json.dumps({"world": {"id": "Elsewhere-v0"}, "truth": {}}))
    with pytest.raises(SystemExit) as exit:
        call(
            monkeypatch, f"--dataset.root={root}", "--dagger.iterations=1", f"--output_dir={tmp_path / 'run'}"
        )
    assert exit.value.code == 2
    assert "'Elsewhere-v0'" in capsys.readouterr().err
    assert not (tmp_path / "run").exists()
