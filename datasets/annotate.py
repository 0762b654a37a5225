"""Segment demonstrations with a saved policy, and look at the result.

    python datasets/annotate.py --policy.path=outputs/train/.../checkpoints/last/pretrained_model \
        --dataset.root=datasets/two_flags

Every frame gets a macro-action. The segmentation is the one under which the policy's classifiers explain the
actions best, with the whole demonstration known. Where the dataset has a column of true labels, the agreement
with it is printed. The page `segmentation.html` shows the result, `segmentation.json` holds its numbers, and
`figures/` and TensorBoard events hold its pictures.
"""

from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path

from tqdm import tqdm

from dpmacro.annotation.annotate import annotate
from dpmacro.annotation.pictures import picture_count, pictures
from dpmacro.annotation.report import NUMBERS, PAGE, SHOWN, score_text, write_report
from dpmacro.annotation.summary import Summary
from dpmacro.data.demonstrations import Demonstrations
from dpmacro.policy.policy import MacroPolicy
from dpmacro.utils import cli


@dataclass(frozen=True)
class PolicyOptions:
    """What segments the demonstrations."""

    path: Path | None = None
    """Folder `pretrained_model` of a training run."""


@dataclass(frozen=True)
class DatasetOptions:
    """Which demonstrations; their images are shrunk as the policy's were."""

    root: Path | None = None
    """Folder of a LeRobot dataset."""
    episodes: list[int] | None = None
    """Episodes to segment; all by default."""
    action: list[str] | None = None
    """Feature that holds the action, or several with a number each, as in training."""
    truth: str | None = None
    """Integer column with the true macro-labels to compare with; "none" or by default the recorded one."""


@dataclass(frozen=True)
class AnnotateOptions:
    """Options of datasets/annotate.py."""

    policy: PolicyOptions = field(default_factory=PolicyOptions)
    dataset: DatasetOptions = field(default_factory=DatasetOptions)
    tolerance: int = 10
    """Frames by which a found change point may miss a true one and still count."""
    seed: int = 0
    """Seed of the random cuts, whose scores stand beside the policy's."""
    output_dir: Path | None = None
    """Folder for the results; by default outputs/annotate/<date>/<time>_<dataset>."""

    def __post_init__(self) -> None:
        if self.policy.path is None:
            raise ValueError("no policy: give --policy.path=<a run's pretrained_model>")
        if self.dataset.root is None:
            raise ValueError("no demonstrations: give --dataset.root=<folder of a LeRobot dataset>")
        for name in ("tolerance", "seed"):
            if getattr(self, name) < 0:
                raise ValueError(f"--{name}={getattr(self, name)}: it must be at least 0")


def main(options: AnnotateOptions) -> None:
    """Segment the demonstrations; print how that agrees with the truth, and write a report."""
    path, dataset = options.policy.path, options.dataset
    assert path is not None and dataset.root is not None, "the options checked it"
    output_dir = options.output_dir or default_output_dir(dataset.root)
    if (output_dir / NUMBERS).exists():
        raise ValueError(f"{output_dir} already holds a {NUMBERS}: give another --output_dir")
    policy = MacroPolicy.load(path)
    demonstrations = Demonstrations.load(
        dataset.root,
        dataset.episodes,
        inputs=[key for key, one in policy.config.inputs.items() if one.shape],
        action=dataset.action,
        truth=dataset.truth,
        transform=policy.config.image_transform,
    )
    summary = Summary(
        policy,
        demonstrations,
        annotate(policy, demonstrations),
        tuple(dataset.episodes or range(len(demonstrations.lengths))),
        {"dataset": str(dataset.root), "policy": str(path)},
        options.tolerance,
        options.seed,
    )
    with tqdm(pictures(summary, SHOWN), "Pictures", picture_count(summary, SHOWN), unit="picture") as made:
        write_report(summary, iter(made), output_dir)
    if summary.scores:
        print(score_text(summary))
    print(f"page        {output_dir / PAGE}")
    print(f"pictures    {output_dir / 'figures'}")


def default_output_dir(root: Path) -> Path:
    """A new folder by date, time and the dataset's name."""
    return Path("outputs/annotate") / f"{datetime.now():%Y-%m-%d/%H-%M-%S}_{root.resolve().name}"


if __name__ == "__main__":
    cli.run(main, AnnotateOptions)
