"""PyBullet without its greeting, and what it takes only from files: textures, meshes, its EGL plugin."""

import importlib.util
import os
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import UInt8

from dpmacro.utils.temporary import temporary_folder


@contextmanager
def _silent_stderr() -> Iterator[None]:
    sys.stderr.flush()
    saved = os.dup(2)
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 2)
    try:
        yield
    finally:
        os.dup2(saved, 2)
        os.close(saved)
        os.close(nowhere)


# Importing it writes its build time to standard error from C, where scripts promise one line at most.
with _silent_stderr():
    import pybullet

__all__ = ["load_egl", "load_mesh", "load_textures", "pybullet"]


@contextmanager
def _folder() -> Iterator[Path]:
    """A temporary folder; ValueError, one line, where its files cannot be written."""
    try:
        with temporary_folder() as folder:
            yield folder
    except OSError as error:
        place = tempfile.tempdir or "the folder for temporary files"
        raise ValueError(
            f"PyBullet takes textures and meshes from files, and none can be written in {place} "
            f"({error.strerror or error}): free some space there, or give another folder by TMPDIR=<folder>"
        ) from error


def load_textures(pictures: list[UInt8[np.ndarray, "size size 3"]], client: int) -> list[int]:
    """Load RGB pictures into `client` and return their texture ids; no file is left behind.

    Raises ValueError where there is no room for temporary files.
    """
    with _folder() as folder:
        loaded = []
        for number, picture in enumerate(pictures):
            # PyBullet remembers a texture by its path, so every one needs its own.
            path = folder / f"{number}.png"
            path.write_bytes(cv2.imencode(".png", picture[..., ::-1])[1].tobytes())
            loaded.append(pybullet.loadTexture(str(path), physicsClientId=client))
    return loaded


def load_mesh(obj: str, colour: tuple[float, ...], client: int) -> int:
    """Load a mesh in Wavefront's OBJ format, RGBA `colour`, into `client`; return its visual shape id.

    PyBullet also takes vertices from memory, but its EGL plugin does not draw those. Raises ValueError where
    there is no room for temporary files.
    """
    with _folder() as folder:
        path = folder / "mesh.obj"
        path.write_text(obj)
        return pybullet.createVisualShape(
            pybullet.GEOM_MESH, fileName=str(path), rgbaColor=colour, physicsClientId=client
        )


def load_egl(client: int) -> None:
    """Make `client` render by EGL. Raises ValueError if PyBullet came without the plugin or refuses it."""
    plugin = importlib.util.find_spec("eglRenderer")
    path = plugin.origin if plugin else None
    if path is None or pybullet.loadPlugin(path, "_eglRendererPlugin", physicsClientId=client) < 0:
        raise ValueError("renderer is 'egl', which PyBullet cannot load here: choose 'tiny'")
