"""The room, its flags and the avatar in PyBullet: collision, motion, visibility and pictures."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from dpmacro.worlds.two_flags.bullet import load_egl, load_mesh, load_textures, pybullet
from dpmacro.worlds.two_flags.meshes import circle, ground, post, wall
from dpmacro.worlds.two_flags.textures import textures

FLAG_RADIUS = 0.3
FLAG_HEIGHT = 1.8
AVATAR_RADIUS = 0.4
FIELD_OF_VIEW = math.radians(60)
EYE_HEIGHT = 1.0
WALL_HEIGHT = 3.0
SURFACES = 5

# Walls and ground are cut once for the largest room and only moved: what sticks out of a smaller room
# hides behind the neighbouring walls, and a texture has the same size in metres in every room.
_LARGEST_SIDE = 20.0
_NODES = np.linspace(-_LARGEST_SIDE / 2 - 1, _LARGEST_SIDE / 2 + 1, 7)
_WALL_THICKNESS = 0.5
_TEXTURE_METRES = 3.0
_COLOURS = {
    "blue": (0.05, 0.15, 1.0, 1.0),
    "red": (1.0, 0.08, 0.08, 1.0),
    "green": (0.05, 0.8, 0.1, 1.0),
    "yellow": (1.0, 0.85, 0.05, 1.0),
    "magenta": (1.0, 0.05, 0.9, 1.0),
    "cyan": (0.05, 0.9, 0.95, 1.0),
}
_HUES = (2 / 3, 0.0, 1 / 3, 1 / 6, 5 / 6, 1 / 2)
FLAGS = tuple(_COLOURS)
"""Names of the flags in the order of their turns."""
_ROUND = circle(FLAG_RADIUS, 24)
_NEAR, _FAR = 0.05, 40.0
_CLEARANCE = 1e-4
# Bullet puts bodies without mass, walls and flags, into group 2; rays must pass through the avatar.
_OBSTACLES, _AVATAR = 2, 64


@dataclass(frozen=True)
class Layout:
    """What stays the same in every episode of a fixed world; the room's centre is the origin.

    Raises ValueError for a room larger than 20 m.
    """

    side: float
    """Inner side of the square room, metres."""
    blue: tuple[float, float]
    """Centre of the blue flag, metres."""
    red: tuple[float, float]
    """Centre of the red flag, metres."""
    others: tuple[tuple[float, float], ...] = ()
    """Centres of further flags in the order of `FLAGS`, metres."""

    @property
    def flags(self) -> tuple[tuple[float, float], ...]:
        """Centres of all flags in the order of `FLAGS`, metres."""
        return self.blue, self.red, *self.others

    def __post_init__(self) -> None:
        if not 0 < self.side <= _LARGEST_SIDE:
            raise ValueError(f"layout: side is {self.side}: give up to {_LARGEST_SIDE:.0f} m")


class Scene:
    """One PyBullet client with four walls, a ground, the first `count` of `FLAGS` and an avatar.

    Headings are radians, counter-clockwise from the x axis, in [-pi, pi). Raises ValueError if
    `renderer` is "egl" and PyBullet's EGL plugin cannot be loaded.
    """

    def __init__(self, renderer: str = "tiny", count: int = 2):
        self._client = pybullet.connect(pybullet.DIRECT)
        self._renderer = pybullet.ER_TINY_RENDERER
        if renderer == "egl":
            self._use_egl()
        self._textures = load_textures(textures(_HUES[:count]), self._client)
        self.texture_count = len(self._textures)
        # Bodies are drawn in the order of their making, and a hidden pixel costs less than one drawn over.
        self._flags = {name: self._flag(_COLOURS[name]) for name in FLAGS[:count]}
        box = self._collision(
            pybullet.GEOM_BOX,
            halfExtents=(_NODES[-1], _WALL_THICKNESS / 2, WALL_HEIGHT / 2),
            collisionFramePosition=(0, -_WALL_THICKNESS / 2, WALL_HEIGHT / 2),
        )
        self._walls = [
            self._body(box, self._mesh(wall(_NODES, WALL_HEIGHT, _TEXTURE_METRES))) for _ in range(4)
        ]
        self._ground = self._body(visual=self._mesh(ground(_NODES, _TEXTURE_METRES)))
        self._avatar = self._body(
            collision=self._collision(
                pybullet.GEOM_CAPSULE, radius=AVATAR_RADIUS, height=2 * (1 - AVATAR_RADIUS)
            )
        )
        pybullet.setCollisionFilterGroupMask(
            self._avatar, -1, _AVATAR, _OBSTACLES, physicsClientId=self._client
        )
        self.position = np.array([0.0, 0.0])
        self.heading = 0.0

    def arrange(self, layout: Layout, surfaces: Sequence[int]) -> None:
        """Move walls and flags to `layout`; `surfaces` are textures of four walls and the ground.

        Raises ValueError for a layout of another number of flags.
        """
        if len(layout.flags) != len(self._flags):
            raise ValueError(f"layout: it has {len(layout.flags)} flags: give one of {len(self._flags)}")
        corners: list[np.ndarray] = [np.stack(np.meshgrid(_NODES, _NODES), axis=-1).reshape(-1, 2)]
        for number, body in enumerate(self._walls):
            angle = number * math.pi / 2
            along = np.array([math.cos(angle), math.sin(angle)])
            middle = np.array([along[1], -along[0]]) * layout.side / 2
            self._move(body, (*middle, 0.0), angle)
            corners.append(middle + np.outer(_NODES, along))
        self._side = layout.side
        self._positions = {name: np.array(at) for name, at in zip(self._flags, layout.flags, strict=True)}
        for name, at in self._positions.items():
            self._move(self._flags[name], (*at, 0.0))
        self._corners = np.concatenate([*corners, *(_ROUND + at for at in self._positions.values())])
        for body, texture in zip([*self._walls, self._ground], surfaces, strict=True):
            pybullet.changeVisualShape(
                body, -1, textureUniqueId=self._textures[texture], physicsClientId=self._client
            )
        # Ray tests read the broad phase, which moving bodies by hand leaves stale.
        pybullet.performCollisionDetection(physicsClientId=self._client)

    def put_avatar(self, position: np.ndarray, heading: float) -> None:
        """Put the avatar at `position` (x, y in metres), looking along `heading`."""
        self.position = np.array(position, dtype=np.float64)
        self.heading = _wrapped(heading)
        self._move(self._avatar, (*self.position, 1.0))

    def turn(self, angle: float) -> None:
        """Turn the avatar on the spot; positive is left."""
        self.heading = _wrapped(self.heading + angle)

    def forward(self, distance: float) -> str:
        """Walk `distance` metres ahead as far as bodies allow; return the flag touched, or "".

        Bullet tests the new place for penetration, and the avatar never ends up in one. A wall stops
        it dead. A flag is a smooth round post: only the part of the step that points into it is lost,
        otherwise no place behind the flag just reached could be walked to in a straight line.
        """
        start, step = self.position, distance * np.array([math.cos(self.heading), math.sin(self.heading)])
        self.put_avatar(start + step, self.heading)
        touched = next((name for name in self._flags if self._contact(self._flags[name])), "")
        if touched:
            self.put_avatar(start, self.heading)
            normal = np.array(self._contact(self._flags[touched], within=2 * distance)[0][7][:2])
            normal /= np.linalg.norm(normal)
            self.put_avatar(start + step - (step @ normal) * normal, self.heading)
        if not self.free():
            self.put_avatar(start, self.heading)
        return touched

    def free(self) -> bool:
        """Return whether the avatar stands clear of all walls and flags."""
        return not any(self._contact(body) for body in [*self._walls, *self._flags.values()])

    def bearing(self, flag: str) -> float:
        """Return the angle from the heading to the flag's centre, radians in [-pi, pi), left positive."""
        dx, dy = self._positions[flag] - self.position
        return _wrapped(math.atan2(dy, dx) - self.heading)

    def distance(self, flag: str) -> float:
        """Return the metres from the avatar's middle to the flag's."""
        return math.dist(self.position, self._positions[flag])

    def to_wall(self, angle: float) -> float:
        """Return the metres that the avatar can walk after a turn by `angle` before it touches a wall."""
        ways = (math.cos(self.heading + angle), math.sin(self.heading + angle))
        reach = self._side / 2 - AVATAR_RADIUS
        return min(
            (reach - math.copysign(1.0, way) * at) / abs(way) if way else math.inf
            for way, at in zip(ways, self.position.tolist(), strict=True)
        )

    def visible(self, flag: str) -> bool:
        """Return whether the flag's centre is in the field of view and not all of it behind others.

        Five rays go from the eye across the flag's width; the flag is seen if one hits it first.
        """
        if abs(self.bearing(flag)) > FIELD_OF_VIEW / 2:
            return False
        towards = self._positions[flag] - self.position
        across = np.array([-towards[1], towards[0]]) / np.linalg.norm(towards)
        offsets = np.linspace(-0.9, 0.9, 5) * FLAG_RADIUS
        ends = [(*(self._positions[flag] + offset * across), EYE_HEIGHT) for offset in offsets]
        eyes = [(*self.position, EYE_HEIGHT)] * len(ends)
        hits = pybullet.rayTestBatch(eyes, ends, collisionFilterMask=_OBSTACLES, physicsClientId=self._client)
        return any(hit[0] == self._flags[flag] for hit in hits)

    def view(self, width: int, height: int) -> UInt8[np.ndarray, "height width 3"]:
        """Return what the avatar sees, RGB; the field of view of 60 degrees is the horizontal one."""
        dx, dy = math.cos(self.heading), math.sin(self.heading)
        x, y = self._eye(np.array([dx, dy])).tolist()
        vertical = 2 * math.atan(math.tan(FIELD_OF_VIEW / 2) * height / width)
        image = pybullet.getCameraImage(
            width,
            height,
            viewMatrix=pybullet.computeViewMatrix(
                (x, y, EYE_HEIGHT), (x + dx, y + dy, EYE_HEIGHT), (0, 0, 1)
            ),
            projectionMatrix=pybullet.computeProjectionMatrixFOV(
                math.degrees(vertical), width / height, _NEAR, _FAR
            ),
            lightDirection=(2.0, 3.0, 6.0),
            lightColor=(1, 1, 1),
            lightAmbientCoeff=0.65,
            lightDiffuseCoeff=0.35,
            lightSpecularCoeff=0.0,
            shadow=0,
            renderer=self._renderer,
            flags=pybullet.ER_NO_SEGMENTATION_MASK,
            physicsClientId=self._client,
        )[2]
        # Where PyBullet was built without NumPy, the image is a tuple of numbers.
        return cv2.cvtColor(np.asarray(image, np.uint8).reshape(height, width, 4), cv2.COLOR_RGBA2RGB)

    def close(self) -> None:
        """Disconnect from PyBullet; calling it twice does no harm."""
        if self._client >= 0:
            pybullet.disconnect(physicsClientId=self._client)
            self._client = -1

    def _eye(self, ahead: Float[np.ndarray, "2"]) -> Float[np.ndarray, "2"]:
        """Return the avatar's position, moved back by 0.3 mm until no mesh corner is exactly beside it.

        TinyRenderer divides by a corner's distance to the plane through the eye. Rounding makes distances of
        zero common, and there it draws black holes or loops over 2^31 columns for minutes.
        """
        eye = self.position
        while np.abs((self._corners - eye) @ ahead).min() < _CLEARANCE:
            eye = eye - 3 * _CLEARANCE * ahead
        return eye

    def _use_egl(self) -> None:
        try:
            load_egl(self._client)
        except ValueError:
            self.close()
            raise
        self._renderer = pybullet.ER_BULLET_HARDWARE_OPENGL

    def _contact(self, body: int, within: float = 0.0) -> tuple:
        return pybullet.getClosestPoints(self._avatar, body, within, physicsClientId=self._client)

    def _move(self, body: int, position: tuple[float, ...], angle: float = 0.0) -> None:
        turned = (0.0, 0.0, math.sin(angle / 2), math.cos(angle / 2))
        pybullet.resetBasePositionAndOrientation(body, position, turned, physicsClientId=self._client)

    def _collision(self, kind: int, **shape: object) -> int:
        return pybullet.createCollisionShape(kind, **shape, physicsClientId=self._client)

    def _body(self, collision: int = -1, visual: int = -1) -> int:
        return pybullet.createMultiBody(
            baseMass=0,
            baseCollisionShapeIndex=collision,
            baseVisualShapeIndex=visual,
            physicsClientId=self._client,
        )

    def _mesh(self, obj: str, colour: tuple[float, ...] = (1.0, 1.0, 1.0, 1.0)) -> int:
        return load_mesh(obj, colour, self._client)

    def _flag(self, colour: tuple[float, ...]) -> int:
        collision = self._collision(
            pybullet.GEOM_CYLINDER,
            radius=FLAG_RADIUS,
            height=FLAG_HEIGHT,
            collisionFramePosition=(0, 0, FLAG_HEIGHT / 2),
        )
        return self._body(collision, self._mesh(post(_ROUND, FLAG_HEIGHT), colour))


def _wrapped(angle: float) -> float:
    return (angle + math.pi) % (2 * math.pi) - math.pi
