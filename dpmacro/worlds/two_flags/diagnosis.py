"""How runs among flags end, and why they fail.

A failed run touched a flag before its turn (red_first), or its time ran out before it reached the flag whose
turn it was (blue_never_reached). It also has one cause, told from the episodes alone. Which
macro-actions belong to which phase is taken from the runs that succeed (`home_phases`). A failed run has the
first of these causes that applies. The end of a run is its loop where it has one, and its last `END` steps
otherwise.

- changed_early: the last macro-action belongs to a later phase than the run had come to.
- change_missed: the last macro-action belongs to an earlier phase.
- red_in_the_way: red was touched before its turn, under any other macro-action, or none; other flags
  likewise.
- pressed: at the end forward steps cover less than `SLIP` of the distance that they cover in open space,
  since a wall or a flag is in the way.
- spins: the end holds nothing but turns, and they add up to a whole turn at least.
- dithers: the end holds nothing but turns to the left and to the right.
- out_of_time: none of these.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from dpmacro.worlds.base import SUCCESS, Episode
from dpmacro.worlds.two_flags.env import FORWARD, STEP, TURN_LEFT, TURN_RIGHT, WHOLE_TURN
from dpmacro.worlds.two_flags.scene import FLAGS

__all__ = [
    "CAUSES",
    "OUTCOMES",
    "FourFlagsDiagnosis",
    "SixFlagsDiagnosis",
    "TwoFlagsDiagnosis",
    "blue_step",
    "cause",
    "failure_causes",
    "home_phases",
    "outcome_of",
    "outcomes_of",
]


def outcomes_of(count: int) -> tuple[str, ...]:
    """How runs among `count` flags end."""
    flags = FLAGS[:count]
    return (
        SUCCESS,
        *(f"{flag}_first" for flag in flags[1:]),
        *(f"{flag}_never_reached" for flag in flags),
    )


OUTCOMES = outcomes_of(2)
CAUSES = (
    "changed_early",
    "change_missed",
    "red_in_the_way",
    "pressed",
    "spins",
    "dithers",
    "out_of_time",
)
"""Why runs among two flags fail; with more of them, each but the first can be in the way."""
END = WHOLE_TURN  # steps
SLIP = 0.25
HOME = 0.8


class TwoFlagsDiagnosis:
    """The `worlds.base.Diagnosis` of TwoFlags, and of the same room with more flags."""

    flags: tuple[str, ...] = FLAGS[:2]
    outcomes: tuple[str, ...] = OUTCOMES

    def outcome(self, info: Mapping[str, Any]) -> str:
        """Return which of `outcomes` a run has that ends with this info."""
        return outcome_of(info)

    def causes(self, episodes: Sequence[Episode]) -> list[str]:
        """Return the cause of every failed run, as the module lists them; "" for a success."""
        return failure_causes(episodes)

    def events(self, episodes: Sequence[Episode]) -> dict[str, list[Any]]:
        """Return `blue_steps`: for every run the step that reached the blue flag, None where none did.

        Likewise for every other flag but the last, whose step is the end of the run.
        """
        reached = [_reaching_steps(episode) for episode in episodes]
        return {
            f"{flag}_steps": [steps[place] if place < len(steps) else None for steps in reached]
            for place, flag in enumerate(self.flags[:-1])
        }


class FourFlagsDiagnosis(TwoFlagsDiagnosis):
    """That of FourFlags."""

    flags = FLAGS[:4]
    outcomes = outcomes_of(4)


class SixFlagsDiagnosis(TwoFlagsDiagnosis):
    """That of SixFlags."""

    flags = FLAGS[:6]
    outcomes = outcomes_of(6)


def outcome_of(info: Mapping[str, Any]) -> str:
    """Return how a run ended that ends with this info, one of `outcomes_of` as many flags."""
    if info["is_success"]:
        return SUCCESS
    return info["failure"] or f"{FLAGS[info['phase']]}_never_reached"


def failure_causes(episodes: Sequence[Episode]) -> list[str]:
    """The cause of every failed run, as the module lists them; "" for a success."""
    homes = home_phases(episodes)
    return ["" if episode.success else cause(episode, homes) for episode in episodes]


def home_phases(episodes: Sequence[Episode]) -> dict[int, int]:
    """The phase that each macro-action belongs to.

    A macro-action belongs to the phase that holds at least the share `HOME` of its frames in successful runs.
    One with a smaller share in every phase belongs to none and is left out. Where no run succeeds, the
    macro-action that runs start in belongs to phase 0 and all others to phase 1. Where only one macro-action
    is ever used, none belongs to a phase.
    """
    frames = Counter[tuple[int, int]]()
    used, started = set[int](), set[int]()
    for episode in episodes:
        used.update(episode.macros.tolist())
        started.add(int(episode.macros[0]))
        if episode.success:
            frames.update(zip(episode.macros.tolist(), episode.phases.tolist(), strict=True))
    if len(used) < 2:
        return {}
    if not frames:
        return {macro: int(macro not in started) for macro in used}
    return {
        macro: phase
        for (macro, phase), count in frames.items()
        if count >= HOME * sum(n for (other, _), n in frames.items() if other == macro)
    }


def cause(episode: Episode, homes: Mapping[int, int]) -> str:
    """Why a failed run failed, one of the causes that the module lists.

    Args:
        episode: the run.
        homes: from a macro-action to the phase it belongs to, of those that belong to one.
    """
    reached = len(_reaching_steps(episode))
    home = homes.get(int(episode.macros[-1]), reached)
    if home != reached:
        return "change_missed" if home < reached else "changed_early"
    flag, _, early = episode.outcome.partition("_")
    if early == "first":
        return f"{flag}_in_the_way"
    end = episode.loop or END
    if episode.steps < end:
        return "out_of_time"
    actions = episode.actions[-end:]
    walked = int((actions == FORWARD).sum())
    if walked:
        return "pressed" if _way(episode, end) < SLIP * STEP * walked else "out_of_time"
    turned = int((actions == TURN_LEFT).sum()) - int((actions == TURN_RIGHT).sum())
    return "spins" if abs(turned) >= WHOLE_TURN else "dithers"


def blue_step(episode: Episode) -> int | None:
    """The step that reached the blue flag; None where none did."""
    return next(iter(_reaching_steps(episode)), None)


def _reaching_steps(episode: Episode) -> list[int]:
    """The steps that reached a flag whose turn it was."""
    return np.flatnonzero(episode.rewards > 0).tolist()


def _way(episode: Episode, steps: int) -> float:
    """Metres covered in the last steps, but for the very last; infinite where the world does not tell."""
    if episode.positions is None:
        return np.inf
    return float(np.linalg.norm(np.diff(episode.positions[-steps:], axis=0), axis=1).sum())
