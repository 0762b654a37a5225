"""TwoFlags-v0: reach the blue flag, then the red one, seeing only what the avatar sees."""

import math
from collections.abc import Hashable, Mapping
from dataclasses import asdict, dataclass
from typing import Any

import cv2
import gymnasium as gym
import numpy as np
from jaxtyping import UInt8

from dpmacro.worlds.two_flags.scene import AVATAR_RADIUS, FLAG_RADIUS, SURFACES, Layout, Scene

FPS = 30
ACTIONS = ("forward", "turn_left", "turn_right")
FORWARD, TURN_LEFT, TURN_RIGHT = range(3)
STEP = 0.03
TURN = math.pi / 300
WHOLE_TURN = 600  # turns
PIXELS = (64, 48)
VIEW = (320, 240)
WIDEST = 4096  # of what is rendered, 48 MiB with all that belongs to it
SIDES = (5.0, 20.0)

_GAP = 0.1
# The avatar fits between a flag and anything else, and stands clear of everything where it starts.
_FLAG_TO_WALL = FLAG_RADIUS + 2 * AVATAR_RADIUS + _GAP
_FLAG_TO_FLAG = 2 * FLAG_RADIUS + 2 * AVATAR_RADIUS + _GAP
_START_TO_WALL = AVATAR_RADIUS + _GAP
_START_TO_FLAG = AVATAR_RADIUS + FLAG_RADIUS + _GAP


@dataclass(frozen=True)
class TwoFlagsConfig:
    """Options of `TwoFlagsEnv`; a value out of range raises ValueError."""

    flags: str = "random"
    """Whether every episode draws its room and flags ("random") or all share one layout ("fixed")."""
    layout_seed: int = 0
    """Seed of the one layout that flags="fixed" keeps; the episode's seed does not change it."""
    yaw_noise: float = 0.5
    """Standard deviation, in degrees, of the random turn after every forward step."""
    render_size: tuple[int, int] = (128, 96)
    """Width and height, in pixels, of the picture that is area-downscaled to the 64x48 observation."""
    max_steps: int = 3000
    """Steps after which an episode is truncated."""
    renderer: str = "tiny"
    """PyBullet's software renderer ("tiny") or its EGL plugin ("egl"), which needs a graphics driver."""

    def __post_init__(self) -> None:
        width, height = self.render_size if len(self.render_size) == 2 else (0, 0)
        for ok, name, remedy in (
            (self.flags in ("random", "fixed"), "flags", "choose 'random' or 'fixed'"),
            (self.layout_seed >= 0, "layout_seed", "give a seed of 0 or more"),
            (0 <= self.yaw_noise < math.inf, "yaw_noise", "give degrees, 0 or more and finite"),
            (
                PIXELS[0] <= width <= WIDEST and width * PIXELS[1] == height * PIXELS[0],
                "render_size",
                f"give a width and height in the ratio 4:3, from (64, 48) to ({WIDEST}, {WIDEST * 3 // 4})",
            ),
            (self.max_steps >= 1, "max_steps", "give 1 or more"),
            (self.renderer in ("tiny", "egl"), "renderer", "choose 'tiny' or 'egl'"),
        ):
            if not ok:
                raise ValueError(f"TwoFlags: {name} is {getattr(self, name)!r}: {remedy}")


def complete_options(options: Mapping[str, Any]) -> dict[str, Any]:
    """All options of the world, those not given as they are by default.

    Lists stand for tuples, as in a JSON file. Raises ValueError for one that is unknown or unfit.
    """
    unknown = sorted(set(options) - set(_DEFAULTS))
    if unknown:
        raise ValueError(f"TwoFlags has no option {unknown[0]!r}: choose among {', '.join(_DEFAULTS)}")
    given: dict[str, Any] = {
        name: tuple(value) if isinstance(value, list) else value for name, value in options.items()
    }
    for name, value in given.items():
        default = _DEFAULTS[name]
        alike = isinstance(value, tuple) == isinstance(default, tuple)
        kind = {tuple: int, float: int | float}.get(type(default), type(default))
        parts = value if isinstance(value, tuple) else (value,)
        if not alike or not all(isinstance(part, kind) and not isinstance(part, bool) for part in parts):
            raise ValueError(f"TwoFlags: {name} is {value!r}: give a value like {default!r}")
        if isinstance(default, float):
            given[name] = float(value)
    return asdict(TwoFlagsConfig(**given))


_DEFAULTS = asdict(TwoFlagsConfig())


class TwoFlagsEnv(gym.Env[dict[str, np.ndarray], np.int64]):
    """A square room with a blue and a red flag, seen through an avatar's eyes.

    Actions are `ACTIONS`: forward 3 cm, turn left or right by pi/300. The observation is
    {"pixels": uint8 [48, 64, 3]}, RGB. The reward is 1 for reaching the blue flag, 1 for reaching the
    red one after it, and 0 otherwise. An episode terminates when red is reached: as a success after
    blue, as a failure before. It is truncated after `config.max_steps` steps.

    A flag is reached when Bullet finds the avatar's step to run into the flag's body.

    `info`, for tests and the teacher but no planner, holds `phase` (0, or 1 once blue was reached),
    `is_success` (bool), `failure` ("red_first" or ""), `position` (x, y in metres from the room's
    centre, float64 [2]) and `heading` (radians from the x axis, counter-clockwise, in [-pi, pi)), and
    `state`, hashable: where it is the same at two moments of an episode, the same actions lead to the same
    from there on, until truncation. It holds the forward steps taken (without yaw noise, the position), the
    turns modulo a whole one, and the phase. Turns add up in floating point: after a whole one the heading
    differs by about 1e-13 radians, and `state` ignores that.

    Attributes: `config`, `scene`, and the `layout` of the current episode.

    Args:
        render_mode: None or "rgb_array".
        options: the fields of `TwoFlagsConfig`. Unknown or unfit ones raise ValueError.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": FPS}  # noqa: RUF012  gymnasium's own way

    def __init__(self, render_mode: str | None = None, **options: Any):
        if render_mode not in (None, "rgb_array"):
            raise ValueError(f"TwoFlags: render_mode is {render_mode!r}: choose None or 'rgb_array'")
        self.config = TwoFlagsConfig(**complete_options(options))
        self.render_mode = render_mode
        self.action_space = gym.spaces.Discrete(len(ACTIONS))
        pixels = gym.spaces.Box(0, 255, (PIXELS[1], PIXELS[0], 3), np.uint8)
        self.observation_space = gym.spaces.Dict({"pixels": pixels})
        self.scene = Scene(self.config.renderer)
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
            raise ValueError(f"TwoFlags: reset has no option {min(given)!r}: choose among layout, start")
        if layout is None and self.config.flags == "random":
            layout = draw_layout(self.np_random)
        elif layout is None:
            layout = draw_layout(np.random.default_rng(self.config.layout_seed))
        surfaces = self.np_random.choice(self.scene.texture_count, SURFACES, replace=False)
        self.layout = layout
        self.scene.arrange(layout, surfaces.tolist())
        x, y, heading = draw_start(self.np_random, layout) if start is None else start
        self.scene.put_avatar(np.array([x, y]), heading)
        if not self.scene.free():
            raise ValueError(f"TwoFlags: start {(x, y)} lies in a wall or flag of {layout}: give a free one")
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
            raise gym.error.ResetNeeded("TwoFlags: the episode is over or never began: call reset first")
        if not 0 <= action < len(ACTIONS):
            raise ValueError(f"TwoFlags: action is {action}: choose 0 (forward), 1 (left) or 2 (right)")
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

    def _reach(self, flag: str) -> float:
        if flag == "blue" and self._phase == 0:
            self._phase = 1
            return 1.0
        if flag == "red":
            self._success = self._phase == 1
            self._failure = "" if self._success else "red_first"
            return float(self._success)
        return 0.0

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


def draw_layout(rng: np.random.Generator) -> Layout:
    """Draw a room and two flags in it, with room for the avatar on every side of both."""
    side = rng.uniform(*SIDES)
    reach = side / 2 - _FLAG_TO_WALL
    while True:
        blue, red = rng.uniform(-reach, reach, (2, 2))
        if math.dist(blue, red) >= _FLAG_TO_FLAG:
            return Layout(side, (float(blue[0]), float(blue[1])), (float(red[0]), float(red[1])))


def draw_start(rng: np.random.Generator, layout: Layout) -> tuple[float, float, float]:
    """Draw x, y (metres) and heading (radians) of an avatar that touches nothing in `layout`."""
    reach = layout.side / 2 - _START_TO_WALL
    while True:
        x, y = rng.uniform(-reach, reach, 2).tolist()
        if min(math.dist((x, y), layout.blue), math.dist((x, y), layout.red)) >= _START_TO_FLAG:
            return x, y, rng.uniform(-math.pi, math.pi)
