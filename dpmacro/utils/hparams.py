"""TensorBoard's HParams dashboard: a row for every training and evaluation, its options beside its scores.

The dashboard sorts options by their names, capitals first, and shows the first five unless more are ticked.
So those that trainings differ in most stand there once more, with a capital, "default" where none was given.
"""

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from torch.utils.tensorboard import SummaryWriter

from dpmacro.utils.files import replacing

__all__ = ["flat", "read_scores", "write_row", "write_scores"]

FIRST = {
    "Inputs": "dataset.inputs",
    "Q": "planner.macros",
    "S": "planner.max_transitions",
    "Seed": "seed",
    "World": "world.id",
}
SCORES = "training_state/scores.json"  # beside a checkpoint's pretrained_model


def flat(options: Mapping[str, Any]) -> dict[str, bool | int | float | str]:
    """Nested options by names with dots in between; lists as text, and None as an empty one."""
    return dict(_flat(options, ""))


def write_row(folder: Path, options: Mapping[str, Any], scores: Mapping[str, float]) -> None:
    """Write the row of a run whose TensorBoard events are in `folder`; every score is a scalar there, too.

    Args:
        folder: of the run's events.
        options: those of train.py, as far as they are known, and `world`, the world that was run in or
            recorded.
        scores: by name.
    """
    row = flat(options)
    first = {title: str(row[name]) or "default" for title, name in FIRST.items() if name in row}
    tags = {f"score/{name}": score for name, score in scores.items()}
    with SummaryWriter(str(folder)) as writer:
        writer.add_hparams(first | row, tags, run_name=".")


def write_scores(checkpoint: Path, scores: Mapping[str, float]) -> None:
    """Keep a training's scores in its checkpoint, for the rows of evaluations."""
    with replacing(checkpoint / SCORES) as path:
        path.write_text(json.dumps(dict(scores), indent=2) + "\n")


def read_scores(pretrained: Path) -> dict[str, float]:
    """The scores of the training that left a pretrained_model; {} where they are not there any more."""
    path = pretrained.resolve().parent / SCORES
    if not path.exists():
        return {}
    found = json.loads(path.read_text())
    return {str(name): float(value) for name, value in found.items()}


def _flat(value: Any, name: str) -> Iterator[tuple[str, bool | int | float | str]]:
    if isinstance(value, Mapping):
        for part, inner in value.items():
            yield from _flat(inner, f"{name}.{part}" if name else str(part))
    elif isinstance(value, bool | int | float | str):
        yield name, value
    else:
        yield name, "" if value is None else json.dumps(value, default=str)
