"""Folders that scripts write to: one process at a time, and a full disk in a line that says what is safe."""

import errno
import importlib.util
import json
import sys
from pathlib import Path

import pytest
from noise import AVATAR
from segmented import random_policy

from dpmacro.utils import cli
from dpmacro.utils.claims import claimed
from dpmacro.worlds.two_flags.env import ACTIONS

ROOT = Path(__file__).parents[2]
KILLED = 2**22 + 1  # more than any process's number


def full(*given, **options):
    raise OSError(errno.ENOSPC, "No space left on device")


@pytest.fixture(scope="module")
def script():
    """By its path, a script as a module."""
    loaded = {}

    def load(path):
        if path not in loaded:
            spec = importlib.util.spec_from_file_location(f"placed_{Path(path).stem}", ROOT / path)
            loaded[path] = sys.modules[spec.name] = importlib.util.module_from_spec(spec)
            spec.loader.exec_module(loaded[path])
        return loaded[path]

    return load


@pytest.fixture(scope="module")
def policy(tmp_path_factory):
    folder = tmp_path_factory.mktemp("policy")
    random_policy("pixels", 2, (48, 64), ACTIONS, (AVATAR,)).save(folder)
    return folder


@pytest.fixture
def refused(script, monkeypatch, capsys):
    """The line with which a script refuses its arguments."""

    def call(path, options, *arguments):
        module = script(path)
        monkeypatch.setattr(sys, "argv", [path, *map(str, arguments)])
        with pytest.raises(SystemExit) as stop:
            cli.run(module.main, getattr(module, options))
        error = capsys.readouterr().err.replace("\r", "\n")
        assert stop.value.code == 2 and error.count("error: ") == 1 and "Traceback" not in error
        return error.strip().splitlines()[-1]

    return call


def test_a_second_evaluation_is_refused_before_a_run(script, refused, policy, tmp_path, monkeypatch):
    monkeypatch.setattr(script("eval.py"), "iter_episodes", lambda *given: pytest.fail("run"))
    monkeypatch.setattr(script("eval.py"), "check", lambda *given: [])
    with claimed(tmp_path / "out"):
        given = f"--policy.path={policy}", "--world.id=TwoFlags-v0", f"--output_dir={tmp_path / 'out'}"
        line = refused("eval.py", "EvalOptions", *given)
    assert f"error: --output_dir={tmp_path}/out: process " in line and "writes to it; wait for that" in line
    assert not (tmp_path / "out").exists()


def test_a_second_recording_is_refused_before_a_run(script, refused, tmp_path, monkeypatch):
    monkeypatch.setattr(script("datasets/record.py"), "expert_runs", lambda *given: pytest.fail("run"))
    with claimed(tmp_path / "data", "--root", beside=True):
        line = refused("datasets/record.py", "RecordConfig", f"--root={tmp_path / 'data'}")
        assert f"error: --root={tmp_path}/data: process " in line and "writes to it; wait for that" in line
    assert not list(tmp_path.iterdir())


def test_what_a_killed_recording_left_is_removed_and_named(script, refused, tmp_path, monkeypatch, capsys):
    (tmp_path / ".data.claim").write_text(json.dumps({"process": KILLED}))
    (tmp_path / ".data.abc.partial/dataset").mkdir(parents=True)
    monkeypatch.setattr(script("datasets/record.py"), "expert_runs", lambda *given: (one for one in ()))
    monkeypatch.setattr(sys, "argv", ["record.py", f"--root={tmp_path / 'data'}"])
    with pytest.raises(SystemExit):
        cli.run(script("datasets/record.py").main, script("datasets/record.py").RecordConfig)
    error = capsys.readouterr().err
    assert f"process {KILLED} was killed while it wrote to it; this one takes over and removes what" in error
    assert not list(tmp_path.iterdir())


def test_a_recording_for_which_the_disk_is_full_says_that_nothing_is_kept(
    script, refused, tmp_path, monkeypatch
):
    monkeypatch.setattr(script("datasets/record.py"), "expert_runs", full)
    line = refused("datasets/record.py", "RecordConfig", f"--root={tmp_path / 'data'}")
    told = (
        "cannot be written (No space left on device); nothing of it is kept; free some space or give another"
    )
    assert f"error: {tmp_path}/data: {told}" in line and not list(tmp_path.iterdir())


def test_a_second_annotation_is_refused_before_a_search(
    script, refused, recorded, policy, tmp_path, monkeypatch
):
    monkeypatch.setattr(script("datasets/annotate.py"), "by_policy", lambda *given: pytest.fail("read"))
    with claimed(tmp_path / "out"):
        given = f"--dataset.root={recorded}", f"--policy.path={policy}", f"--output_dir={tmp_path / 'out'}"
        line = refused("datasets/annotate.py", "AnnotateOptions", *given)
    assert f"error: --output_dir={tmp_path}/out: process " in line and "writes to it; wait for that" in line


def test_an_annotation_for_which_the_disk_is_full_says_what_is_safe(
    script, refused, recorded, policy, tmp_path, monkeypatch
):
    monkeypatch.setattr(script("datasets/annotate.py"), "write_report", full)
    given = f"--dataset.root={recorded}", f"--output_dir={tmp_path / 'out'}"
    line = refused("datasets/annotate.py", "AnnotateOptions", *given, f"--policy.path={policy}")
    told = "cannot be written (No space left on device); the dataset is as it was; free some space or give"
    assert f"error: {tmp_path}/out: {told}" in line
    (tmp_path / "out/training/checkpoints/last/pretrained_model").mkdir(parents=True)
    (tmp_path / "out/training/checkpoints/last/pretrained_model/model.safetensors").touch()
    safe = script("datasets/annotate.py").kept(tmp_path / "out")
    assert safe.endswith("out/training/checkpoints/last/pretrained_model, --policy.path takes it")


@pytest.mark.parametrize("name", ["episodes", "seed", "workers", "videos"])
def test_an_evaluation_refuses_numbers_that_nothing_can_count(refused, name):
    line = refused("eval.py", "EvalOptions", "--policy.type=teacher", f"--{name}={2**64}")
    assert line == f"error: --{name}={2**64}: it must be at most {2**32 - 1}"
