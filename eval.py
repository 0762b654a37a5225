"""Run a saved policy, or the teacher, in its world and count successes.

    python eval.py --policy.path=outputs/train/.../checkpoints/last/pretrained_model --workers=2
    python eval.py --policy.type=teacher --world.flags=fixed --videos=3

Prints successes, their rate with its 95% interval, how the failures split and why they failed, and writes the
same to `eval_info.json` in LeRobot's form, TensorBoard scalars beside it. A run that begins to repeat itself
ends there, as the failure that it is, and counts its steps until then; a policy with recovery goes on.
"""

import json
import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass, field, fields, make_dataclass
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tqdm import tqdm

from dpmacro.evaluation.rollouts import PlannerSource, iter_episodes, replay
from dpmacro.metrics.success import success_summary
from dpmacro.utils import cli
from dpmacro.utils.files import replacing
from dpmacro.worlds import diagnosis_of
from dpmacro.worlds.base import Episode, Moment
from dpmacro.worlds.two_flags.env import ACTIONS, TwoFlagsConfig

# Every worker process imports this file again: what only the parent needs is imported where it is used.

WORLD = "TwoFlags-v0"
VIDEO_EVERY = 4  # steps that a video shows as one frame

# The world's own options, each None unless given, so that those a policy was trained with stay.
if TYPE_CHECKING:
    WorldOptions = TwoFlagsConfig
else:
    WorldOptions = make_dataclass(
        "WorldOptions",
        [
            (
                option.name,
                option.type | None,
                field(default=None, metadata=cli.sentence_of(TwoFlagsConfig, option)),
            )
            for option in fields(TwoFlagsConfig)
        ],
        namespace={"__doc__": "Options of the world; those not given stay as the policy was trained with."},
        frozen=True,
    )


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
    """Runs to write as MP4 at four times their speed, failed ones first."""
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


def main(options: EvalOptions) -> None:
    """Run the planner in its world; print how it fared, and write it down."""
    from dpmacro.evaluation.summary import eval_info, run_text, write_scalars

    source, name, stored = planner(options.policy)
    given = {option: value for option, value in vars(options.world).items() if value is not None}
    try:
        world = {"id": WORLD, **asdict(TwoFlagsConfig(**{**stored, **given}))}
    except TypeError as error:  # values of another type in a policy's config.json
        raise ValueError(f"the world {stored} of {options.policy.path} cannot be ({error})") from error
    output_dir = options.output_dir or default_output_dir(options.job_name or name)
    if (output_dir / "eval_info.json").exists():
        raise ValueError(f"{output_dir} already holds an eval_info.json: give another --output_dir")
    output_dir.mkdir(parents=True, exist_ok=True)

    started = time.perf_counter()
    episodes = run(source, world, range(options.seed, options.seed + options.episodes), options.workers)
    seconds = time.perf_counter() - started
    summary = success_summary(
        [episode.outcome for episode in episodes],
        [int(episode.phases[-1]) for episode in episodes],
        [int(episode.macros[-1]) for episode in episodes],
    )
    diagnosis = diagnosis_of(WORLD)
    causes, events = diagnosis.causes(episodes), diagnosis.events(episodes)
    ran = {
        "planner": name,
        "policy_path": source.path and str(source.path),
        "recovery": bool(source.recovery),
    }

    def write_down(videos: Sequence[str]) -> dict[str, Any]:
        info = eval_info(WORLD, episodes, summary, causes, events, seconds, videos)
        info["dpmacro"] |= ran | {"world": world}
        with replacing(output_dir / "eval_info.json") as path:
            path.write_text(json.dumps(info, indent=2) + "\n")
        return info

    write_scalars(write_down([])["overall"], output_dir / "tensorboard")
    print(run_text(summary, seconds, causes, sum(episode.loop > 0 for episode in episodes)))
    if options.videos:  # which take their time, and may be interrupted
        write_down(
            write_videos(source, world, episodes, options.videos, output_dir / "videos" / f"{WORLD}_0")
        )
    print(f"written to  {output_dir}")


def planner(options: PolicyOptions) -> tuple[PlannerSource, str, dict[str, Any]]:
    """What runs, its name, and the options of the world it was trained in."""
    if options.path is None:
        return PlannerSource("teacher"), "teacher", {}
    from dpmacro.policy.policy import MacroPolicy

    policy = MacroPolicy.load(options.path)
    config = policy.config
    # JSON knows no tuples, which the world's options hold.
    stored = {
        name: tuple(value) if isinstance(value, list) else value for name, value in config.world.items()
    }
    world = stored.pop("id", None)
    if world != WORLD:
        raise ValueError(f"{options.path} is a policy for the world {world!r}: eval.py runs {WORLD!r} only")
    unknown = sorted(set(stored) - {option.name for option in fields(TwoFlagsConfig)})
    if unknown:
        raise ValueError(f"{options.path} was trained in a {WORLD} with {unknown[0]!r}, which this one lacks")
    recovery = config.recovery if options.recovery is None else options.recovery
    policy.planner(recovery)  # refuses recovery without demonstrators' actions, before a folder is made
    return PlannerSource("policy", options.path, recovery), config.type, stored


def default_output_dir(job_name: str) -> Path:
    """LeRobot's place for an evaluation."""
    return Path("outputs/eval") / f"{datetime.now():%Y-%m-%d/%H-%M-%S}_{job_name}"


def run(source: PlannerSource, world: dict[str, Any], seeds: Sequence[int], workers: int) -> list[Episode]:
    """The runs of all seeds, with a progress bar that shows the success rate so far."""
    episodes: list[Episode] = []
    with (
        closing(iter_episodes(source, world, seeds, workers)) as running,
        tqdm(running, "Evaluating", len(seeds), unit="run") as bar,
    ):
        for episode in bar:
            episodes.append(episode)
            bar.set_postfix_str(f"success {sum(done.success for done in episodes) / len(episodes):.0%}")
    return episodes


def write_videos(
    source: PlannerSource, world: dict[str, Any], episodes: Sequence[Episode], count: int, folder: Path
) -> list[str]:
    """Replay up to `count` runs, failed ones first, into MP4s; their paths."""
    from dpmacro.evaluation.videos import write_run

    chosen = sorted(range(len(episodes)), key=lambda index: episodes[index].success)[:count]
    paths = [folder / f"eval_episode_{index}.mp4" for index in chosen]
    steps = sum(episodes[index].steps for index in chosen)
    with tqdm(desc="Writing videos", total=steps, unit="step") as bar:
        for index, path in zip(chosen, paths, strict=True):
            with closing(replay(source, world, episodes[index].seed, VIDEO_EVERY)) as moments:
                write_run(path, counted(moments, bar), ACTIONS)
    return [str(path) for path in paths]


def counted(moments: Iterable[Moment], bar: tqdm) -> Iterator[Moment]:
    """The moments as they come, each moving the bar on."""
    for moment in moments:
        yield moment
        bar.update()


if __name__ == "__main__":
    cli.run(main, EvalOptions)
