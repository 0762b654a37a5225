"""Meta-World: a robot arm at a table, and the scripted expert of every task, whose stages can be read.

An expert chooses where the hand is to go by a few cases ("beside the puck: go above it"), one `return` each
in `_desired_pos`. Which of them returns is the true macro-action of a frame, without a person's judgement.

Pictures are drawn by MuJoCo, by default without shadows and reflections, which take nine tenths of the time.
On a Linux machine without a display MuJoCo draws by EGL, unless the environment variable MUJOCO_GL is set.
"""

import __future__

import ast
import atexit
import functools
import inspect
import os
import sys
import textwrap
import warnings
from collections.abc import Callable, Mapping
from typing import Any

import gymnasium as gym
import numpy as np
from jaxtyping import Float32, UInt8

from dpmacro.worlds.base import Recording

__all__ = [
    "ACTIONS",
    "FAMILY",
    "FPS",
    "STATE",
    "TASKS",
    "MetaWorld",
    "ScriptedExpert",
    "check_task",
    "complete_options",
    "recording",
]

# MuJoCo looks at it when it is imported, and its default, a window, fails where there is no display.
if sys.platform == "linux" and not os.environ.get("DISPLAY"):
    os.environ.setdefault("MUJOCO_GL", "egl")

FAMILY = "Meta-World/"  # what the worlds' ids begin with; the task follows
STATE = "observation.state"
ACTIONS = ("x", "y", "z", "gripper")  # how far the hand is to move, and how hard the fingers are to press
_POSE = ("x", "y", "z", "qx", "qy", "qz", "qw")
_THINGS = [f"{thing}_{part}" for thing in ("object", "second") for part in _POSE]
_NOW = ("hand_x", "hand_y", "hand_z", "gripper_opening", *_THINGS)
DIMENSIONS = (*_NOW, *(f"{name}_before" for name in _NOW), "goal_x", "goal_y", "goal_z")
FPS = 80
MAX_STEPS = 400  # every expert below needs fewer, most of them a third
VIEW = 480  # height and width, in pixels, of the view for people
CAMERA, PLACE = "corner2", (0.75, 0.075, 0.7)  # moved to where LeRobot has it; its pictures are upside down

# Every task with the stages of its expert, in the order of their `return` statements.
TASKS: dict[str, tuple[str, ...]] = {
    "pick-place-v3": ("approach", "descend", "grasp", "carry"),
    "assembly-v3": ("approach", "place", "descend", "lift", "carry"),
    "coffee-push-v3": ("approach", "descend", "push"),
    "drawer-close-v3": ("rise", "approach", "descend", "push"),
    "hammer-v3": ("approach", "descend", "align", "strike"),
    "box-close-v3": ("approach", "descend", "lift", "carry"),
    "shelf-place-v3": ("approach", "descend", "centre", "lift", "place"),
    "sweep-into-v3": ("approach", "descend", "sweep"),
    "bin-picking-v3": ("approach", "descend", "lift", "carry", "place"),
    "disassemble-v3": ("approach", "descend", "lift"),
    "basketball-v3": ("approach", "descend", "lift", "carry"),
    "hand-insert-v3": ("approach", "descend", "carry", "lower"),
    "pick-place-wall-v3": ("approach", "descend", "lift", "cross", "level", "carry"),
}


class MetaWorld(gym.Env):
    """A task of Meta-World as a Gymnasium environment: a seed places the objects, success ends the episode.

    Observations are {"observation.state": float32 [39]}: the hand, the gripper's opening and the objects, now
    and one frame ago, and the goal. With `pixels` there is {"pixels": uint8 [image_size, image_size, 3]} as
    well. Actions are float32 [4] in -1..1. After `max_steps` an episode is truncated. `info["is_success"]`
    says whether the task is solved.

    Attributes: `task`.

    Args:
        task: one of `TASKS`.
        render_mode: None or "rgb_array".
        max_steps: after which an episode is truncated.
        pixels: whether observations hold pictures.
        image_size: their height and width.
        shadows: whether pictures have shadows and reflections, which makes them slow.

    Raises ValueError where metaworld is missing, and for what is out of range.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": FPS}  # noqa: RUF012  gymnasium's own way

    def __init__(
        self,
        task: str,
        render_mode: str | None = None,
        max_steps: int = MAX_STEPS,
        pixels: bool = False,
        image_size: int = 96,
        shadows: bool = False,
    ) -> None:
        check_task(task)
        for ok, name, value, remedy in (
            (render_mode in (None, "rgb_array"), "render_mode", render_mode, "choose None or 'rgb_array'"),
            (_whole(max_steps, 1), "max_steps", max_steps, "give 1 or more"),
            (isinstance(pixels, bool), "pixels", pixels, "choose true or false"),
            (_whole(image_size, 16, VIEW), "image_size", image_size, f"give 16 to {VIEW} pixels"),
            (isinstance(shadows, bool), "shadows", shadows, "choose true or false"),
        ):
            if not ok:
                raise ValueError(f"Meta-World: {name} is {value!r}: {remedy}")
        from metaworld.env_dict import ALL_V3_ENVIRONMENTS_GOAL_OBSERVABLE

        self.task, self.max_steps, self.render_mode = task, max_steps, render_mode
        self._pixels, self._image_size, self._shadows = pixels, image_size, shadows
        self._env: Any = ALL_V3_ENVIRONMENTS_GOAL_OBSERVABLE[f"{task}-goal-observable"](seed=0)
        self._env.seeded_rand_vec = True  # else its seeds are ignored
        self._env._freeze_rand_vec = False
        self._env.model.camera(CAMERA).pos[:] = PLACE  # before a reset, which moves the camera there
        self.action_space = self._env.action_space
        spaces = {STATE: gym.spaces.Box(-np.inf, np.inf, self._env.observation_space.shape, np.float32)}
        if pixels:
            spaces["pixels"] = gym.spaces.Box(0, 255, (image_size, image_size, 3), np.uint8)
        self.observation_space = gym.spaces.Dict(spaces)
        self._renderers: dict[int, Any] = {}
        self._steps = 0

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Place the objects anew."""
        super().reset(seed=seed)
        if seed is not None:
            self._env.seed(seed)
        self._steps = 0
        state, _ = self._env.reset()
        return self._observation(state), {"is_success": False}

    def step(self, action: np.ndarray) -> tuple[dict[str, np.ndarray], float, bool, bool, dict[str, Any]]:
        """Move the hand; actions beyond -1..1 are clipped."""
        self._steps += 1
        state, reward, _, _, info = self._env.step(np.clip(action, -1, 1))
        success = bool(info["success"])
        ended = self._steps >= self.max_steps and not success
        return self._observation(state), float(reward), success, ended, {"is_success": success}

    def render(self) -> UInt8[np.ndarray, "480 480 3"]:
        """Return the view for people, RGB."""
        return self._picture(VIEW)

    def close(self) -> None:
        """Let go of the simulation."""
        _close_all(self._renderers)
        self._env.close()

    def _observation(self, state: np.ndarray) -> dict[str, np.ndarray]:
        observation = {STATE: state.astype(np.float32)}
        return observation | {"pixels": self._picture(self._image_size)} if self._pixels else observation

    def _picture(self, size: int) -> UInt8[np.ndarray, "size size 3"]:
        if size not in self._renderers:
            self._renderers[size] = self._renderer(size)
            # Those that are left to the interpreter's end write tracebacks, since EGL has gone by then.
            atexit.register(_close_all, self._renderers)
        renderer = self._renderers[size]
        renderer.update_scene(self._env.data, camera=CAMERA)
        return np.ascontiguousarray(renderer.render()[::-1, ::-1])

    def _renderer(self, size: int) -> Any:
        import mujoco

        model = self._env.model
        if not self._shadows:  # before the first picture
            model.vis.quality.shadowsize, model.vis.quality.offsamples = 1, 0
        renderer = mujoco.Renderer(model, size, size)
        if not self._shadows:
            for flag in (mujoco.mjtRndFlag.mjRND_SHADOW, mujoco.mjtRndFlag.mjRND_REFLECTION):
                renderer.scene.flags[flag] = 0
        return renderer


class ScriptedExpert:
    """The expert of every task, who tells the stage that its last action belongs to.

    Attributes:
        stage: number in the task's stages; -1 before the first action.
    """

    def __init__(self) -> None:
        self.stage = -1
        self._task = ""

    def reset(self, env: gym.Env) -> None:
        """Begin an episode in `env`, which must be a task of Meta-World; raises ValueError otherwise."""
        world = env.unwrapped
        if not isinstance(world, MetaWorld):
            raise ValueError(f"the teacher was given {type(world).__name__}: it teaches Meta-World only")
        if world.task != self._task:
            self._policy, self._stage_at = _expert(world.task)
            self._task = world.task
        self.stage = -1

    def act(self, observation: Mapping[str, Any], info: Mapping[str, Any]) -> Float32[np.ndarray, "4"]:
        """The action to take, each number in -1..1."""
        state = np.asarray(observation[STATE])
        self.stage = self._stage_at(self._policy._parse_obs(state))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # it warns of every action that is to be clipped
            action = self._policy.get_action(state)
        return np.clip(action, -1, 1).astype(np.float32)


def recording(world: str) -> Recording:
    """What recordings of a task say, `world` its id."""
    task = world.removeprefix(FAMILY)
    check_task(task)
    return Recording(
        task=task,
        truth={"stage": TASKS[task]},
        actions=ACTIONS,
        fps=FPS,
        noisy=(1.0, 1.0, 1.0, 0.0),  # a disturbed gripper drops what it holds
        states={STATE: DIMENSIONS},
    )


def complete_options(options: Mapping[str, Any]) -> dict[str, Any]:
    """The options of the world; datasets of earlier versions also name the noise of their recording."""
    return {name: value for name, value in options.items() if name != "noise"}


def check_task(task: str) -> None:
    """Raise ValueError where metaworld is missing or `TASKS` has no such task."""
    if task not in TASKS:
        raise ValueError(f"task is {task!r}: choose from {', '.join(TASKS)}")
    try:
        import metaworld  # noqa: F401
    except ImportError as error:
        raise ValueError(
            "Meta-World needs the packages metaworld and mujoco: pip install -e '.[metaworld]'"
        ) from error


class _Numbered(ast.NodeTransformer):
    """Every `return` returns its own number, 0 for the first."""

    def __init__(self) -> None:
        self.count = 0

    def visit_Return(self, node: ast.Return) -> ast.Return:
        self.count += 1
        return ast.copy_location(ast.Return(ast.Constant(self.count - 1)), node)


def _stage_reader(policy: Any) -> tuple[Callable[[dict[str, Any]], int], int]:
    """`_desired_pos` that returns the number of its `return` statement instead, and their count."""
    original = policy._desired_pos
    tree: Any = ast.parse(textwrap.dedent(inspect.getsource(original)))
    tree.body[0].decorator_list = []  # staticmethod
    numbered = _Numbered()
    tree = ast.fix_missing_locations(numbered.visit(tree))
    # Its annotations need not be evaluated.
    code = compile(tree, inspect.getfile(original), "exec", __future__.annotations.compiler_flag, True)
    names: dict[str, Any] = {}
    exec(code, original.__globals__, names)
    return names[original.__name__], numbered.count


@functools.cache
def _expert(task: str) -> tuple[Any, Callable[[dict[str, Any]], int]]:
    """The package's policy for a task, and what tells its stage in a situation."""
    check_task(task)
    from metaworld.policies import ENV_POLICY_MAP

    policy: Any = ENV_POLICY_MAP[task]
    stage_at, count = _stage_reader(policy)
    if count != len(TASKS[task]):
        raise ValueError(
            f"task {task}: its expert has {count} stages in this version of metaworld, "
            f"{', '.join(TASKS[task])} are expected: pip install -e '.[metaworld]'"
        )
    return policy(), stage_at


def _close_all(renderers: dict[int, Any]) -> None:
    while renderers:
        renderers.popitem()[1].close()


def _whole(value: Any, least: int, most: int = sys.maxsize) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and least <= value <= most
