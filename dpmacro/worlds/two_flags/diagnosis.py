"""How runs among flags end, and why they fail.

A failed run has one of three outcomes. It touched red before blue, or its time ran out before it reached
blue, or its time ran out between blue and red. It also has one cause, told from the episodes alone. Which
macro-actions belong to which phase is taken from the runs that succeed (`home_phases`). A failed run has the
first of these causes that applies. The end of a run is its loop where it has one, and its last `END` steps
otherwise.

- changed_early: blue was not reached, and the last macro-action belongs to the phase after blue.
- change_missed: blue was reached, and the last macro-action belongs to the phase before blue.
- red_in_the_way: red was touched first, under any other macro-action, or none.
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

OUTCOMES = (SUCCESS, "red_first", "blue_never_reached", "red_never_reached")
CAUSES = (
    "changed_early",
    "change_missed",
    "red_in_the_way",
    "pressed",
    "spins",
    "dithers",
    "out_of_time",
)
END = WHOLE_TURN  # steps
SLIP = 0.25
HOME = 0.8


class TwoFlagsDiagnosis:
    """The `worlds.base.Diagnosis` of TwoFlags."""

    outcomes: tuple[str, ...] = OUTCOMES

    def outcome(self, info: Mapping[str, Any]) -> str:
        """Return which of `OUTCOMES` a run has that ends with this info."""
        return outcome_of(info)

    def causes(self, episodes: Sequence[Episode]) -> list[str]:
        """Return one of `CAUSES` for every failed run, "" for a success."""
        return failure_causes(episodes)

    def events(self, episodes: Sequence[Episode]) -> dict[str, list[Any]]:
        """Return `blue_steps`: for every run the step that reached the blue flag, None where none did."""
        return {"blue_steps": [blue_step(episode) for episode in episodes]}


def outcome_of(info: Mapping[str, Any]) -> str:
    """Return which of `OUTCOMES` a run has that ends with this info."""
    if info["is_success"]:
        return SUCCESS
    return info["failure"] or ("red_never_reached" if info["phase"] else "blue_never_reached")


def failure_causes(episodes: Sequence[Episode]) -> list[str]:
    """One of `CAUSES` for every failed run, "" for a success."""
    homes = home_phases(episodes)
    return ["" if episode.success else cause(episode, homes) for episode in episodes]


def home_phases(episodes: Sequence[Episode]) -> dict[int, int]:
    """The phase, 0 or 1, that each macro-action belongs to.

    A macro-action belongs to the phase that holds at least the share `HOME` of its frames in successful runs.
    One with a smaller share in either phase belongs to neither and is left out. Where no run succeeds, the
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
        if count >= HOME * (frames[macro, 0] + frames[macro, 1])
    }


def cause(episode: Episode, homes: Mapping[int, int]) -> str:
    """Why a failed run failed, one of `CAUSES`.

    Args:
        episode: the run.
        homes: from a macro-action to the phase it belongs to, of those that belong to one.
    """
    reached = int(blue_step(episode) is not None)
    if homes.get(int(episode.macros[-1]), reached) != reached:
        return "change_missed" if reached else "changed_early"
    if episode.outcome == "red_first":
        return "red_in_the_way"
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
    rewarded = np.flatnonzero(episode.rewards > 0)
    return int(rewarded[0]) if len(rewarded) else None


def _way(episode: Episode, steps: int) -> float:
    """Metres covered in the last steps, but for the very last; infinite where the world does not tell."""
    if episode.positions is None:
        return np.inf
    return float(np.linalg.norm(np.diff(episode.positions[-steps:], axis=0), axis=1).sum())
