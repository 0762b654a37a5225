"""Meshes face where they should and carry usable texture coordinates."""

import numpy as np
import pytest

from dpmacro.worlds.two_flags.meshes import circle, ground, post, wall

NODES = np.linspace(-3.0, 3.0, 4)


def read(obj):
    """Vertices, normals, texture coordinates and faces of an OBJ text."""
    table = {"v": [], "vn": [], "vt": [], "f": []}
    for line in obj.splitlines():
        kind, *numbers = line.split()
        table[kind].append([float(number.split("/")[0]) for number in numbers])
    return [np.array(rows) for rows in table.values()]


@pytest.mark.parametrize(
    "obj, area",
    [
        (ground(NODES, 1.5), 36.0),
        (wall(NODES, 2.0, 1.5), 12.0),
        (post(circle(0.5, 100), 2.0), 2 * np.pi),
    ],
)
def test_triangles_cover_the_surface_and_wind_round_its_normal(obj, area):
    vertices, normals, uvs, faces = read(obj)
    a, b, c = (vertices[faces[:, i].astype(int) - 1] for i in range(3))
    cross = np.cross(b - a, c - a)
    assert np.linalg.norm(cross, axis=1).sum() / 2 == pytest.approx(area, rel=1e-3)
    assert ((cross * normals[faces[:, 0].astype(int) - 1]).sum(axis=1) > 0).all()
    assert uvs.min() == 0.0


@pytest.mark.parametrize("obj", [ground(NODES, 1.5), wall(NODES, 2.0, 1.5)])
def test_a_texture_covers_its_metres(obj):
    vertices, _, uvs, _ = read(obj)
    assert np.ptp(uvs[:, 0]) == pytest.approx(np.ptp(vertices[:, 0]) / 1.5)
    assert np.ptp(uvs[:, 1]) == pytest.approx(np.ptp(vertices[:, 1:]) / 1.5)
