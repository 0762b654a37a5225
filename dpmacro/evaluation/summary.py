"""What a number of runs amounts to: text for people, LeRobot's `eval_info.json`, TensorBoard scalars."""

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from torch.utils.tensorboard import SummaryWriter

from dpmacro.metrics.success import SuccessSummary
from dpmacro.worlds.base import NO_MACRO, NO_PHASE, Episode

__all__ = ["clipped_share", "eval_info", "run_notes", "run_text", "write_scalars"]


def run_text(summary: SuccessSummary, seconds: float, causes: Sequence[str], loops: int) -> str:
    """The result for people; `loops` is the number of runs that were seen to repeat themselves."""
    low, high = summary.interval
    lines = [
        f"successes   {summary.successes} of {summary.runs} runs",
        f"rate        {summary.rate:.1%}, 95% Wilson interval {low:.1%} to {high:.1%}",
        f"time        {seconds:.1f} s, {seconds / summary.runs:.2f} s a run",
        f"failures    {summary.runs - summary.successes}",
    ]
    for (outcome, phase, macro), count in summary.endings.items():
        doing = "" if macro == NO_MACRO else f", macro-action {macro}"
        where = "" if phase == NO_PHASE else f" in phase {phase}"
        lines.append(f"{count:>7}     {outcome.replace('_', ' '):<20}{where}{doing}".rstrip())
    if summary.endings:
        lines.append("causes")
    for cause, count in Counter(filter(None, causes)).most_common():
        lines.append(f"{count:>7}     {cause.replace('_', ' ')}")
    if loops:
        lines.append(f"loops       {loops} of the failures repeat themselves for ever")
    return "\n".join(lines)


def run_notes(episodes: Sequence[Episode]) -> list[str]:
    """What told success in these runs, and, where any was, the share of steps whose action was clipped."""
    signs = list(dict.fromkeys(episode.success_by for episode in episodes if episode.success_by))
    lines = [f"told by     {' and '.join(signs)}"] if signs else []
    if any(episode.actions.ndim == 2 for episode in episodes):
        share = clipped_share(episodes)
        lines.append(f"clipped     {share:.1%} of steps had an action beyond what the world takes")
    return lines


def clipped_share(episodes: Sequence[Episode]) -> float:
    """The share of all steps whose action was clipped into what the world takes, 0..1."""
    return sum(episode.clipped for episode in episodes) / sum(episode.steps for episode in episodes)


def eval_info(
    world: str,
    episodes: Sequence[Episode],
    summary: SuccessSummary,
    causes: Sequence[str],
    events: Mapping[str, Sequence[Any]],
    seconds: float,
    videos: Sequence[str],
) -> dict[str, Any]:
    """Results in the form of LeRobot's eval_info.json, with a section `dpmacro`.

    Args:
        world: the task's name.
        episodes: at least one.
        summary: of their outcomes.
        causes: why each failed; "" for a success.
        events: what else the world tells of runs, a value or None for each; written into the section.
        seconds: that all runs took.
        videos: paths.
    """
    sums = [episode.reward for episode in episodes]
    largest = [float(episode.rewards.max()) for episode in episodes]
    group = {
        "avg_sum_reward": sum(sums) / len(sums),
        "avg_max_reward": sum(largest) / len(largest),
        "pc_success": 100 * summary.rate,
        "n_episodes": len(episodes),
        "video_paths": list(videos),
    }
    metrics = {
        "sum_rewards": sums,
        "max_rewards": largest,
        "successes": [episode.success for episode in episodes],
        "video_paths": list(videos),
    }
    return {
        "per_task": [{"task_group": world, "task_id": 0, "metrics": metrics}],
        "per_group": {world: group},
        "overall": {**group, "eval_s": seconds, "eval_ep_s": seconds / len(episodes)},
        "dpmacro": {
            "seeds": [episode.seed for episode in episodes],
            "outcomes": [episode.outcome for episode in episodes],
            "steps": [episode.steps for episode in episodes],
            "loops": [episode.loop for episode in episodes],
            "periods": [episode.period for episode in episodes],
            "first_successes": [episode.first_success for episode in episodes],
            "success_by": list(dict.fromkeys(episode.success_by for episode in episodes)),
            "clipped_steps": [episode.clipped for episode in episodes],
            "clipped_share": clipped_share(episodes),
            "causes": list(causes),
            **{name: list(values) for name, values in events.items()},
            "first_changes": [episode.first_change for episode in episodes],
            "last_macros": [int(episode.macros[-1]) for episode in episodes],
            "interval_95": list(summary.interval),
            "failures": [
                {"outcome": outcome, "phase": phase, "macro": macro, "runs": runs}
                for (outcome, phase, macro), runs in summary.endings.items()
            ],
        },
    }


def write_scalars(overall: Mapping[str, Any], folder: Path) -> None:
    """The overall numbers as TensorBoard scalars, eval/pc_success and the like."""
    with SummaryWriter(str(folder)) as writer:
        for name, value in overall.items():
            if name != "video_paths":
                writer.add_scalar(f"eval/{name}", value, 0)
