"""Trainings that were stopped and go on: processes that are killed, and one line for what cannot go on."""

import json
import shutil
import sys
from dataclasses import replace

import pytest
from stopped import killed

import train
from dpmacro.boosting import crossfit
from dpmacro.training import dagger, trainer
from dpmacro.training.options import TrainOptions
from dpmacro.training.pictures import TrainingPictures
from dpmacro.utils import cli
from dpmacro.utils.stages import Stages
from tests.training.test_dagger import DAGGER, short_world  # noqa: F401  a fixture
from tests.training.test_train import SMALL, TINY, call

LAST = "checkpoints/last/pretrained_model"
OPTIONS = [*TINY, "--dataset.image_size=[32,24]", "--save_freq=3"]
NEVER = 10**6
FOUND = (
    f"{LAST}/model.safetensors",
    f"{LAST}/config.json",
    f"{LAST}/../training_state/segmentation.safetensors",
)


def train_in_process(*arguments):
    """What a process does that is killed on the way: train.py, as quick as conftest.py makes it."""
    TrainingPictures.show = lambda *given: None
    crossfit.CLASSES = replace(crossfit.CLASSES, shared=12, own=12)
    sys.argv = ["train.py", *arguments]
    cli.run(train.main, TrainOptions)


def going_on(run):
    return [f"--config_path={run}/{LAST}/train_config.json", "--resume=true"]


def found(run):
    return [(run / name).read_bytes() for name in FOUND]


@pytest.fixture(autouse=True)
def no_pictures(monkeypatch):
    monkeypatch.setattr(trainer.TrainingPictures, "show", lambda *given: None)


@pytest.fixture(scope="module")
def undisturbed(recorded, tmp_path_factory):
    run = tmp_path_factory.mktemp("runs") / "undisturbed"
    assert not killed(
        train_in_process, [f"--dataset.root={recorded}", f"--output_dir={run}", *OPTIONS], NEVER
    )
    return run


def test_a_training_that_was_killed_three_times_ends_as_if_nothing_had(
    recorded, undisturbed, tmp_path, monkeypatch, capsys
):
    run = tmp_path / "run"
    begun = [f"--dataset.root={recorded}", f"--output_dir={run}", *OPTIONS]
    assert killed(train_in_process, begun, 9)
    kept = len(list((run / "checkpoints/000000/training_state/stages").iterdir()))
    assert kept and not list(run.rglob("model.safetensors"))
    for at, before in ((4, True), (7, False)):
        assert killed(train_in_process, going_on(run), at, before)
    assert not killed(train_in_process, going_on(run), NEVER)
    assert found(run) == found(undisturbed)
    assert sorted(one.name for one in (run / "checkpoints").iterdir()) == ["000004", "last"]
    call(monkeypatch, *going_on(run))
    assert f"{run} is over: its policy is in {run / LAST}" in capsys.readouterr().out


def test_options_of_a_run_are_kept_but_for_what_changes_nothing(undisturbed):
    options = json.loads((undisturbed / LAST / "train_config.json").read_text())
    assert options["output_dir"] == str(undisturbed) and options["resume"] is False


@pytest.fixture
def stopped(recorded, tmp_path, capsys):
    """A run that was interrupted at its third stage."""
    root = shutil.copytree(recorded, tmp_path / "data")
    computed = Stages.run

    def interrupted(self, name, compute):
        if self._number == 2 and self.rounds is None:
            raise KeyboardInterrupt
        return computed(self, name, compute)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Stages, "run", interrupted)
        with pytest.raises(SystemExit) as ended:
            call(patch, f"--dataset.root={root}", f"--output_dir={tmp_path / 'run'}", *OPTIONS)
    assert ended.value.code == cli.INTERRUPTED
    (tmp_path / "told").write_text(capsys.readouterr().err)
    return tmp_path / "run"


def refused(capsys, monkeypatch, *arguments):
    capsys.readouterr()
    with pytest.raises(SystemExit) as ended:
        call(monkeypatch, *arguments)
    assert ended.value.code == cli.USAGE_ERROR
    [line] = [one for one in capsys.readouterr().err.splitlines() if one.startswith("error: ")]
    return line


def test_what_is_interrupted_says_how_it_goes_on(stopped, tmp_path, monkeypatch, capsys):
    how = " ".join(going_on(stopped))
    assert f"what was found so far is safe: train.py {how} goes on" in (tmp_path / "told").read_text()
    again = [f"--dataset.root={tmp_path / 'data'}", f"--output_dir={stopped}", *OPTIONS]
    assert f"exists: choose another --output_dir, go on with it by {how}" in refused(
        capsys, monkeypatch, *again
    )
    call(monkeypatch, *going_on(stopped))
    assert (stopped / LAST / "model.safetensors").exists()


def test_a_mistake_that_is_seen_before_anything_is_found_leaves_nothing(
    recorded, tmp_path, monkeypatch, capsys
):
    given = [f"--dataset.root={recorded}", f"--output_dir={tmp_path / 'run'}", *OPTIONS]
    assert "planner.macros is 9999" in refused(capsys, monkeypatch, *given, "--planner.macros=9999")
    assert not (tmp_path / "run").exists()


def test_what_cannot_go_on_is_told_in_a_line(stopped, tmp_path, monkeypatch, capsys):
    def line(*arguments):
        return refused(capsys, monkeypatch, *arguments)

    data = f"--dataset.root={tmp_path / 'data'}"
    assert "resume is true without a run" in line(data, "--resume=true")
    assert "holds no run to go on with" in line(data, "--resume=true", f"--output_dir={tmp_path}")
    assert "is no folder" in line(data, "--resume=true", f"--output_dir={tmp_path / 'none'}")
    changed = line(*going_on(stopped), "--planner.switch_rounds=6")
    assert "planner.switch_rounds is 6" in changed and "begun with 5" in changed
    for file in (stopped / "checkpoints/000000/training_state/stages").glob("00001.pt"):
        file.write_bytes(b"half")
    assert "00001.pt cannot be read" in line(*going_on(stopped))
    digest = stopped / "checkpoints/000000/training_state/data.json"
    digest.write_text(json.dumps({"sha256": "other"}))
    assert "is not what" in line(*going_on(stopped)) and "another --output_dir" in line(*going_on(stopped))


@pytest.mark.parametrize("at", ["gathered", "validated"])
def test_dagger_goes_on_with_its_iteration(at, short_world, tmp_path, monkeypatch):  # noqa: F811
    given = [f"--dataset.root={short_world}", *SMALL, *DAGGER, "--planner.type=baseline"]
    call(monkeypatch, *given, f"--output_dir={tmp_path / 'whole'}")

    def interrupted(*_):
        raise KeyboardInterrupt

    name = {"gathered": "annotate", "validated": "_tell"}[at]
    with pytest.MonkeyPatch.context() as patch:
        told = getattr(dagger, name)
        patch.setattr(dagger, name, lambda *one: interrupted() if at == "gathered" else told(*one))
        if at == "validated":
            patch.setattr(dagger, name, lambda one, *rest: interrupted() if one.number else told(one, *rest))
        with pytest.raises(SystemExit):
            call(patch, *given, f"--output_dir={tmp_path / 'run'}")
    assert (tmp_path / "run/gathered/1/meta/info.json").exists()
    call(monkeypatch, *going_on(tmp_path / "run"))
    assert found(tmp_path / "run") == found(tmp_path / "whole")
    for number in ("1", "2"):
        both = [tmp_path / run / "iterations" / number for run in ("run", "whole")]
        assert found(both[0]) == found(both[1])
