"""Cut demonstrations into stages, look at them, correct them, and write them where other tools read them.

    python datasets/annotate.py --dataset.root=<LeRobot dataset> --output=<new dataset>
    python datasets/annotate.py --dataset.root=... --policy.path=<a run's pretrained_model> --output=...
    python datasets/annotate.py --dataset.root=... --output=... --corrections=<file saved from the page>

Without a policy the stages are found first, as train.py finds them, and their number is chosen by the data.
Every frame gets the stage under which the classifiers explain the actions best, with the whole demonstration
known. The new dataset has all that the old one has, and the stages in the formats that the installed LeRobot
reads; it has its name once the page is there. A run that was stopped is gone on with by the same command and
the same --output_dir: stages that were found are not searched again, and a part of a search is made anew.
The page `segmentation.html` shows every demonstration, and people correct it there, in as many rounds as they
like; `segmentation.json` holds numbers, `figures/` and TensorBoard events pictures, `rerun/` recordings for
Rerun where --rerun=true asks for them. Where the dataset has a column of true labels, the agreement with it
is printed.
"""

if __name__ in ("__main__", "__mp_main__"):
    import dpmacro.utils.starting  # noqa: F401  Ctrl-C during the imports below is one line

import shutil
from contextlib import nullcontext
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path

from tqdm import tqdm

from dpmacro.annotation.annotate import Annotation, annotate
from dpmacro.annotation.corrections import Corrections
from dpmacro.annotation.exports.dataset import writing_labels
from dpmacro.annotation.exports.folders import refuse_places, refuse_unwritable, refuse_within
from dpmacro.annotation.exports.labelling import check_episodes, open_for_labels
from dpmacro.annotation.found import found_text
from dpmacro.annotation.idle import idle_frames, moving_columns
from dpmacro.annotation.kept_search import Kept, KeptSearch
from dpmacro.annotation.naming import stage_names
from dpmacro.annotation.pictures import picture_count, pictures
from dpmacro.annotation.recordings import require_rerun, write_recordings
from dpmacro.annotation.report import NUMBERS, PAGE, SHOWN, score_text, stages_of, write_report
from dpmacro.annotation.summary import Summary
from dpmacro.data.demonstrations import Demonstrations
from dpmacro.policy.policy import MacroPolicy
from dpmacro.training.annotate_options import AnnotateOptions
from dpmacro.training.data import read_demonstrations
from dpmacro.training.labels import labelled
from dpmacro.training.options import TrainOptions
from dpmacro.training.resuming import kept_stages
from dpmacro.training.run_folder import RunFolder, plain_options
from dpmacro.training.trainer import Trainer
from dpmacro.utils import cli
from dpmacro.utils.claims import claimed
from dpmacro.utils.files import telling_what_is_safe

RECORDINGS = "rerun"  # a folder beside the page
UNFINISHED = ".unfinished"  # a file beside the page, while that, or the new dataset, is not complete


@dataclass(frozen=True)
class Segmented:
    """Demonstrations, a policy with what it says of them, and how that came about."""

    demonstrations: Demonstrations
    policy: MacroPolicy
    annotation: Annotation
    where: Path  # the policy's folder
    notes: tuple[str, ...] = ()  # of the data and the search, for people


def main(options: AnnotateOptions) -> None:
    """Segment the demonstrations, report, and write the new dataset."""
    root = options.dataset.root
    assert root is not None, "the options checked it"
    output_dir = options.output_dir or default_output_dir(root)
    if (output_dir / NUMBERS).exists() and is_complete(output_dir, options.output):
        raise ValueError(f"{output_dir} already holds a {NUMBERS}: give another --output_dir")
    if options.rerun:
        require_rerun()
    refuse_within(output_dir, root, options.output)
    refuse_unwritable("--output_dir", output_dir)
    cli.hold(claimed(output_dir))
    cli.hold(telling_what_is_safe(output_dir, lambda: kept(output_dir)))
    if options.output is not None:
        refuse_places(root, options.output)
        refuse_unwritable("--output", options.output)
        open_for_labels(root)
    corrections = None if options.corrections is None else Corrections.load(options.corrections)
    search = options.policy.path is None
    segmented = trained(options, output_dir, corrections) if search else by_policy(options)
    demonstrations = segmented.demonstrations
    summary = Summary(
        segmented.policy,
        demonstrations,
        segmented.annotation,
        demonstrations.numbers,
        {"dataset": str(root), "policy": str(segmented.where)},
        options.tolerance,
        options.seed,
    )
    named = stage_names(demonstrations, summary.labels, segmented.policy.config.macros, options.names)
    idle = idle_frames(moving_columns(demonstrations), demonstrations.lengths, demonstrations.fps)
    found = replace(stages_of(summary), names=tuple(one.name for one in named), idle=idle)
    reasons = tuple(one.reason for one in named)
    stages = found if corrections is None else corrections.apply(found)
    earlier = None if corrections is None else corrections.of_stages(found)
    # A new dataset is written first, so that what is wrong is said at once, and named once the page is there.
    labels = (
        nullcontext()
        if options.output is None
        else writing_labels(root, options.output, stages, options.formats, skip=options.skip)
    )
    made, count = pictures(summary, SHOWN), picture_count(summary, SHOWN)
    with labels as written, tqdm(made, "Pictures", count, unit="picture") as bar:
        begin_page(output_dir)
        if options.rerun:
            write_recordings(output_dir / RECORDINGS, demonstrations, stages, options.page.frames)
        write_report(
            summary, iter(bar), output_dir, found, options.page.frames, reasons=reasons, corrections=earlier
        )
    (output_dir / UNFINISHED).unlink()
    for place, note in enumerate(segmented.notes):
        print(f"{'' if place else 'data':<11} {note}")
    print("\n".join(found_text(stages, named)))
    if summary.scores:
        print(score_text(summary))
    if written is not None:
        for note in written.notes:
            print(f"{'note':<11} {note}")
        print(f"{'dataset':<11} {written.root}, with {', '.join(('macro_action', *written.formats))}")
    print(f"page        {output_dir / PAGE}")
    print(f"pictures    {output_dir / 'figures'}")
    if options.rerun:
        print(f"recordings  {output_dir / RECORDINGS} (rerun {output_dir / RECORDINGS}/*.rrd)")


def is_complete(output_dir: Path, output: Path | None) -> bool:
    """Whether nothing is left to do for the page in a folder and the new dataset: that has its name last."""
    return not (output_dir / UNFINISHED).exists() or (
        output is not None and (output / "meta/info.json").exists()
    )


def begin_page(output_dir: Path) -> None:
    """Mark the folder as unfinished; where it was so, recordings go, which are made anew."""
    mark = output_dir / UNFINISHED
    if mark.exists():
        shutil.rmtree(output_dir / RECORDINGS, ignore_errors=True)
    output_dir.mkdir(parents=True, exist_ok=True)
    mark.touch()


def by_policy(options: AnnotateOptions) -> Segmented:
    """What a saved policy says of the demonstrations, read as its own were."""
    path, dataset = options.policy.path, options.dataset
    assert path is not None and dataset.root is not None, "the options checked it"
    policy = MacroPolicy.load(path)
    demonstrations = Demonstrations.load(
        dataset.root,
        dataset.episodes,
        inputs=[key for key, one in policy.config.inputs.items() if one.shape],
        action=dataset.action,
        truth=dataset.truth,
        transform=policy.config.image_transform,
        task=dataset.task,
    )
    check_output(options, demonstrations)
    return Segmented(demonstrations, policy, annotate(policy, demonstrations), path)


def check_output(options: AnnotateOptions, demonstrations: Demonstrations) -> None:
    """Raise ValueError where the dataset has episodes that were left out: a new one has labels in all."""
    if options.output is not None and options.dataset.root is not None:
        check_episodes(open_for_labels(options.dataset.root), demonstrations.numbers)


def trained(options: AnnotateOptions, output_dir: Path, corrections: Corrections | None) -> Segmented:
    """Find the stages as train.py does; the confidence is that of classifiers that never saw a frame."""
    dataset = options.dataset
    assert dataset.root is not None, "the options checked it"
    search = KeptSearch(output_dir, plain_options(asked(options)), dataset.root, dataset.labels)
    demonstrations = read_demonstrations(dataset, options.planner.memory_limit)
    check_output(options, demonstrations)
    if corrections is not None:  # before a search, which takes longer
        corrections.check(demonstrations.numbers, demonstrations.lengths, demonstrations.fps)
    lengths = demonstrations.lengths
    kept = search.found(int(lengths.sum()), len(lengths))
    if kept is not None:
        print(f"goes on     with the stages that were found in {search.training}")
    else:
        if search.begun:
            print(f"goes on     with the search in {search.training}, which was stopped")
        kept = searched(options, demonstrations, search)
    print(f"policy      {search.pretrained}")  # at once: --policy.path takes it, should writing fail
    policy = MacroPolicy.load(search.pretrained)
    return Segmented(demonstrations, policy, kept.annotation, search.pretrained, kept.notes)


def asked(options: AnnotateOptions) -> TrainOptions:
    """The options of the training that is to find the stages."""
    dataset, planner = options.dataset, options.planner
    if dataset.labels is not None and planner.macros == "auto":
        planner = replace(planner, macros=None)  # as many as the labels have names
    return TrainOptions(dataset=dataset, planner=planner, seed=options.seed, device=options.device)


def searched(options: AnnotateOptions, demonstrations: Demonstrations, search: KeptSearch) -> Kept:
    """What a search finds, which is kept."""
    training, given = labelled(asked(options), demonstrations)
    search.begin()
    folder = RunFolder.inner(search.training)
    with kept_stages(folder, training, demonstrations, given):
        result = Trainer(demonstrations, training, folder, given).train()
    found = annotate(result.policy, demonstrations)
    if bool((found.labels == result.found.labels).all()):
        found = replace(found, confidence=result.found.confidence)
    notes = result.notes
    if result.choice is not None:
        macros, bound = result.choice.setting
        notes += (f"{macros} stages with at most {bound} changes, chosen by data that was left out",)
        if result.policy.config.macros < macros:
            notes += (f"{result.policy.config.macros} of them hold frames, the others are left out",)
    kept = Kept(found, notes)
    search.keep(kept)
    folder.end()
    return kept


def kept(output_dir: Path) -> str:
    """What is safe where the disk is full, in words."""
    folder = RunFolder(output_dir / "training", resume=True)
    if (folder.last / "model.safetensors").exists():
        return f"the policy is safe in {folder.last}, --policy.path takes it"
    if folder.begun.exists():
        return f"what was found so far is safe, the same command with --output_dir={output_dir} goes on"
    return "the dataset is as it was"


def default_output_dir(root: Path) -> Path:
    """A new folder by date, time and the dataset's name."""
    return Path("outputs/annotate") / f"{datetime.now():%Y-%m-%d/%H-%M-%S}_{root.resolve().name}"


if __name__ == "__main__":
    cli.run(main, AnnotateOptions)
