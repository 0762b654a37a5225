"""Failed runs: read from what eval.py wrote, and run once more for their pictures."""

import json
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
from tqdm import tqdm

from dpmacro import figures
from dpmacro.evaluation.rollouts import PlannerSource, replay
from dpmacro.worlds.base import NO_MACRO, SUCCESS
from dpmacro.worlds.two_flags.diagnosis import CAUSES

__all__ = ["Run", "by_cause", "example", "key_steps", "read_runs", "stills"]

PICTURES = 5
AT_ONCE = 20  # steps from blue to the change that one picture shows
OLD = 4  # steps that a picture comes before its moment, at most one less
SPARSE = 32  # steps between pictures at most
PER_RUN = ("seeds", "outcomes", "causes", "steps", "blue_steps", "first_changes")
DECIDING = ("flags", "layout_seed", "yaw_noise", "max_steps")  # of a world, beside the seed


@dataclass(frozen=True)
class Run:
    """A run as its `eval_info.json` has it; `source.path` is None for the teacher."""

    info: Path
    source: PlannerSource
    world: Mapping[str, Any]
    seed: int
    outcome: str
    cause: str
    steps: int
    blue_step: int | None
    first_change: int | None

    @property
    def where(self) -> tuple[Any, ...]:
        """What two runs in the same world have in common."""
        return self.seed, *(self.world.get(name) for name in DECIDING)


def read_runs(folders: str) -> list[Run]:
    """The runs of `folders`, separated by blanks, in each an eval_info.json or in its subfolders.

    Raises ValueError where there is none, where it lacks what is needed, and for a run that is there twice.
    """
    found: list[Run] = []
    for folder in map(Path, folders.split()):
        own = folder / "eval_info.json"
        infos = [own] if own.exists() else sorted(folder.glob("*/eval_info.json"))
        if not infos:
            raise ValueError(f"no eval_info.json in {folder} or its subfolders: give a folder of eval.py")
        for info in infos:
            found += _read(info)
    if not found:
        raise ValueError("no folders: give at least one that eval.py wrote")
    (key, times), *_ = Counter((run.source, run.where) for run in found).most_common(1)
    if times > 1:
        raise ValueError(
            f"{times} runs of {key[0].path or 'the teacher'} with seed {key[1][0]}: give each once"
        )
    return found


def by_cause(runs: Sequence[Run]) -> dict[str, list[Run]]:
    """The failed runs of every cause that occurs, the most frequent first."""
    groups = {cause: [run for run in runs if run.cause == cause] for cause in CAUSES}
    return {cause: groups[cause] for cause in sorted(groups, key=lambda c: -len(groups[c])) if groups[cause]}


def example(group: Sequence[Run], avoided: Sequence[tuple[Any, ...]] = ()) -> Run:
    """The run whose steps are nearest to their median; in a world to be avoided only if all are."""
    chosen = [run for run in group if run.where not in avoided] or list(group)
    middle = median(run.steps for run in chosen)
    return min(chosen, key=lambda run: abs(run.steps - middle))


def key_steps(run: Run) -> dict[int, str]:
    """The steps to show, in order, and what happens there.

    The first, that of the touch of blue and that of the first change of macro-action, as far as there are
    any, and the last; between the last of these events and the end as many as make `PICTURES`, evenly.
    """
    end = run.steps - 1
    blue, change = run.blue_step, run.first_change
    found = {0: "start"}
    if blue is not None and change is not None and 0 <= change - blue <= AT_ONCE:
        found[change] = "blue, change"
    else:
        found |= {step: what for step, what in ((blue, "blue touched"), (change, "change")) if step}
    event = max(found)
    parts = PICTURES - len(found)
    for part in range(1, parts):
        found.setdefault(event + (end - event) * part // parts, "on the way")
    return dict(sorted((found | {end: "last frame"}).items()))


def stills(run: Run, bar: tqdm) -> list[figures.Still]:
    """Pictures of a run's key steps, up to 3 steps older than those; the bar moves on by a step.

    Raises ValueError where the policy cannot be read, and where the run ends otherwise than it did.
    """
    wanted = key_steps(run)
    every = min(range(OLD, SPARSE + 1), key=lambda k: (max(step % k for step in wanted), -k))
    found = []
    with closing(replay(run.source, run.world, run.seed, every)) as moments:
        view = np.empty(0)
        for step, moment in enumerate(moments):
            bar.update()
            view = view if moment.view is None else moment.view
            if step in wanted:
                doing = "" if moment.macro == NO_MACRO else f"macro-action {moment.macro}, "
                state = f"{doing}phase {moment.phase}"
                found.append(figures.Still(view, wanted[step], f"step {step}", state, moment.macro))
    if (moment.outcome, step + 1) != (run.outcome, run.steps):
        raise ValueError(
            f"seed {run.seed} ends with {moment.outcome} after {step + 1} steps, not with {run.outcome} "
            f"after {run.steps} as in {run.info}: policy or code have changed since, run eval.py again"
        )
    return found


def _read(info: Path) -> Iterator[Run]:
    try:
        section = json.loads(info.read_text())["dpmacro"]
        path, recovery = section["policy_path"], section["recovery"]
        source = PlannerSource("policy", Path(path), recovery) if path else PlannerSource("teacher")
        # JSON knows no tuples, which the world's options hold.
        world = {name: tuple(v) if isinstance(v, list) else v for name, v in section["world"].items()}
        rows = list(zip(*(section[name] for name in PER_RUN), strict=True))
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise ValueError(f"{info} is not what eval.py writes now ({error}): run that again") from error
    for row in rows:
        run = Run(info, source, world, *row)
        if (run.outcome == SUCCESS) != (run.cause == "") or run.cause not in ("", *CAUSES):
            raise ValueError(f"{info}: seed {run.seed} has outcome {run.outcome} and cause {run.cause!r}")
        yield run
