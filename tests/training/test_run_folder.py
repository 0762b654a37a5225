"""A run's folder: who may write to it, what a killed run leaves, and what is safe where the disk is full."""

import json
import warnings

import pytest

from dpmacro.training.run_folder import RunFolder
from dpmacro.utils.claims import CLAIM

KILLED = 2**22 + 1  # more than any process's number


@pytest.fixture
def left(tmp_path):
    """What a run leaves that was killed before its first policy."""
    folder = RunFolder(tmp_path / "run")
    folder.begin({"seed": 0}, "digest")
    (tmp_path / "run/tensorboard").mkdir()
    (tmp_path / "run/tensorboard/events").touch()
    (tmp_path / "run" / CLAIM).write_text(json.dumps({"process": KILLED}))
    return tmp_path / "run"


def save(run):
    (run / "checkpoints/000003/pretrained_model").mkdir(parents=True)
    (run / "checkpoints/000003/pretrained_model/model.safetensors").touch()
    (run / "checkpoints/last").unlink(missing_ok=True)
    (run / "checkpoints/last").symlink_to("000003")


def test_a_second_run_is_refused_though_nothing_is_written_yet(tmp_path):
    with RunFolder.claimed(tmp_path / "run") as folder:
        assert folder.path == tmp_path / "run"
        with pytest.raises(ValueError, match="writes to it"), RunFolder.claimed(tmp_path / "run"):
            pass
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize("saved", [False, True])
def test_what_a_killed_run_has_found_is_kept(left, saved):
    if saved:
        save(left)
    before = sorted(left.rglob("*"))
    refused = pytest.raises(
        ValueError, match=r"exists: choose another --output_dir, go on with it by --config_p"
    )
    with pytest.warns(UserWarning, match="takes over"), refused, RunFolder.claimed(left):
        pass
    assert sorted([*left.rglob("*"), left / CLAIM]) == before


def test_what_a_run_leaves_that_was_killed_before_it_began_is_taken_over(tmp_path):
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / CLAIM).write_text(json.dumps({"process": KILLED}))
    with pytest.warns(UserWarning, match="takes over"), RunFolder.claimed(tmp_path / "run") as folder:
        assert not folder.over and not folder.begun.exists()


def test_what_a_stranger_put_there_is_kept(left):
    (left / "notes.txt").touch()
    RunFolder(left, resume=True).forget()
    refused = pytest.raises(ValueError, match="exists: choose another")
    with pytest.warns(UserWarning), refused, RunFolder.claimed(left):
        pass
    assert [path.name for path in left.iterdir()] == ["notes.txt"]


@pytest.mark.parametrize("killed", [True, False])
def test_a_run_goes_on_in_its_folder(left, killed):
    if not killed:
        (left / CLAIM).unlink()
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        with RunFolder.claimed(left, resume=True) as folder:
            assert folder.path == left and (left / "tensorboard/events").exists()
    assert len(told) == killed


def test_a_policy_that_is_there_is_told_to_be_safe(tmp_path):
    folder = RunFolder(tmp_path)
    assert folder.saved() == "no policy is saved yet"
    folder.begin({"seed": 0}, "digest")
    assert folder.saved() == f"what was found so far is safe: train.py {folder.going_on} goes on"
    assert folder.begun.exists() and not folder.over
    save(tmp_path)
    assert folder.saved() == f"the policy is safe in {tmp_path}/checkpoints/last/pretrained_model"
