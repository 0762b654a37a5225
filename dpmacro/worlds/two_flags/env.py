"""TwoFlags-v0: reach the blue flag, then the red one, seeing only what the avatar sees.

FourFlags-v0 and SixFlags-v0 are the same room with more flags, to be reached in the order of `scene.FLAGS`.
"""

import math
from collections.abc import Hashable
from itertools import combinations
from typing import Any, ClassVar

import cv2
import gymnasium as gym
import numpy as np
from jaxtyping import UInt8

from dpmacro.worlds.two_flags.options import PIXELS, FourFlagsConfig, SixFlagsConfig, TwoFlagsConfig
from dpmacro.worlds.two_flags.places import clear_ways
from dpmacro.worlds.two_flags.scene import AVATAR_RADIUS, FLAG_RADIUS, FLAGS, SURFACES, Layout, Scene

__all__ = [
    "ACTIONS",
    "FORWARD",
    "FPS",
    "PIXELS",
    "STEP",
    "TURN",
    "TURN_LEFT",
    "TURN_RIGHT",
    "VIEW",
    "WHOLE_TURN",
    "FourFlagsEnv",
    "SixFlagsEnv",
    "TwoFlagsConfig",
    "TwoFlagsEnv",
    "draw_layout",
    "draw_start",
]

FPS = 30
ACTIONS = ("forward", "turn_left", "turn_right")
FORWARD, TURN_LEFT, TURN_RIGHT = range(3)
STEP = 0.03
TURN = math.pi / 300
WHOLE_TURN = 600  # turns
VIEW = (320, 240)
SIDES = (5.0, 20.0)

_GAP = 0.1
# The avatar fits between a flag and anything else, and stands clear of everything where it starts.
_FLAG_TO_WALL = FLAG_RADIUS + 2 * AVATAR_RADIUS + _GAP
_FLAG_TO_FLAG = 2 * FLAG_RADIUS + 2 * AVATAR_RADIUS + _GAP
_START_TO_WALL = AVATAR_RADIUS + _GAP
_START_TO_FLAG = AVATAR_RADIUS + FLAG_RADIUS + _GAP
_TRIES = 1000
_TEXTURES, _START = 1, 2  # what `layout_seed` draws beside the layout


class TwoFlagsEnv(gym.Env[dict[str, np.ndarray], np.int64]):
    """A square room with flags to be reached in order, seen through an avatar's eyes: blue, then red.

    Actions are `ACTIONS`: forward 3 cm, turn left or right by pi/300. The observation is
    {"pixels": uint8 [48, 64, 3]}, RGB. The reward is 1 for reaching the flag whose turn it is, and 0
    otherwise. An episode terminates as a success when the last flag is reached after all others, and as a
    failure when a flag is reached before its turn. A flag that was reached may be touched again. Nothing
    that is seen tells which flags were reached. An episode is truncated after `config.max_steps` steps.

    A flag is reached when Bullet finds the avatar's step to run into the flag's body.

    `info`, for tests and the teacher but no planner, holds `phase` (the number of flags reached, but for
    the last: 0, or 1 once blue was reached), `is_success` (bool), `failure` ("red_first", or as for red for
    the flag that was reached before its turn; else ""), `position` (x, y in metres from the room's centre,
    float64 [2]) and `heading` (radians from the x axis, counter-clockwise, in [-pi, pi)), and
    `state`, hashable: where it is the same at two moments of an episode, the same actions lead to the same
    from there on, until truncation. It holds the forward steps taken (without yaw noise, the position), the
    turns modulo a whole one, and the phase. Turns add up in floating point: after a whole one the heading
    differs by about 1e-13 radians, and `state` ignores that.

    Textures and start that are fixed are drawn by `config.layout_seed`. What the episode would draw is drawn
    all the same: episodes of one seed have the same yaw noise whatever is fixed.

    Attributes: `config`, `scene`, the names of its `flags` in the order of their turns, and the `layout` of
    the current episode.

    Args:
        render_mode: None or "rgb_array".
        options: the fields of `options_type`. Unknown or unfit ones raise ValueError.
    """

    options_type: ClassVar[type[TwoFlagsConfig]] = TwoFlagsConfig
    metadata = {"render_modes": ["rgb_array"], "render_fps": FPS}  # noqa: RUF012  gymnasium's own way

    def __init__(self, render_mode: str | None = None, **options: Any):
        name = self.options_type.world
        if render_mode not in (None, "rgb_array"):
            raise ValueError(f"{name}: render_mode is {render_mode!r}: choose None or 'rgb_array'")
        self.config = self.options_type.of(options)
        self.flags = FLAGS[: self.config.count]
        self.render_mode = render_mode
        self.action_space = gym.spaces.Discrete(len(ACTIONS))
        pixels = gym.spaces.Box(0, 255, (PIXELS[1], PIXELS[0], 3), np.uint8)
        self.observation_space = gym.spaces.Dict({"pixels": pixels})
        self.scene = Scene(self.config.renderer, self.config.count)
        self._running = False

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, UInt8[np.ndarray, "48 64 3"]], dict[str, Any]]:
        """Draw a new episode; return its first observation and info.

        `options` may hold what is otherwise drawn: `layout` (a `Layout`) and `start` (x, y, heading).
        Raises ValueError for any other key, and for a start inside a wall or a flag.
        """
        super().reset(seed=seed)
        given = dict(options or {})
        layout, start = given.pop("layout", None), given.pop("start", None)
        if given:
            raise ValueError(
                f"{self.config.world}: reset has no option {min(given)!r}: choose among layout, start"
            )
        clear = layout is None and self.config.ways == "clear"
        if layout is None:
            fixed = self.config.flags == "fixed"
            rng = np.random.default_rng(self.config.layout_seed) if fixed else self.np_random
            layout = draw_layout(rng, self.config.count, clear)
        self.layout = layout
        self.scene.arrange(layout, self._surfaces())
        x, y, heading = self._start(clear) if start is None else start
        self.scene.put_avatar(np.array([x, y]), heading)
        if not self.scene.free():
            raise ValueError(
                f"{self.config.world}: start {(x, y)} lies in a wall or flag of {layout}: give a free one"
            )
        self._phase, self._failure, self._success = 0, "", False
        self._steps = self._walked = self._turned = 0
        self._running = True
        return self._observation(), self._info()

    def step(
        self, action: int | np.integer
    ) -> tuple[dict[str, UInt8[np.ndarray, "48 64 3"]], float, bool, bool, dict[str, Any]]:
        """Do what `ACTIONS` says; return observation, reward, terminated, truncated and info.

        Raises ValueError for an action that is none, and gymnasium's ResetNeeded outside an episode.
        """
        if not self._running:
            raise gym.error.ResetNeeded(
                f"{self.config.world}: the episode is over or never began: call reset first"
            )
        if not 0 <= action < len(ACTIONS):
            raise ValueError(
                f"{self.config.world}: action is {action}: choose 0 (forward), 1 (left) or 2 (right)"
            )
        reward = 0.0
        if action == FORWARD:
            reward = self._reach(self.scene.forward(STEP))
            self._walked += 1
            self.scene.turn(math.radians(self.np_random.normal(0.0, self.config.yaw_noise)))
        else:
            turn = 1 if action == TURN_LEFT else -1
            self._turned = (self._turned + turn) % WHOLE_TURN
            self.scene.turn(turn * TURN)
        self._steps += 1
        terminated = self._success or bool(self._failure)
        truncated = not terminated and self._steps >= self.config.max_steps
        self._running = not (terminated or truncated)
        return self._observation(), reward, terminated, truncated, self._info()

    def render(self) -> UInt8[np.ndarray, "240 320 3"]:
        """Return the avatar's view for people, RGB."""
        return self.view(*VIEW)

    def view(self, width: int, height: int) -> UInt8[np.ndarray, "height width 3"]:
        """Return the avatar's view at any size, RGB."""
        return self.scene.view(width, height)

    def close(self) -> None:
        """Disconnect from PyBullet."""
        self.scene.close()
        self._running = False

    def _surfaces(self) -> list[int]:
        """The textures of four walls and the ground."""
        drawn = _draw_surfaces(self.np_random, self.scene.texture_count)
        if self.config.textures == "random":
            return drawn
        return _draw_surfaces(self._fixed(_TEXTURES), self.scene.texture_count)

    def _start(self, clear: bool) -> tuple[float, float, float]:
        """Where the avatar starts: x, y (metres) and heading (radians)."""
        drawn = draw_start(self.np_random, self.layout, clear)
        if self.config.start == "random":
            return drawn
        x, y, heading = draw_start(self._fixed(_START), self.layout, clear)
        return x, y, heading + self.config.start_spread * drawn[-1] / math.pi

    def _fixed(self, what: int) -> np.random.Generator:
        """What draws one of the things that stay fixed, each independently of the others."""
        return np.random.default_rng((self.config.layout_seed, what))

    def _reach(self, flag: str) -> float:
        place = self.flags.index(flag) if flag else -1
        if place > self._phase:
            self._failure = f"{flag}_first"
        if place != self._phase:
            return 0.0
        self._success = place == len(self.flags) - 1
        self._phase += not self._success
        return 1.0

    def _observation(self) -> dict[str, UInt8[np.ndarray, "48 64 3"]]:
        pixels = self.view(*self.config.render_size)
        if self.config.render_size != PIXELS:
            pixels = cv2.resize(pixels, PIXELS, interpolation=cv2.INTER_AREA)
        return {"pixels": pixels}

    def _info(self) -> dict[str, Any]:
        return {
            "phase": self._phase,
            "is_success": self._success,
            "failure": self._failure,
            "position": self.scene.position.copy(),
            "heading": self.scene.heading,
            "state": self._state(),
        }

    def _state(self) -> Hashable:
        # Every forward step draws noise, so after one more of them no state is as before. Without noise the
        # position itself tells: a step against a wall changes nothing.
        place = self._walked if self.config.yaw_noise else tuple(self.scene.position.tolist())
        return place, self._turned, self._phase


class FourFlagsEnv(TwoFlagsEnv):
    """The same room with four flags: blue, red, green, yellow."""

    options_type = FourFlagsConfig


class SixFlagsEnv(TwoFlagsEnv):
    """The same room with six flags: blue, red, green, yellow, magenta, cyan."""

    options_type = SixFlagsConfig


def draw_layout(rng: np.random.Generator, count: int = 2, clear: bool = False) -> Layout:
    """Draw a room and `count` flags in it, with room for the avatar on every side of each.

    The smallest rooms have no room for six flags: where `_TRIES` draws of all flags fail, another room is
    drawn. With `clear`, rooms are drawn until one is found with a start as `draw_start` wants it then.
    """
    while True:
        side = rng.uniform(*SIDES)
        reach = side / 2 - _FLAG_TO_WALL
        for _ in range(_TRIES):
            flags = rng.uniform(-reach, reach, (count, 2)).tolist()
            if all(math.dist(*pair) >= _FLAG_TO_FLAG for pair in combinations(flags, 2)):
                blue, red, *others = ((x, y) for x, y in flags)
                layout = Layout(side, blue, red, tuple(others))
                if not clear or _is_clear(layout, draw_start(rng, layout)):
                    return layout
                break


def draw_start(rng: np.random.Generator, layout: Layout, clear: bool = False) -> tuple[float, float, float]:
    """Draw x, y (metres) and heading (radians) of an avatar that touches nothing in `layout`.

    With `clear`, straight walks lead from there to every flag in turn (`places.clear_ways`). `layout` has to
    have such a start.
    """
    reach = layout.side / 2 - _START_TO_WALL
    while True:
        x, y = rng.uniform(-reach, reach, 2).tolist()
        if min(math.dist((x, y), flag) for flag in layout.flags) >= _START_TO_FLAG:
            start = x, y, rng.uniform(-math.pi, math.pi)
            if not clear or _is_clear(layout, start):
                return start


def _is_clear(layout: Layout, start: tuple[float, float, float]) -> bool:
    return clear_ways(complex(*start[:2]), [complex(*flag) for flag in layout.flags])


def _draw_surfaces(rng: np.random.Generator, textures: int) -> list[int]:
    return rng.choice(textures, SURFACES, replace=False).tolist()
