"""Meta-World: a robot arm at a table, and the scripted expert of every task, whose stages can be read.

An expert chooses where the hand is to go by a few cases ("beside the puck: go above it"), one `return` each
in `_desired_pos`. Which of them returns is the true macro-action of a frame, without a person's judgement.
"""

import __future__

import ast
import functools
import inspect
import textwrap
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import gymnasium as gym
import numpy as np
from jaxtyping import Float32, Int64

__all__ = [
    "ACTIONS",
    "FPS",
    "STATE",
    "TASKS",
    "MetaWorld",
    "Run",
    "ScriptedExpert",
    "check_task",
    "run_expert",
]

STATE = "observation.state"
ACTIONS = ("x", "y", "z", "gripper")  # how far the hand is to move, and how hard the fingers are to press
FPS = 80
MAX_STEPS = 400  # every expert below needs less than half of them
NOISY = np.array([1.0, 1.0, 1.0, 0.0])

# Every task with the stages of its expert, in the order of their `return` statements.
TASKS: dict[str, tuple[str, ...]] = {
    "pick-place-v3": ("approach", "descend", "grasp", "carry"),
    "assembly-v3": ("approach", "place", "descend", "lift", "carry"),
    "coffee-push-v3": ("approach", "descend", "push"),
    "drawer-close-v3": ("rise", "approach", "descend", "push"),
    "hammer-v3": ("approach", "descend", "align", "strike"),
}


@dataclass(frozen=True)
class Run:
    """A successful run of an expert; frame t holds the state before action t.

    Attributes:
        states: the hand, the gripper's opening and the objects, now and one frame ago, and the goal.
        actions: what the expert chose, each in -1..1; noise may have been added to what was done.
        stages: numbers in the task's stages.
        rewards: what every action earned.
    """

    states: Float32[np.ndarray, "frames 39"]
    actions: Float32[np.ndarray, "frames 4"]
    stages: Int64[np.ndarray, " frames"]
    rewards: Float32[np.ndarray, " frames"]


class MetaWorld(gym.Env):
    """A task of Meta-World as a Gymnasium environment: a seed places the objects, success ends the episode.

    Observations are {"observation.state": float32 [39]}, with the goal; actions float32 [4] in -1..1. After
    `max_steps` an episode is truncated. `info["is_success"]` says whether the task is solved.

    Raises ValueError where metaworld is missing or the task is none of `TASKS`.
    """

    def __init__(self, task: str, max_steps: int = MAX_STEPS) -> None:
        check_task(task)
        from metaworld.env_dict import ALL_V3_ENVIRONMENTS_GOAL_OBSERVABLE

        self.task, self.max_steps = task, max_steps
        self._env: Any = ALL_V3_ENVIRONMENTS_GOAL_OBSERVABLE[f"{task}-goal-observable"](seed=0)
        self._env.seeded_rand_vec = True  # else its seeds are ignored
        self._env._freeze_rand_vec = False
        self.action_space = self._env.action_space
        self.observation_space = gym.spaces.Dict(
            {STATE: gym.spaces.Box(-np.inf, np.inf, self._env.observation_space.shape, np.float32)}
        )
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

    def close(self) -> None:
        """Let go of the simulation."""
        self._env.close()

    @staticmethod
    def _observation(state: np.ndarray) -> dict[str, np.ndarray]:
        return {STATE: state.astype(np.float32)}


class ScriptedExpert:
    """The expert of a task, who tells the stage that its last action belongs to.

    Attributes:
        stages: names of the stages.
        stage: number in `stages`; -1 before the first action.
    """

    def __init__(self, task: str) -> None:
        check_task(task)
        from metaworld.policies import ENV_POLICY_MAP

        self.stages = TASKS[task]
        self.stage = -1
        policy: Any = ENV_POLICY_MAP[task]
        self._policy = policy()
        self._stage_at, count = _stage_reader(policy)
        if count != len(self.stages):
            raise ValueError(
                f"task {task}: its expert has {count} stages in this version of metaworld, "
                f"{', '.join(self.stages)} are expected: pip install -e '.[metaworld]'"
            )

    def reset(self, env: gym.Env) -> None:
        """Begin an episode."""
        self.stage = -1

    def act(self, observation: Mapping[str, Any], info: Mapping[str, Any]) -> Float32[np.ndarray, "4"]:
        """The action to take, each number in -1..1."""
        state = np.asarray(observation[STATE])
        self.stage = self._stage_at(self._policy._parse_obs(state))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # it warns of every action that is to be clipped
            action = self._policy.get_action(state)
        return np.clip(action, -1, 1).astype(np.float32)


def run_expert(task: str, seed: int, noise: float = 0.0) -> Run | None:
    """The expert's run from where `seed` places the objects; None where it does not succeed in `MAX_STEPS`.

    Normal noise of this standard deviation is added to the moves that are made, not to the gripper and not to
    the actions that are told. It follows from the seed, too. Raises ValueError as `check_task` does.
    """
    check_task(task)
    env, expert = _stage(task)
    rng = np.random.default_rng(seed)
    observation, info = env.reset(seed=seed)
    expert.reset(env)
    frames: list[tuple[np.ndarray, np.ndarray, int, float]] = []
    ended = truncated = False
    while not (ended or truncated):
        action = expert.act(observation, info)
        disturbed = action + noise * rng.normal(size=len(ACTIONS)) * NOISY
        after, reward, ended, truncated, info = env.step(disturbed.astype(np.float32))
        frames.append((observation[STATE], action, expert.stage, reward))
        observation = after
    if not info["is_success"]:
        return None
    states, actions, stages, rewards = zip(*frames, strict=True)
    return Run(np.stack(states), np.stack(actions), np.array(stages, np.int64), np.array(rewards, np.float32))


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
def _stage(task: str) -> tuple[MetaWorld, ScriptedExpert]:
    """The task and its expert, for one run after another."""
    return MetaWorld(task), ScriptedExpert(task)
