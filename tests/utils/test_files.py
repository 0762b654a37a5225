import errno
from pathlib import Path

import pytest
import torch
from safetensors import SafetensorError
from safetensors.torch import save_file

from dpmacro.utils.files import replacing, telling_what_is_safe
from tests.helpers.limited import limited


def test_a_file_appears_whole_(tmp_path):
    path = tmp_path / "new" / "folder" / "file.json"
    with replacing(path) as temporary:
        temporary.write_text("whole")
        assert temporary.parent == path.parent and temporary.suffix == ".json" and not path.exists()
    assert path.read_text() == "whole"
    assert list(path.parent.iterdir()) == [path]


def test_a_failure_leaves_the_old_file_and_no_other(tmp_path):
    path = tmp_path / "file.json"
    path.write_text("old")
    with pytest.raises(RuntimeError), replacing(path) as temporary:
        temporary.write_text("half")
        raise RuntimeError
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def full(path):
    """A writer for whom the disk is full."""
    path.write_text("half")
    raise OSError(errno.ENOSPC, "No space left on device")


def small(path):
    """A real file that may not grow beyond 4 kB."""
    save_file({"numbers": torch.zeros(10_000)}, path)


def test_a_full_disk_names_the_file(tmp_path):
    with pytest.raises(OSError) as caught, replacing(tmp_path / "file.json") as temporary:
        full(temporary)
    assert (caught.value.errno, caught.value.filename) == (errno.ENOSPC, str(tmp_path / "file.json"))
    assert not list(tmp_path.iterdir())


def test_safetensors_names_it_likewise(tmp_path):
    path = tmp_path / "model.safetensors"
    with limited(4096), pytest.raises(OSError) as caught, replacing(path) as temporary:
        small(temporary)
    assert (caught.value.errno, caught.value.filename) == (errno.EFBIG, str(path))
    assert not list(tmp_path.iterdir())


def test_an_error_of_another_file_stays(tmp_path):
    with pytest.raises(FileNotFoundError, match="other") as caught, replacing(tmp_path / "file.json"):
        (tmp_path / "other").read_text()
    assert caught.value.filename == str(tmp_path / "other")


@pytest.mark.parametrize("name", ["a.json", None])
def test_what_is_safe_is_said_with_the_file(name):
    told = rf"^{name or 'run'}: cannot be written \(No space left on device\); all is lost; free some space"
    with pytest.raises(OSError, match=told), telling_what_is_safe(Path("run"), lambda: "all is lost"):
        raise OSError(errno.ENOSPC, "No space left on device", name)
    with pytest.raises(PermissionError), telling_what_is_safe(Path("run"), lambda: "all is lost"):
        raise PermissionError(errno.EACCES, "Permission denied", name)


def test_a_library_that_keeps_the_number_in_its_message_is_understood():
    with (
        pytest.raises(OSError, match=r"^run: cannot be written \(No space left"),
        telling_what_is_safe(Path("run"), lambda: "nothing"),
    ):
        raise SafetensorError("Error while serializing: I/O error: No space left on device (os error 28)")
