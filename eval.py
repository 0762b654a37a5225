"""Run a saved policy, or the teacher, in a world and count successes.

    python eval.py --policy.path=outputs/train/.../checkpoints/last/pretrained_model --workers=2
    python eval.py --policy.path=... --world.id=gym_pusht/PushT-v0 --world.import=gym_pusht
    python eval.py --policy.type=teacher --world.id=Meta-World/hammer-v3 --world.max_steps=300 --videos=3

The world is any that gymnasium knows; without --world.id it is the one that the demonstrations are from.
Prints successes, their rate with its 95% interval, what told success, how the failures split and why they
failed, and writes the same to `eval_info.json` in LeRobot's form, TensorBoard scalars beside it. Where a
world tells its state, a run that begins to repeat itself ends there, as the failure that it is, and counts
its steps until then; a policy with recovery goes on.

Every finished run is kept in `runs.jsonl` at once. Where an evaluation was stopped, the same command with the
same --output_dir goes on with the other runs; with --videos it makes videos of an evaluation that is over.
"""

if __name__ in ("__main__", "__mp_main__"):
    import dpmacro.utils.starting  # noqa: F401  Ctrl-C during the imports below is one line

import json
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Any

from tqdm import tqdm

from dpmacro.evaluation.kept_episodes import RUNS, KeptEpisodes, policy_digest
from dpmacro.evaluation.rollouts import PlannerSource, RepeatError, as_before, iter_episodes, replay
from dpmacro.evaluation.stage import Stage
from dpmacro.metrics.success import SuccessSummary
from dpmacro.utils import cli
from dpmacro.utils.claims import claimed
from dpmacro.worlds import DEFAULT, RECORDINGS, entry_of, recording_of
from dpmacro.worlds.base import Episode, Moment, WorldError
from dpmacro.worlds.making import WorldOptions, complete

# Every worker process imports this file again: what only the parent needs is imported where it is used.

VIDEO_EVERY, LONG = 4, 300  # steps that a video shows as one frame, of runs with more steps than that
LARGEST = 2**32 - 1  # of options that are counts, and of seeds
INFO, RESULTS = "eval_info.json", "the results"


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
    from dpmacro.evaluation.result import Result
    from dpmacro.evaluation.summary import write_scalars
    from dpmacro.utils.hparams import write_row

    source, name, trained_in, action_names = planner(options.policy)
    world = chosen_world(options, trained_in)
    for line in check(source, world, options.videos):
        print(line)
    output_dir = options.output_dir or default_output_dir(options.job_name or name)
    cli.hold(claimed(output_dir))
    place, over = output_dir / INFO, (output_dir / INFO).exists()
    if over and not (options.videos and (output_dir / RUNS).exists()):
        raise ValueError(f"{output_dir} already holds an {INFO}: give another --output_dir")
    runs: dict[str, Any] = {"planner": name, "recovery": bool(source.recovery), "world": world}
    ran = {**runs, "policy_path": source.path and str(source.path)}
    runs |= {"policy": policy_digest(source.path), "seed": options.seed, "episodes": options.episodes}
    seeds = range(options.seed, options.seed + options.episodes)
    kept = KeptEpisodes(output_dir, runs, seeds)
    if kept.earlier:
        print(f"goes on     {kept.earlier} of {len(seeds)} runs are kept in {kept.path}")
    finish(kept, source, world, seeds, options.workers)
    result = Result(world["id"], kept.episodes, kept.seconds)

    def write_events() -> None:
        events = output_dir / "tensorboard"
        write_scalars(result.info(ran)["overall"], events)
        write_row(events, compared(options, ran), scores(result.summary, source))

    steps: dict[str, Callable[[], None]] = {RESULTS: lambda: print(result.text(), flush=True)}
    if not over:  # the file says that an evaluation is over: it is the last
        steps |= {"tensorboard": write_events, INFO: lambda: result.write(place, ran)}
    each(steps, kept)
    if options.videos:  # which take their time, and may be interrupted
        folder = output_dir / "videos" / f"{world['id'].replace('/', '_').replace(':', '_')}_0"
        videos, others = write_videos(source, world, kept.episodes, options.videos, folder, action_names)
        result.write(place, ran, videos)
        if others:
            raise ValueError("; ".join(others))
    print(f"written to  {output_dir}")


def finish(
    kept: KeptEpisodes, source: PlannerSource, world: dict[str, Any], seeds: Sequence[int], workers: int
) -> None:
    """Run the seeds that are not kept yet. Where that ends early, a line says what is kept."""
    try:
        for episode in run(source, world, seeds, workers, kept.episodes):
            kept.add(episode)
    except (ValueError, OSError, KeyboardInterrupt) as error:
        if isinstance(error, WorldError) and kept.episodes:
            told = f"the {len(kept.episodes)} runs before it are kept in {kept.path}"
            raise ValueError(f"{error}; {told}") from error
        if kept.episodes:
            told = f"{len(kept.episodes)} of {len(seeds)} runs are kept in {kept.path}"
            print(f"{told}: the same command with --output_dir={kept.path.parent} goes on", file=sys.stderr)
        raise
    finally:
        kept.drop_if_empty()


def each(steps: Mapping[str, Callable[[], None]], kept: KeptEpisodes) -> None:
    """Take every step, though others fail; then raise OSError, one line, for what was not written."""
    failed: dict[str, Exception] = {} if kept.unwritten is None else {RUNS: kept.unwritten}
    for name, step in steps.items():
        try:
            step()
        except (OSError, ValueError) as error:
            failed[name] = error
    lost = [name for name in failed if name != RESULTS]
    if lost:
        folder = kept.path.parent
        reasons = dict.fromkeys(getattr(failed[name], "strerror", None) or str(failed[name]) for name in lost)
        remedy = "all else is there"
        if INFO in lost:
            remedy = f"mend that, and run the same command with --output_dir={folder}: it goes on from {RUNS}"
        raise OSError(f"not written to {folder}: {', '.join(lost)} ({'; '.join(reasons)}); {remedy}")
    if failed:
        raise failed[RESULTS]


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
    source: PlannerSource,
    world: dict[str, Any],
    seeds: Sequence[int],
    workers: int,
    before: Sequence[Episode] = (),
) -> Iterator[Episode]:
    """The runs of the seeds after those of `before`, with a progress bar that shows the success rate."""
    successes, start = sum(episode.success for episode in before), len(before)
    if start == len(seeds):
        return
    with (
        closing(iter_episodes(source, world, seeds[start:], workers)) as running,
        tqdm(running, "Evaluating", len(seeds), initial=start, unit="run") as bar,
    ):
        for done, episode in enumerate(bar, start + 1):
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
) -> tuple[list[str], list[str]]:
    """Replay up to `count` runs, failed ones first, into MP4s, but for those that are there.

    Returns the paths of those, and what is wrong with runs that were others when they were repeated.
    """
    from dpmacro.evaluation.videos import write_run

    names = action_names
    if not names and entry_of(RECORDINGS, world["id"]):
        names = recording_of(world["id"]).actions
    chosen = sorted(range(len(episodes)), key=lambda index: episodes[index].success)[:count]
    paths = {index: folder / f"eval_episode_{index}.mp4" for index in chosen}
    missing = [index for index, path in paths.items() if not path.exists()]
    wrong: dict[int, str] = {}
    with tqdm(desc="Writing videos", total=sum(episodes[i].steps for i in missing), unit="step") as bar:
        for index in missing:
            episode = episodes[index]
            every = VIDEO_EVERY if episode.steps > LONG else 1
            with closing(replay(source, world, episode.seed, every)) as moments:
                try:
                    write_run(paths[index], counted(as_before(moments, episode), bar), names)
                except RepeatError as error:
                    wrong[index] = f"no video: {error}"
    return [str(path) for index, path in paths.items() if index not in wrong], list(wrong.values())


def counted(moments: Iterable[Moment], bar: tqdm) -> Iterator[Moment]:
    """The moments as they come, each moving the bar on."""
    for moment in moments:
        yield moment
        bar.update()


if __name__ == "__main__":
    cli.run(main, EvalOptions)
