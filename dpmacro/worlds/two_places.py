"""Two places to visit in order by a hand that moves in three directions: what is next cannot be seen.

In TwoButtons-v0 a blue and a red button stand on a table, and blue has to be pressed before red. In
TwoGoals-v0 two points in the air have to be touched in that order. Both places are in view from the start,
and whoever takes the red one first has failed. What is observed does not tell whether blue was visited, so
that no policy without memory can do both.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import cv2
import gymnasium as gym
import numpy as np
from jaxtyping import Float, Float32, UInt8

from dpmacro.worlds.base import SUCCESS, Episode, GenericDiagnosis, Recording

__all__ = ["ACTIONS", "STAGES", "STATE", "Expert", "TwoPlaces", "TwoPlacesDiagnosis", "recording"]

STATE = "observation.state"
DIMENSIONS = (*(f"{thing}_{axis}" for thing in ("hand", "blue", "red") for axis in "xyz"), "contact")
ACTIONS = ("x", "y", "z")
STAGES = ("reach_blue", "press_blue", "reach_red", "press_red")
OUTCOMES = (SUCCESS, "red_first", "blue_never_reached", "red_never_reached")
FPS = 30
MAX_STEPS = 300
STEP = 0.01  # metres that the hand moves in a step at action 1
LOW, HIGH = np.array([-0.3, -0.3, 0.0]), np.array([0.3, 0.3, 0.3])  # where the hand can be, metres
TOP = 0.04  # height of a button, metres
NEAR = 0.03  # a place is visited within this distance, a button at or below its top
APART = 0.15  # the places from one another at least, and from where the hand starts
CLEAR = 0.1  # between the red place and the straight way to the blue one
ABOVE = 0.12  # height that the expert crosses the table at
SLOWS = 0.04  # the expert slows down within this distance of where it goes
SIZE = 480  # height and width of the picture, pixels


class TwoPlaces(gym.Env):
    """The hand, the blue and the red place, all of them somewhere else in each episode.

    Observations are {"observation.state": float32 [10]}: where hand, blue and red are, metres, and 1 while
    the hand touches a place, 0 elsewhere. Actions are float32 [3] in -1..1, how far the hand moves along
    every axis, in steps of a centimetre. An episode ends with success when red is visited after blue, with
    failure when it is visited before, and is truncated after `max_steps`. The info holds `is_success` and
    `phase`: 0 until blue is visited, 1 afterwards.

    Attributes: `hand`, `places` (blue, then red) and `phase`, which are for experts.

    Args:
        buttons: whether the places are buttons, pressed from above, rather than points in the air.
        render_mode: None or "rgb_array", the scene from above and, below it, from the front.
        max_steps: after which an episode is truncated.

    Raises ValueError for what is out of range.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": FPS}  # noqa: RUF012  gymnasium's own way

    def __init__(self, buttons: bool, render_mode: str | None = None, max_steps: int = MAX_STEPS) -> None:
        whole = isinstance(max_steps, int) and not isinstance(max_steps, bool)
        if not (whole and max_steps >= 1):
            raise ValueError(f"max_steps is {max_steps!r}: give 1 or more")
        if render_mode not in (None, "rgb_array"):
            raise ValueError(f"render_mode is {render_mode!r}: choose None or 'rgb_array'")
        self.buttons, self.render_mode, self.max_steps = buttons, render_mode, max_steps
        self.action_space = gym.spaces.Box(-1, 1, (len(ACTIONS),), np.float32)
        seen = gym.spaces.Box(-np.inf, np.inf, (len(DIMENSIONS),), np.float32)
        self.observation_space = gym.spaces.Dict({STATE: seen})
        self.hand: np.ndarray = np.zeros(3)
        self.places: np.ndarray = np.zeros((2, 3))
        self.phase, self._steps = 0, 0

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Put hand and places somewhere new."""
        super().reset(seed=seed)
        self.phase = self._steps = 0
        while True:
            self.hand = self.np_random.uniform([-0.15, -0.15, 0.15], [0.15, 0.15, 0.25])
            self.places = self.np_random.uniform([-0.25, -0.25, 0.05], [0.25, 0.25, 0.25], (2, 3))
            if self.buttons:
                self.places[:, 2] = TOP
            if self._fair:
                return self._observation, self._info(False)

    def step(self, action: np.ndarray) -> tuple[dict[str, np.ndarray], float, bool, bool, dict[str, Any]]:
        """Move the hand; actions beyond -1..1 are clipped."""
        self._steps += 1
        self.hand = np.clip(self.hand + STEP * np.clip(action, -1, 1), LOW, HIGH)
        visited = [self._visits(place) for place in self.places]
        success = visited[1] and self.phase == 1
        failure = visited[1] and self.phase == 0
        if visited[0]:
            self.phase = 1
        ended = success or failure
        truncated = self._steps >= self.max_steps and not ended
        return self._observation, float(success), ended, truncated, self._info(success)

    def render(self) -> UInt8[np.ndarray, "480 480 3"]:
        """Return the scene from above, y upwards, and below it from the front, z upwards; RGB."""
        picture = np.full((SIZE, SIZE, 3), 245, np.uint8)
        scale, split = SIZE / (HIGH[0] - LOW[0]) * 0.66, int(SIZE * 0.66)
        cv2.line(picture, (0, split), (SIZE, split), (180, 180, 180), 2)
        points = [self.places[0], self.places[1], self.hand]
        colours, radii = [(40, 90, 220), (220, 60, 40), (40, 40, 40)], [NEAR, NEAR, NEAR / 2]
        for point, colour, radius in zip(points, colours, radii, strict=True):
            across = round(SIZE / 2 + scale * point[0])
            for down in (split / 2 - scale * point[1], SIZE - 10 - scale * point[2] * 0.8):
                cv2.circle(picture, (across, round(down)), round(scale * radius), colour, -1, cv2.LINE_AA)
        return picture

    @property
    def _fair(self) -> bool:
        """Whether nothing is too close together, and red is not in the way to blue."""
        blue, red = self.places
        way = blue - self.hand
        along = np.clip((red - self.hand) @ way / (way @ way), 0, 1)
        gaps = [np.linalg.norm(blue - red), np.linalg.norm(way), np.linalg.norm(red - self.hand)]
        return bool(min(gaps) >= APART and np.linalg.norm(self.hand + along * way - red) >= CLEAR)

    @property
    def _observation(self) -> dict[str, Float32[np.ndarray, "10"]]:
        contact = float(any(self._visits(place) for place in self.places))
        return {STATE: np.array([*self.hand, *self.places.flat, contact], np.float32)}

    def _visits(self, place: Float[np.ndarray, "3"]) -> bool:
        if not self.buttons:
            return bool(np.linalg.norm(self.hand - place) <= NEAR)
        return bool(np.linalg.norm(self.hand[:2] - place[:2]) <= NEAR and self.hand[2] <= place[2])

    def _info(self, success: bool) -> dict[str, Any]:
        return {"is_success": bool(success), "phase": self.phase}


class Expert:
    """Goes to blue, then to red; a button it presses from above, and it rises before it crosses the table.

    Attributes:
        stage: number in `STAGES` that its last action belongs to.
        phase: the phase of the world then.
    """

    def __init__(self) -> None:
        self.stage = self.phase = 0

    def reset(self, env: gym.Env) -> None:
        """Begin an episode in `env`; raises ValueError for another world."""
        world = env.unwrapped
        if not isinstance(world, TwoPlaces):
            raise ValueError(f"the teacher was given {type(world).__name__}: it teaches {TwoPlaces.__name__}")
        self._world = world

    def act(self, observation: Mapping[str, Any], info: Mapping[str, Any]) -> Float32[np.ndarray, "3"]:
        """The action to take, each number in -1..1."""
        world, self.phase = self._world, self._world.phase
        hand, aim = world.hand, world.places[self.phase].copy()
        across = float(np.linalg.norm(aim[:2] - hand[:2]))
        pressing = across <= NEAR / 2 if world.buttons else float(np.linalg.norm(aim - hand)) <= 2 * NEAR
        if world.buttons:
            aim[2] = 0.0 if pressing else ABOVE
            if across > 2 * NEAR and hand[2] < ABOVE / 2:
                aim[:2] = hand[:2]  # up first
        self.stage = 2 * self.phase + pressing
        return np.clip((aim - hand) / SLOWS, -1, 1).astype(np.float32)


class TwoPlacesDiagnosis(GenericDiagnosis):
    """Which place was missed, or that red came first."""

    outcomes: tuple[str, ...] = OUTCOMES

    def outcome(self, info: Mapping[str, Any]) -> str:
        """Return which of `outcomes` a run has that ends with this info."""
        if info["is_success"]:
            return SUCCESS
        if info["terminated"]:
            return "red_first"
        return "red_never_reached" if info["phase"] else "blue_never_reached"

    def causes(self, episodes: Sequence[Episode]) -> list[str]:
        """Return the outcome of every failure, "" for a success: it says what there is to say."""
        return ["" if episode.success else episode.outcome for episode in episodes]


def recording(world: str) -> Recording:
    """What recordings of either world say, `world` its id."""
    what = "press the blue button, then the red one" if "Buttons" in world else "touch blue, then red"
    return Recording(
        task=what,
        truth={"phase": ("blue", "red"), "stage": STAGES},
        actions=ACTIONS,
        fps=FPS,
        noisy=(1.0, 1.0, 1.0),
        states={STATE: DIMENSIONS},
    )
