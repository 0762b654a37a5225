"""Meshes in Wavefront's OBJ format for what the avatar sees; upright surfaces stand on z = 0."""

import math

import numpy as np
from jaxtyping import Float

Points = Float[np.ndarray, "points 2"]


def ground(nodes: Float[np.ndarray, " nodes"], texture: float) -> str:
    """Return a square that faces up, cut at `nodes` in x and y; a texture covers `texture` metres."""
    corners = [(x, y, 0.0) for y in nodes for x in nodes]
    return _grid(corners, [(0.0, 0.0, 1.0)] * len(corners), len(nodes), texture)


def wall(nodes: Float[np.ndarray, " nodes"], height: float, texture: float) -> str:
    """Return a wall along the x axis that faces +y, cut at `nodes`."""
    # From the last node to the first: the side from which a triangle winds clockwise is not drawn.
    corners = [(x, 0.0, z) for z in (0.0, height) for x in nodes[::-1]]
    return _grid(corners, [(0.0, 1.0, 0.0)] * len(corners), len(nodes), texture)


def post(points: Points, height: float) -> str:
    """Return the side of a round post round the origin through `points`, counter-clockwise; no cap."""
    ring = np.concatenate([points, points[:1]])
    corners = [(x, y, z) for z in (0.0, height) for x, y in ring]
    normals = [(x / math.hypot(x, y), y / math.hypot(x, y), 0.0) for x, y, _ in corners]
    return _grid(corners, normals, len(ring), 1.0)


def circle(radius: float, count: int) -> Points:
    """Return `count` points on a circle round the origin, counter-clockwise."""
    angles = 2 * math.pi * np.arange(count) / count
    return radius * np.stack([np.cos(angles), np.sin(angles)], axis=1)


def _grid(
    corners: list[tuple[float, float, float]],
    normals: list[tuple[float, float, float]],
    columns: int,
    texture: float,
) -> str:
    """Return the mesh of `corners`, rows of `columns`, seen counter-clockwise from its front."""
    low = np.min(corners, axis=0)
    lines = [f"v {x} {y} {z}" for x, y, z in corners]
    lines += [f"vn {x} {y} {z}" for x, y, z in normals]
    for corner in corners:
        # TinyRenderer repeats a texture along positive coordinates only.
        along_x, along_y, along_z = (np.array(corner) - low) / texture
        lines.append(f"vt {along_x} {along_y + along_z}")
    for first in range(1, len(corners) - columns + 1):
        if first % columns:
            last = first + columns
            for triangle in ((first, first + 1, last), (last, first + 1, last + 1)):
                lines.append("f " + " ".join(f"{i}/{i}/{i}" for i in triangle))
    return "\n".join(lines) + "\n"
