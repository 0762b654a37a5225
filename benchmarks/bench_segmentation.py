"""Segmentations of demonstrations whose truth is known, ours beside those of other methods, as one table.

python benchmarks/bench_segmentation.py --sources='[digits]' --methods='[dpmacro, GaussianHMM]' --seeds='[0]'

Sources with vectors as actions need a folder: --metaworld=, --mocap=, --cr5=. The rows (source, case, seed,
method, metric, value) are written after every segmentation; what is there already, of the same data, is not
found anew without --fresh=true. A method that is not installed, or has no answer for a source, is skipped.
"""

import json
import math
import shlex
import signal
import sys
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch
from report import header
from segmentation_peers import PEERS, Found
from segmentation_ranks import distances, ranks
from segmentation_sources import (
    TOLERANCES,
    VECTOR_TOLERANCES,
    NotApplicableError,
    Source,
    check_recorded,
    sources,
)
from segmentation_vectors import missing_folders, vector_sources
from tqdm import tqdm

from dpmacro.data.vectors import ActionTransform
from dpmacro.estimator.dpboost import DPBoost
from dpmacro.features.columns import prepare
from dpmacro.features.kinds import StateSpec, make_encoder, make_features
from dpmacro.features.memory import Plan
from dpmacro.metrics import segmentation_scores
from dpmacro.training.data import PAIRS
from dpmacro.training.options import PlannerOptions
from dpmacro.utils import cli
from dpmacro.utils.files import replacing

NOTES = """\
Means over n seeds, which on digits draw the data, too. Every method is told Q; dpmacro, as its bound, the
largest true number of changes; KernelCPD, TW-FINCH, AWE and slow that of every trajectory. Settings of the
peers are chosen by the truth (benchmarks/segmentation_peers.py says from what), those of dpmacro are the
defaults. Uniform and random cuts have the true labels in their true order. A boundary may be off by
`tolerance` frames. A mean rank is over the n cases that a method has an answer for, 1 the best of a case."""
COLUMNS = {  # metric: heading
    "accuracy": "accuracy",
    "boundary_f1": "boundary F1",
    "precision": "precision",
    "recall": "recall",
    "edit": "edit",
    "f1_10": "F1@10",
    "f1_25": "F1@25",
    "f1_50": "F1@50",
    "nmi": "NMI",
    "ari": "ARI",
    "segments": "segments",
}
STATE, WINDOW = "observation.state", 5  # frames of a state's longer change
COUNTS = ("segments", "true_segments")
ALL_TOLERANCES = TOLERANCES | VECTOR_TOLERANCES
KEY = ("source", "case", "data", "seed", "method")

Row = dict[str, Any]


def dpmacro(source: Source, seed: int, quick: bool) -> Found:
    """DPBoost as train.py runs it by default, told Q and how many changes a trajectory has: the median.

    Images become the default's rectangles; numbers beside classes are taken as they are. Where actions are
    vectors the numbers are a state, and become its columns, and actions are learned as train.py would.
    """
    macros, bound = source.macros, math.ceil(np.median(source.changes))
    small: dict[str, Any] = {"rounds": 10, "restarts": 4, "switch_rounds": 20} if quick else {}
    dpboost = DPBoost(macros=macros, max_transitions=bound, seed=seed, **small)
    lengths, generator = torch.from_numpy(source.lengths), torch.Generator().manual_seed(seed)
    if source.vectors:
        names = tuple(map(str, range(source.frames.shape[1])))
        varying = tuple(np.flatnonzero(np.ptp(source.frames, 0) > 0).tolist())
        spec = {STATE: StateSpec(names, varying)}
        encoder = make_encoder(spec, "rectangles", 1, WINDOW, PAIRS, generator)
        plan = Plan(encoder.count, encoder.count, 0, PlannerOptions().memory_limit)
        seen = {STATE: torch.from_numpy(source.frames)}
        data = prepare(seen, lengths, encoder, plan, generator)[2]
        transform = ActionTransform.fit(source.actions, source.lengths, source.frames)
        targets = transform.targets(source.actions, source.frames)
        labels = dpboost.fit_levels(data, targets, source.lengths).labels
    elif source.frames.ndim == 2:
        labels = dpboost.fit(source.frames, source.actions, source.lengths).labels_
    else:
        planner, (height, width) = PlannerOptions(), source.frames.shape[1:3]
        features = make_features(planner.features, height, width, planner.rectangles, generator)
        plan = Plan(features.count, features.count, 0, planner.memory_limit)
        seen = {"observation.image": torch.from_numpy(source.frames)}
        data = prepare(seen, lengths, features, plan, generator)[2]
        labels = dpboost.fit_levels(data, source.actions, source.lengths).labels
    return Found(labels.numpy(), f"Q={macros}, S={bound}")


METHODS: dict[str, Callable[[Source, int, bool], Found]] = {"dpmacro": dpmacro, **PEERS}


@dataclass(frozen=True)
class BenchOptions:
    """What to segment, and how."""

    sources: list[str] = field(default_factory=lambda: list(ALL_TOLERANCES))
    """Data to segment, out of digits, two_flags, babyai, metaworld, mocap6 and cr5."""
    methods: list[str] = field(default_factory=lambda: list(METHODS))
    """dpmacro, GaussianHMM, AR-HMM, regression HMM, KernelCPD, k-means, TW-FINCH, AWE, gripper, slow, gripper
    or slow, uniform cuts, random cuts."""
    seeds: list[int] = field(default_factory=lambda: list(range(3)))
    """Seeds of the methods, and of the digits."""
    quick: bool = False
    """Little data and few settings; shows that everything runs, not how well; rows go to *_quick.json."""
    fresh: bool = False
    """Whether to find anew what there are rows of."""
    two_flags: Path = Path("datasets/two_flags_random")
    """Recorded demonstrations of TwoFlags."""
    babyai: Path = Path("datasets/babyai")
    """Folder of recorded BabyAI levels."""
    truth: str = "subgoal"
    """Column of BabyAI's that is the truth, subgoal or purpose."""
    metaworld: Path = Path("datasets/metaworld")
    """Folder of recorded Meta-World tasks."""
    mocap: Path | None = None
    """Dataset mocap6, which others made; without it that source is left out."""
    cr5: Path | None = None
    """Dataset of the CR5 arm with a banana, which others made; without it that source is left out."""
    output: Path = Path("outputs/bench_segmentation.json")
    """Where the rows go."""

    def __post_init__(self) -> None:
        for name, choices in (("sources", list(ALL_TOLERANCES)), ("methods", list(METHODS))):
            for value in getattr(self, name):
                if value not in choices:
                    raise ValueError(f"{name} has {value!r}: choose from {', '.join(choices)}")
        for seed in self.seeds:
            if seed < 0:
                raise ValueError(f"seeds has {seed}: give 0 or more")

    @property
    def folders(self) -> dict[str, Path | None]:
        """Where the sources are whose actions are vectors."""
        return {"metaworld": self.metaworld, "mocap6": self.mocap, "cr5": self.cr5}

    @property
    def rows(self) -> Path:
        """The file of rows; a quick run has one of its own."""
        return self.output.with_stem(self.output.stem + "_quick") if self.quick else self.output


def main(options: BenchOptions) -> None:
    """Segment and score, writing the rows as they come; print the table, also of an interrupted run."""
    check_recorded(options.sources, options.two_flags, options.babyai)
    left_out = missing_folders(options.sources, options.folders)
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    print("\n".join(header(shlex.join(["python", *sys.orig_argv[1:]]))), flush=True)
    rows = _read(options.rows)
    wanted: list[tuple[Any, ...]] = []
    skipped: dict[str, str] = {}  # a line's beginning: its end
    try:
        with tqdm(unit="segmentation") as bar:
            for seed, source in _sources(options):
                bar.total = (bar.total or 0) + len(options.methods)
                for method in options.methods:
                    bar.set_postfix_str(f"{source.name} {source.case}, seed {seed}, {method}")
                    key: tuple[Any, ...] = source.name, source.case, source.digest, seed, method
                    wanted.append(key)
                    if options.fresh or key not in rows:
                        try:
                            rows[key] = _score(key, source, METHODS[method](source, seed, options.quick))
                            _write(rows, options.rows)
                        except ModuleNotFoundError as error:
                            remedy = "pip install -e '.[bench]' brings every peer"
                            skipped[method] = f"no module {error.name}; {remedy}"
                        except NotApplicableError as error:
                            skipped[f"{method} on {source.name}"] = str(error)
                    bar.update()
    finally:
        found = [row for key in wanted for row in rows.get(key, [])]
        print("\n".join([*table(found), *ranks(found, COLUMNS), *distances(found)]))
        print(NOTES)
        print("".join(f"skipped {what}: {why}\n" for what, why in skipped.items()), end="")
        print("".join(f"{line}\n" for line in left_out), end="")
        print(f"rows     {options.rows}")


def _sources(options: BenchOptions) -> Iterator[tuple[int, Source]]:
    """Every source with every seed, in the order of the options."""
    of_classes = options.two_flags, options.babyai, options.truth, options.quick
    for name in options.sources:
        if name in TOLERANCES:
            yield from sources([name], options.seeds, *of_classes)
        else:
            yield from vector_sources([name], options.seeds, options.folders, options.quick)


def table(rows: Iterable[Row]) -> list[str]:
    """For every case the means over seeds, a line a method, and what tolerance they are at."""
    values: dict[tuple[str, str], dict[str, dict[str, list[float]]]] = {}
    for row in rows:
        case = values.setdefault((row["source"], row["case"]), {})
        case.setdefault(row["method"], defaultdict(list))[row["metric"]].append(row["value"])
    lines = []
    for (source, name), methods in values.items():
        true = np.mean([one for found in methods.values() for one in found["true_segments"]])
        lines += ["", f"{source} {name}: {true:g} true segments, tolerance {ALL_TOLERANCES[source]}"]
        lines.append("  ".join([f"{'method':<15}", " n", *COLUMNS.values()]))
        for method, found in methods.items():
            cells = [
                f"{np.mean(found[metric]):{len(heading)}.{1 if metric in COUNTS else 3}f}"
                for metric, heading in COLUMNS.items()
            ]
            lines.append("  ".join([f"{method:<15}", f"{len(found['accuracy']):2}", *cells]))
    return lines


def _score(key: tuple[Any, ...], source: Source, found: Found) -> list[Row]:
    """A row for every metric."""
    scores = segmentation_scores(found.labels, source.truth, source.lengths, source.tolerance)
    shared = dict(zip(KEY, key, strict=True)) | {"setting": found.setting, "tolerance": source.tolerance}
    return [shared | {"metric": metric, "value": value} for metric, value in asdict(scores).items()]


def _read(path: Path) -> dict[tuple[Any, ...], list[Row]]:
    """The rows of every segmentation in the file, if it is there. Raises ValueError where it is another's."""
    rows: dict[tuple[Any, ...], list[Row]] = defaultdict(list)
    if path.exists():
        try:
            for row in json.loads(path.read_text()):
                rows[tuple(row[name] for name in KEY)].append(row)
        except (ValueError, KeyError, TypeError) as error:
            raise ValueError(f"{path} holds no rows of this benchmark: give another --output") from error
    return dict(rows)


def _write(rows: dict[tuple[Any, ...], list[Row]], path: Path) -> None:
    with replacing(path) as temporary:
        temporary.write_text(json.dumps([row for found in rows.values() for row in found], indent=1) + "\n")


if __name__ == "__main__":
    cli.run(main, BenchOptions)
