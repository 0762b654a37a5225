"""BabyAI: small levels of rooms, doors and objects, and the plan of the bot that solves them.

The bot of the package minigrid keeps a stack of subgoals; the one on top chooses the action. Which one that
is tells the true macro-action of a frame, without a person's judgement.
"""

import io
from collections.abc import Mapping
from contextlib import redirect_stdout
from typing import Any

import gymnasium as gym

from dpmacro.worlds.base import GaveUp, Recording

__all__ = ["ACTIONS", "LEVELS", "SUBGOALS", "Bot", "check_level", "make", "recording"]

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


class Bot:
    """The bot of minigrid as an expert, who tells the subgoal that its last action belongs to.

    Attributes:
        subgoal: number in SUBGOALS, of the subgoal that chose the action: the top of the bot's stack as its
            replanning ends. "Explore" never is one, since it always calls for another.
        purpose: number in SUBGOALS, of the topmost subgoal on the same stack that is no "GoNextTo": what the
            walk is for; "GoNextTo" where there is none.
        task: the mission in words.
    """

    def __init__(self) -> None:
        self.subgoal = self.purpose = GO_NEXT_TO
        self.task = ""

    def reset(self, env: gym.Env) -> None:
        """Begin an episode of a level that was just reset; raises ValueError for another world."""
        from minigrid.utils.baby_ai_bot import BabyAIBot

        mission = getattr(env.unwrapped, "mission", None)
        if mission is None:
            raise ValueError(f"the teacher was given {type(env.unwrapped).__name__}: it teaches BabyAI only")
        self.task = str(mission)
        self._bot = BabyAIBot(env)

    def act(self, observation: Mapping[str, Any], info: Mapping[str, Any]) -> int:
        """The action to take. Raises GaveUp where the bot knows none."""
        self._bot.stack = _Plan(self._bot.stack)
        try:
            action = int(self._bot.replan())
        except Exception as error:  # the bot checks little: a situation it cannot handle raises any kind
            raise GaveUp(f"the bot raised {error!r}") from error
        if not self._bot.stack:
            raise GaveUp("the bot takes the mission for accomplished")
        plan = self._bot.stack.classes()
        self.subgoal, self.purpose = plan[-1], _purpose(plan)
        return action


def make(level: str, *, tile: int = 8, **options: Any) -> gym.Env:
    """The level of this id, as the agent sees it: RGB images of the 7x7 cells before it, in its own cell what
    it carries, 7 * `tile` pixels high and wide.

    Raises ValueError where minigrid is missing or has no such level.
    """
    check_level(level)
    from minigrid.wrappers import RGBImgPartialObsWrapper

    if not isinstance(tile, int) or not 1 <= tile <= 32:
        raise ValueError(f"BabyAI: tile is {tile!r}: give 1 to 32 pixels")
    return _Quiet(RGBImgPartialObsWrapper(gym.make(level, **options), tile_size=tile))


def recording(world: str) -> Recording:
    """What recordings of a level say, `world` its id."""
    check_level(world)
    return Recording(
        task=world,
        truth={"subgoal": SUBGOALS, "purpose": SUBGOALS},
        actions=ACTIONS,
        fps=10,
        observations={"observation.images.avatar": "image"},
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


class _Quiet(gym.Wrapper):
    """Prints nothing as it is reset, where minigrid prints the missions that it rejects."""

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        with redirect_stdout(io.StringIO()):
            return self.env.reset(seed=seed, options=options)
