"""BabyAI: small levels of rooms, doors and objects, and the plan of the bot that solves them.

The bot of the package minigrid keeps a stack of subgoals; the one on top chooses the action. Which one that
is tells the true macro-action of a frame, without a person's judgement.
"""

import functools
import io
from collections.abc import Callable
from contextlib import redirect_stdout
from dataclasses import dataclass
from typing import Any

import gymnasium as gym
import numpy as np
from jaxtyping import Float32, Int64, UInt8

# Small levels whose plans have two to five classes of subgoals, and which the bot solves fast and reliably.
LEVELS = (
    "BabyAI-GoToSeqS5R2-v0",
    "BabyAI-UnlockLocal-v0",
    "BabyAI-PutNextS5N2-v0",
    "BabyAI-PickupAbove-v0",
    "BabyAI-UnlockPickup-v0",
    "BabyAI-SynthS5R2-v0",
)
ACTIONS = ("left", "right", "forward", "pickup", "drop", "toggle", "done")
SUBGOALS = ("GoNextTo", "Pickup", "Drop", "Open", "Close", "Explore")
GO_NEXT_TO = SUBGOALS.index("GoNextTo")
MAX_PUSHES = 1000  # subgoals pushed for one action: a dozen or so, unless the bot never stops planning


@dataclass(frozen=True)
class Run:
    """A successful run of the bot; frame t holds the observation before action t.

    Attributes:
        images: what the agent sees, the 7x7 cells before it, in its own cell what it carries.
        actions: numbers in ACTIONS.
        rewards: what every action earned: 0 but for the last, which earned more than 0.
        subgoals: numbers in SUBGOALS, of the subgoal that chose the action: the top of the bot's stack as
            its replanning ends. "Explore" never is one, since it always calls for another.
        purposes: numbers in SUBGOALS, of the topmost subgoal on the same stack that is no "GoNextTo": what
            the walk is for; "GoNextTo" where there is none.
        mission: the task in words.
    """

    images: UInt8[np.ndarray, "frames height width 3"]
    actions: Int64[np.ndarray, " frames"]
    rewards: Float32[np.ndarray, " frames"]
    subgoals: Int64[np.ndarray, " frames"]
    purposes: Int64[np.ndarray, " frames"]
    mission: str


def run_bot(level: str, seed: int, tile: int = 8) -> Run | None:
    """The bot's run in a level (a gymnasium id); None where it fails, gives up, or time runs out.

    Images are 7 * `tile` pixels high and wide. Raises ValueError where minigrid is missing or has no such
    level.
    """
    check_level(level)
    env, make_bot = _stage(level, tile)
    with redirect_stdout(io.StringIO()):  # it prints the missions that it rejects
        observation, _ = env.reset(seed=seed)
    bot = make_bot(env)
    images, actions, rewards, plans = [], [], [], []
    ended = False
    while not ended:
        bot.stack = _Plan(bot.stack)
        try:
            action = int(bot.replan())
        except Exception:  # the bot checks little: a situation it cannot handle raises any kind of error
            return None
        if not bot.stack:  # it takes the mission for accomplished
            return None
        plans.append(bot.stack.classes())
        images.append(observation["image"])
        actions.append(action)
        observation, reward, terminated, truncated, _ = env.step(action)
        rewards.append(reward)
        ended = terminated or truncated
    if rewards[-1] <= 0:
        return None
    return Run(
        images=np.stack(images),
        actions=np.array(actions, np.int64),
        rewards=np.array(rewards, np.float32),
        subgoals=np.array([plan[-1] for plan in plans], np.int64),
        purposes=np.array([_purpose(plan) for plan in plans], np.int64),
        mission=str(observation["mission"]),
    )


def check_level(level: str) -> None:
    """Raise ValueError where minigrid is missing or has no such level."""
    try:
        import minigrid  # noqa: F401  registers the levels
    except ImportError as error:
        raise ValueError("BabyAI needs the package minigrid: pip install -e '.[babyai]'") from error
    if not level.startswith("BabyAI-") or level not in gym.registry:
        raise ValueError(f"level is {level!r}: give the id of a BabyAI level, like {', '.join(LEVELS)}")


def _purpose(plan: list[int]) -> int:
    """The last number, the top of the stack, that is not GO_NEXT_TO."""
    return next((subgoal for subgoal in reversed(plan) if subgoal != GO_NEXT_TO), GO_NEXT_TO)


class _Plan(list[Any]):
    """A stack of subgoals that raises RecursionError where one replanning pushes more than `MAX_PUSHES`."""

    def __init__(self, subgoals: list[Any]) -> None:
        super().__init__(subgoals)
        self._pushes = 0

    def append(self, subgoal: Any) -> None:
        self._pushes += 1
        if self._pushes > MAX_PUSHES:
            raise RecursionError(f"{MAX_PUSHES} subgoals and no action")
        super().append(subgoal)

    def classes(self) -> list[int]:
        """Numbers in SUBGOALS, the top of the stack last."""
        return [SUBGOALS.index(type(subgoal).__name__.removesuffix("Subgoal")) for subgoal in self]


@functools.cache
def _stage(level: str, tile: int) -> tuple[gym.Env, Callable[[gym.Env], Any]]:
    """The level, for one run after another, and what makes a bot for a mission that was just reset."""
    from minigrid.utils.baby_ai_bot import BabyAIBot
    from minigrid.wrappers import RGBImgPartialObsWrapper

    return RGBImgPartialObsWrapper(gym.make(level), tile_size=tile), BabyAIBot
