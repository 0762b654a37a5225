import os
import signal
from pathlib import Path

import pytest

from dpmacro.utils.files import replace_folder


@pytest.fixture
def folders(tmp_path):
    """The old folder, the new one, and a free name."""
    for name in ("old", "new"):
        (tmp_path / name / "deep").mkdir(parents=True)
        (tmp_path / name / "deep/file").write_text(name)
    return tmp_path / "old", tmp_path / "new", tmp_path / "aside"


def contents(folders):
    return [(folder / "deep/file").read_text() if folder.exists() else None for folder in folders]


def test_the_new_folder_takes_the_place_of_the_old(folders):
    replace_folder(*folders)
    assert contents(folders) == ["new", None, "old"]


@pytest.mark.parametrize("failing", ["old", "new"])
@pytest.mark.parametrize("error", [OSError, KeyboardInterrupt])
def test_after_an_error_the_old_folder_is_there(folders, monkeypatch, failing, error):
    rename = Path.rename

    def fails(path, target):
        if path.name == failing:
            raise error
        return rename(path, target)

    monkeypatch.setattr(Path, "rename", fails)
    with pytest.raises(error):
        replace_folder(*folders)
    assert contents(folders) == ["old", "new", None]


@pytest.mark.parametrize("interrupted", ["old", "new"])
def test_an_interrupt_between_the_renames_waits_for_both(folders, monkeypatch, interrupted):
    rename = Path.rename

    def interrupts(path, target):
        renamed = rename(path, target)
        if path.name == interrupted:
            os.kill(os.getpid(), signal.SIGINT)
        return renamed

    monkeypatch.setattr(Path, "rename", interrupts)
    with pytest.raises(KeyboardInterrupt):
        replace_folder(*folders)
    assert contents(folders) == ["new", None, "old"]


def test_the_new_files_are_on_disk_before_any_rename(folders, monkeypatch):
    calls = []
    fsync, rename = os.fsync, Path.rename
    monkeypatch.setattr(os, "fsync", lambda file: (calls.append("fsync"), fsync(file)))
    monkeypatch.setattr(Path, "rename", lambda path, to: (calls.append("rename"), rename(path, to))[1])
    replace_folder(*folders)
    assert calls == ["fsync", "rename", "rename"]
