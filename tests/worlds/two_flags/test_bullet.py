"""PyBullet as the worlds need it: quiet, with numpy, leaving nothing behind."""

import importlib.util
import subprocess
import sys
import tempfile

import numpy as np
import pytest

from dpmacro.worlds.two_flags.bullet import load_egl, load_mesh, load_textures, pybullet
from tests.helpers.limited import limited

TRIANGLE = "v 0 0 0\nv 1 0 0\nv 0 1 0\nvn 0 0 1\nf 1//1 2//1 3//1\n"


@pytest.fixture()
def client():
    client = pybullet.connect(pybullet.DIRECT)
    yield client
    pybullet.disconnect(physicsClientId=client)


def test_it_was_built_with_numpy():
    assert pybullet.isNumpyEnabled() == 1, "build it with numpy installed and --no-build-isolation"


def test_importing_it_writes_nothing():
    run = subprocess.run(
        [sys.executable, "-c", "import dpmacro.worlds.two_flags.bullet"],
        capture_output=True,
        text=True,
        check=True,
    )
    assert (run.stdout, run.stderr) == ("", "")


def test_loading_leaves_no_file_behind(client, tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    pictures = [np.full((8, 8, 3), shade, np.uint8) for shade in (50, 100, 150)]
    assert len(set(load_textures(pictures, client))) == 3
    assert load_mesh(TRIANGLE, (1.0, 1.0, 1.0, 1.0), client) >= 0
    assert list(tmp_path.iterdir()) == []


def test_a_missing_egl_plugin_is_reported(client, monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(ValueError, match=r"renderer is 'egl'.*choose 'tiny'"):
        load_egl(client)


def test_no_room_for_temporary_files_is_one_line(client, tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    told = rf"none can be written in {tmp_path} \(File too large\): free some space there, or .*TMPDIR"
    with limited(16):
        with pytest.raises(ValueError, match=told):
            load_textures([np.zeros((8, 8, 3), np.uint8)], client)
        with pytest.raises(ValueError, match=told):
            load_mesh(TRIANGLE, (1.0, 1.0, 1.0, 1.0), client)
    assert list(tmp_path.iterdir()) == []


def test_no_place_for_temporary_files_is_one_line(client, monkeypatch):
    def nowhere(*given, **options):
        raise FileNotFoundError(2, "No usable temporary directory found in ['/a']")

    monkeypatch.setattr(tempfile, "tempdir", None)
    monkeypatch.setattr(tempfile, "_get_default_tempdir", nowhere)
    with pytest.raises(ValueError, match=r"\(No usable temporary directory found.*\): free some space"):
        load_textures([np.zeros((8, 8, 3), np.uint8)], client)
