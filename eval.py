"""Run a saved policy, or the teacher, in a world and count successes.

    python eval.py --policy.path=outputs/train/.../checkpoints/last/pretrained_model --workers=2
    python eval.py --policy.path=... --world.id=gym_pusht/PushT-v0 --world.import=gym_pusht
    python eval.py --policy.type=teacher --world.id=Meta-World/hammer-v3 --world.max_steps=300 --videos=3

The world is any that gymnasium knows; without --world.id it is the one that the demonstrations are from.
Prints successes, their rate with its 95% interval, what told success, how the failures split and why they
failed, and writes the same to `eval_info.json` in LeRobot's form, TensorBoard scalars beside it. Where a
world tells its state, a run that begins to repeat itself ends there, as the failure that it is, and counts
its steps until then; a policy with recovery goes on. Where the evaluation ends early, the runs done so far
are kept in `eval_info.partial.json`.
"""

if __name__ in ("__main__", "__mp_main__"):
    import dpmacro.utils.starting  # noqa: F401  Ctrl-C during the imports below is one line

import json
import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass, field
from datetime import datetime
from functools import cached_property
from pathlib import Path
from typing import Any

from tqdm import tqdm

from dpmacro.evaluation.rollouts import PlannerSource, iter_episodes, replay
from dpmacro.evaluation.stage import Stage
from dpmacro.metrics.success import SuccessSummary, success_summary
from dpmacro.utils import cli
from dpmacro.utils.claims import claimed
from dpmacro.utils.files import replacing
from dpmacro.worlds import DEFAULT, RECORDINGS, diagnosis_of, entry_of, recording_of
from dpmacro.worlds.base import Episode, Moment, WorldError
from dpmacro.worlds.making import WorldOptions, complete

# Every worker process imports this file again: what only the parent needs is imported where it is used.

VIDEO_EVERY, LONG = 4, 300  # steps that a video shows as one frame, of runs with more steps than that
PARTIAL = "eval_info.partial.json"
LARGEST = 2**32 - 1  # of options that are counts, and of seeds


@dataclass(frozen=True)
class PolicyOptions:
    """What runs: a saved policy or the teacher."""

    path: Path | None = None
    """Folder `pretrained_model` of a training run."""
    type: str | None = None
    """`teacher` for the teacher, instead of a path."""
    recovery: bool | None = None
    """Whether a policy that repeats itself takes another action; by default as it was saved."""


@dataclass(frozen=True)
class EvalOptions:
    """Options of eval.py."""

    policy: PolicyOptions = field(default_factory=PolicyOptions)
    world: WorldOptions = field(default_factory=WorldOptions)
    episodes: int = 100
    """Runs, each with its own seed."""
    seed: int = 10000
    """Seed of the first run; every further run takes the next."""
    workers: int = 1
    """Processes that share the runs; the results do not depend on it."""
    videos: int = 0
    """Runs to write as MP4, failed ones first, those of more than 300 steps at four times their speed."""
    output_dir: Path | None = None
    """Folder for results; by default outputs/eval/<date>/<time>_<job_name>."""
    job_name: str | None = None
    """Name of the evaluation; by default that of what runs."""

    def __post_init__(self) -> None:
        if (self.policy.path is None) == (self.policy.type is None):
            raise ValueError("give either --policy.path=<a run's pretrained_model> or --policy.type=teacher")
        if self.policy.type not in (None, "teacher"):
            raise ValueError(
                f"--policy.type={self.policy.type} is unknown: choose teacher or give a --policy.path"
            )
        if self.policy.type is not None and self.policy.recovery is not None:
            raise ValueError(f"--policy.recovery={self.policy.recovery} is for saved policies: leave it out")
        for name, least in (("episodes", 1), ("seed", 0), ("workers", 1), ("videos", 0)):
            if getattr(self, name) < least:
                raise ValueError(f"--{name}={getattr(self, name)}: it must be at least {least}")
            if getattr(self, name) > LARGEST:
                raise ValueError(f"--{name}={getattr(self, name)}: it must be at most {LARGEST}")


def main(options: EvalOptions) -> None:
    """Run the planner in its world; print how it fared, and write it down."""
    from dpmacro.evaluation.summary import write_scalars
    from dpmacro.utils.hparams import write_row

    source, name, trained_in, action_names = planner(options.policy)
    world = chosen_world(options, trained_in)
    for line in check(source, world, options.videos):
        print(line)
    output_dir = options.output_dir or default_output_dir(options.job_name or name)
    cli.hold(claimed(output_dir))
    if (output_dir / "eval_info.json").exists():
        raise ValueError(f"{output_dir} already holds an eval_info.json: give another --output_dir")
    output_dir.mkdir(parents=True, exist_ok=True)
    ran = {
        "planner": name,
        "policy_path": source.path and str(source.path),
        "recovery": bool(source.recovery),
        "world": world,
    }

    started = time.perf_counter()
    seeds = range(options.seed, options.seed + options.episodes)
    episodes: list[Episode] = []
    try:
        for episode in run(source, world, seeds, options.workers):
            episodes.append(episode)  # noqa: PERF402  so that those before an error are kept
    except (ValueError, OSError, KeyboardInterrupt) as error:
        kept = keep_partial(output_dir, ran, episodes, options.episodes, time.perf_counter() - started)
        if isinstance(error, WorldError) and kept:
            raise ValueError(f"{error}; {kept}") from error
        raise
    result = Result(world["id"], episodes, time.perf_counter() - started)

    write_scalars(result.write(output_dir / "eval_info.json", ran)["overall"], output_dir / "tensorboard")
    write_row(output_dir / "tensorboard", compared(options, ran), scores(result.summary, source))
    (output_dir / PARTIAL).unlink(missing_ok=True)
    print(result.text())
    if options.videos:  # which take their time, and may be interrupted
        folder = output_dir / "videos" / f"{world['id'].replace('/', '_').replace(':', '_')}_0"
        videos = write_videos(source, world, episodes, options.videos, folder, action_names)
        result.write(output_dir / "eval_info.json", ran, videos)
    print(f"written to  {output_dir}")


@dataclass(frozen=True)
class Result:
    """The runs of an evaluation and how long they took."""

    world: str
    episodes: list[Episode]
    seconds: float

    @cached_property
    def summary(self) -> SuccessSummary:
        """Counts of how they ended."""
        return success_summary(
            [episode.outcome for episode in self.episodes],
            [int(episode.phases[-1]) for episode in self.episodes],
            [int(episode.macros[-1]) for episode in self.episodes],
        )

    @cached_property
    def causes(self) -> list[str]:
        """Why each failed."""
        return diagnosis_of(self.world).causes(self.episodes)

    def text(self) -> str:
        """For people."""
        from dpmacro.evaluation.summary import run_notes, run_text

        loops = sum(episode.loop > 0 for episode in self.episodes)
        return "\n".join(
            [run_text(self.summary, self.seconds, self.causes, loops), *run_notes(self.episodes)]
        )

    def write(self, place: Path, ran: dict[str, Any], videos: Sequence[str] = ()) -> dict[str, Any]:
        """Write the file, `ran` in our section; return what it holds."""
        from dpmacro.evaluation.summary import eval_info

        events = diagnosis_of(self.world).events(self.episodes)
        about = self.summary, self.causes, events, self.seconds
        info = eval_info(self.world, self.episodes, *about, videos)
        info["dpmacro"] |= ran
        with replacing(place) as path:
            path.write_text(json.dumps(info, indent=2) + "\n")
        return info


def compared(options: EvalOptions, ran: dict[str, Any]) -> dict[str, Any]:
    """The options that TensorBoard compares evaluations by: those of the policy's training, too."""
    about = {"planner": ran["planner"], "recovery": ran["recovery"]}
    about |= {"episodes": options.episodes, "first_seed": options.seed}
    trained = options.policy.path and options.policy.path / "train_config.json"
    known = json.loads(trained.read_text()) if trained and trained.exists() else {}
    return known | {"world": ran["world"], "evaluation": about}


def scores(summary: SuccessSummary, source: PlannerSource) -> dict[str, float]:
    """What it compares them by: success and its 95% interval, and the scores of the policy's training."""
    from dpmacro.utils.hparams import read_scores

    low, high = summary.interval
    known = read_scores(source.path) if source.path is not None else {}
    return {"success": summary.rate, "success_low": low, "success_high": high} | known


def keep_partial(
    output_dir: Path, ran: dict[str, Any], episodes: list[Episode], wanted: int, seconds: float
) -> str:
    """Keep the runs of an evaluation that ends early, in a file that is not taken for a whole one.

    Returns where they are, "" where there are none; then a folder that holds nothing goes as well.
    """
    if not episodes:
        with suppress(OSError):  # it holds something
            output_dir.rmdir()
        return ""
    place = output_dir / PARTIAL
    Result(ran["world"]["id"], episodes, seconds).write(place, ran | {"wanted_episodes": wanted})
    return f"the {len(episodes)} runs before it are kept in {place}"


def planner(options: PolicyOptions) -> tuple[PlannerSource, str, dict[str, Any], tuple[str, ...]]:
    """What runs, its name, the world it was trained in, and the names of its actions."""
    if options.path is None:
        return PlannerSource("teacher"), "teacher", {"id": DEFAULT}, ()
    from dpmacro.policy.policy import MacroPolicy

    policy = MacroPolicy.load(options.path)
    config = policy.config
    recovery = config.recovery if options.recovery is None else options.recovery
    policy.planner(recovery)  # refuses recovery without demonstrators' actions, before a folder is made
    return PlannerSource("policy", options.path, recovery), config.type, config.world, config.action_names


def chosen_world(options: EvalOptions, trained_in: dict[str, Any]) -> dict[str, Any]:
    """The world to run in: that of the demonstrations but for the options given, or another one."""
    # JSON knows no tuples, which a world's options may hold.
    stored = {name: tuple(value) if isinstance(value, list) else value for name, value in trained_in.items()}
    world = options.world.over(stored)
    if not isinstance(world.get("id"), str):
        raise ValueError(
            f"the demonstrations of {options.policy.path} name no world to run in: give one by --world.id="
        )
    return complete(world)


def check(source: PlannerSource, world: dict[str, Any], videos: int) -> list[str]:
    """What to say of a planner in a world before the first run; ValueError where they do not fit."""
    with closing(Stage(source.planner(world["id"]), world)) as stage:
        modes = stage.env.metadata.get("render_modes") or ()
        if videos and "rgb_array" not in modes:
            raise ValueError(
                f"--videos={videos}, and the world {world['id']} renders no pictures (render_modes are "
                f"{list(modes)}): leave the option out"
            )
        return [f"sees        {line}" for line in stage.sees.told()] if stage.sees else []


def default_output_dir(job_name: str) -> Path:
    """LeRobot's place for an evaluation."""
    return Path("outputs/eval") / f"{datetime.now():%Y-%m-%d/%H-%M-%S}_{job_name}"


def run(
    source: PlannerSource, world: dict[str, Any], seeds: Sequence[int], workers: int
) -> Iterator[Episode]:
    """The runs of all seeds, with a progress bar that shows the success rate so far."""
    successes = 0
    with (
        closing(iter_episodes(source, world, seeds, workers)) as running,
        tqdm(running, "Evaluating", len(seeds), unit="run") as bar,
    ):
        for done, episode in enumerate(bar, 1):
            successes += episode.success
            bar.set_postfix_str(f"success {successes / done:.0%}")
            yield episode


def write_videos(
    source: PlannerSource,
    world: dict[str, Any],
    episodes: Sequence[Episode],
    count: int,
    folder: Path,
    action_names: Sequence[str] = (),
) -> list[str]:
    """Replay up to `count` runs, failed ones first, into MP4s; their paths."""
    from dpmacro.evaluation.videos import write_run

    names = action_names
    if not names and entry_of(RECORDINGS, world["id"]):
        names = recording_of(world["id"]).actions
    chosen = sorted(range(len(episodes)), key=lambda index: episodes[index].success)[:count]
    paths = [folder / f"eval_episode_{index}.mp4" for index in chosen]
    steps = sum(episodes[index].steps for index in chosen)
    with tqdm(desc="Writing videos", total=steps, unit="step") as bar:
        for index, path in zip(chosen, paths, strict=True):
            every = VIDEO_EVERY if episodes[index].steps > LONG else 1
            with closing(replay(source, world, episodes[index].seed, every)) as moments:
                write_run(path, counted(moments, bar), names)
    return [str(path) for path in paths]


def counted(moments: Iterable[Moment], bar: tqdm) -> Iterator[Moment]:
    """The moments as they come, each moving the bar on."""
    for moment in moments:
        yield moment
        bar.update()


if __name__ == "__main__":
    cli.run(main, EvalOptions)
