"""Why runs failed: one cause for every failed run, told from the episodes alone.

Which macro-actions belong to which phase is seen in the runs that succeed (`home_phases`). A failed run has
the first of these causes that applies; its end are its last steps, those of its loop or else `END` of them:

- changed_early: blue not reached, under a macro-action whose home is after blue.
- change_missed: blue reached, under a macro-action whose home is before blue.
- red_in_the_way: red touched first, under any other macro-action, or none.
- pressed: at the end forward steps cover less than `SLIP` of the way that they would in the open, held up by
  a wall or flag.
- spins: at the end nothing but turns, round a whole turn: no flag is recognised.
- dithers: at the end nothing but turns, left and right.
- out_of_time: none of these.
"""

from collections import Counter
from collections.abc import Mapping, Sequence

import numpy as np

from dpmacro.evaluation.rollouts import Episode
from dpmacro.worlds.two_flags.env import FORWARD, STEP, TURN_LEFT, TURN_RIGHT, WHOLE_TURN

CAUSES = (
    "changed_early",
    "change_missed",
    "red_in_the_way",
    "pressed",
    "spins",
    "dithers",
    "out_of_time",
)
END = WHOLE_TURN
SLIP = 0.25
HOME = 0.8


def failure_causes(episodes: Sequence[Episode]) -> list[str]:
    """One of `CAUSES` for every failed run, "" for a success."""
    homes = home_phases(episodes)
    return ["" if episode.success else cause(episode, homes) for episode in episodes]


def home_phases(episodes: Sequence[Episode]) -> dict[int, int]:
    """The phase, 0 or 1, that each macro-action belongs to.

    It is the one in which successful runs spend at least `HOME` of the macro-action's frames; a macro-action
    that both phases share has none. Where no run succeeds, the macro-action that runs start in belongs to
    phase 0 and all others to phase 1. Where only one macro-action is ever in use, there is nothing to tell.
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


def first_change(episode: Episode) -> int | None:
    """The step on which the macro-action is first another than on the step before; None where it stays."""
    changes = np.flatnonzero(np.diff(episode.macros))
    return int(changes[0]) + 1 if len(changes) else None


def _way(episode: Episode, steps: int) -> float:
    """Metres covered in the last steps, but for the very last; infinite where the world does not tell."""
    if episode.positions is None:
        return np.inf
    return float(np.linalg.norm(np.diff(episode.positions[-steps:], axis=0), axis=1).sum())
