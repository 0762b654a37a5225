"""Which criterion, from the demonstrations alone, finds the true segmentation among candidates.

python benchmarks/bench_selectors.py --sources='[digits]' --seeds='[0, 1]'

DPBoost finds and scores candidates, told Q and the largest true number of changes. Every criterion picks one
of them; the truth, which no criterion sees, says what that one is worth beside the best there was. A second
table compares the final segmentation with switch functions in the dynamic program (`switch_weight` 1) and
without (0). Rows are written after every fit; what is there already, of the same data, is not found anew
without --fresh=true.
"""

import json
import shlex
import signal
import sys
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import torch
from report import header
from segmentation_sources import QUICK_RULES, RULES, TOLERANCES, Source, check_recorded, sources
from selector_scores import choices, fit_table, picture, rule_ranks, table
from torch import Tensor
from tqdm import tqdm

from dpmacro.boosting.losses.classes import exponentials_of
from dpmacro.data.synthetic import digits
from dpmacro.discovery.candidates import Candidate, left_out_charges
from dpmacro.discovery.result import Discovery
from dpmacro.estimator.dpboost import DPBoost
from dpmacro.features.columns import prepare
from dpmacro.features.kinds import make_features
from dpmacro.features.levels import SortedLevels
from dpmacro.features.memory import Plan
from dpmacro.features.quantising import Quantiser
from dpmacro.figures import save
from dpmacro.metrics import segmentation_scores
from dpmacro.segmentation.recursion import segment
from dpmacro.training.options import PlannerOptions
from dpmacro.utils import cli
from dpmacro.utils.files import replacing

NOTES = """\
Truth: accuracy of frames, boundary F1 at the tolerance given. Regret: by how much the best candidate is
better than the one chosen; of candidates that a criterion ties, the mean. rho: Spearman's rank correlation
of criterion and accuracy over the candidates of a case, mean over the cases that have one. n: cases and
seeds. With one trajectory nothing is left out for switch functions: the changes that they recognise are of
training data, and the causal criteria have no say."""
SPLIT = 6  # trajectories that the digits are cut into, beside the whole
WEIGHTS = (1.0, 0.0)  # of the switch functions; the candidates of the first are scored
TRUTH = ("accuracy", "precision", "recall", "boundary_f1")
KEY = ("group", "source", "case", "data", "seed")

Row = dict[str, Any]


@dataclass(frozen=True)
class SelectorOptions:
    """What to segment."""

    sources: list[str] = field(default_factory=lambda: list(TOLERANCES))
    """Data to segment, out of digits, two_flags and babyai."""
    seeds: list[int] = field(default_factory=lambda: list(range(5)))
    """Seeds of DPBoost, of the features, and of the digits."""
    rounds: int = 60
    """Boosting rounds of the final fits; more change the segmentation little."""
    quick: bool = False
    """Little data and few restarts; shows that everything runs, not how well; rows go to *_quick.json."""
    fresh: bool = False
    """Whether to find anew what there are rows of."""
    two_flags: Path = Path("datasets/two_flags_random")
    """Recorded demonstrations of TwoFlags."""
    babyai: Path = Path("datasets/babyai")
    """Folder of recorded BabyAI levels."""
    truth: str = "purpose"
    """Column of theirs that is the truth, purpose or subgoal."""
    output: Path = Path("outputs/bench_selectors.json")
    """Where the rows go; the picture beside them."""

    def __post_init__(self) -> None:
        for value in self.sources:
            if value not in TOLERANCES:
                raise ValueError(f"sources has {value!r}: choose from {', '.join(TOLERANCES)}")
        for seed in self.seeds:
            if seed < 0:
                raise ValueError(f"seeds has {seed}: give 0 or more")
        if self.rounds < 1:
            raise ValueError(f"rounds is {self.rounds}: give 1 or more")

    @property
    def rows(self) -> Path:
        """The file of rows; a quick run has one of its own."""
        return self.output.with_stem(self.output.stem + "_quick") if self.quick else self.output


def main(options: SelectorOptions) -> None:
    """Fit and score, writing the rows as they come; print the tables, also of an interrupted run."""
    check_recorded(options.sources, options.two_flags, options.babyai)
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    print("\n".join(header(shlex.join(["python", *sys.orig_argv[1:]]))), flush=True)
    candidates, fits = _read(options.rows)
    try:
        with tqdm(unit="fit") as bar:
            for group, seed, source in _cases(options):
                bar.total = (bar.total or 0) + len(WEIGHTS)
                key = dict(zip(KEY, (group, source.name, source.case, source.digest, seed), strict=True))
                case = {name: key[name] for name in KEY if name != "data"}
                data = None
                for weight in WEIGHTS:
                    bar.set_postfix_str(f"{group} {source.case}, seed {seed}, switch weight {weight:g}")
                    setting = {"switch_weight": weight, "rounds": options.rounds}
                    if options.fresh or not any(_of(row, key | setting) for row in fits):
                        data = _sorted_levels(source, seed) if data is None else data
                        found, discovery = _fitted(source, data, seed, weight, options)
                        fits = [row for row in fits if not _of(row, case | {"switch_weight": weight})]
                        fits.append(key | setting | found)
                        if weight == WEIGHTS[0]:
                            candidates = [row for row in candidates if not _of(row, case)]
                            candidates += [key | row for row in candidate_rows(discovery, source)]
                        _write(candidates, fits, options.rows)
                    bar.update()
    finally:
        chosen = choices(candidates)
        print("\n".join([*table(chosen), "", *fit_table(fits)]))
        print(NOTES)
        print(f"rows     {options.rows}")
        if chosen:
            save(picture(chosen), options.rows.with_suffix(".png"))
            print(f"picture  {options.rows.with_suffix('.png')}")


def candidate_rows(discovery: Discovery, source: Source) -> list[Row]:
    """A row for every candidate: its truth, and every criterion, None where it has no say."""
    rows = []
    ranks = rule_ranks(discovery.scores)
    for place, (candidate, rank) in enumerate(zip(discovery.candidates, ranks, strict=True)):
        found = criteria(candidate, discovery) | {"rule": rank}
        finite = {name: value if abs(value) < torch.inf else None for name, value in found.items()}
        rows.append({"candidate": place, **_truth(candidate.labels, source), **finite})
    return rows


def criteria(candidate: Candidate, discovery: Discovery) -> dict[str, float]:
    """What can be said of a candidate without the truth; nan or infinite where a criterion has no say.

    Losses are means over frames. `refitted_loss` is that of labels found anew on left-out frames, the
    cheapest segmentation; `unstable` is the share of frames that it labels otherwise.
    """
    task, labels = discovery.task, candidate.labels
    targets = task.loss.targets(task.actions)
    exponential = exponentials_of(candidate.left_out, targets).sum(2)
    again = segment(left_out_charges(candidate, task), task.lengths, discovery.max_transitions)
    same = (discovery.alternated.labels == labels).all(1)
    training = min(discovery.alternated.loss[-1][same].tolist(), default=float("nan"))
    scores = candidate.scores.scalars()
    if task.n_groups < 2:
        scores["causal_error"] = float("nan")
    return scores | {
        "training_loss": training,
        "exponential_loss": float(exponential[torch.arange(len(labels)), labels].mean()),
        "refitted_loss": float(again.cost.sum()) / len(labels),
        "unstable": float((again.labels != labels).float().mean()),
    }


def _cases(options: SelectorOptions) -> Iterator[tuple[str, int, Source]]:
    """Every source with every seed, in the group whose cases are averaged; the digits also in parts."""
    for name in options.sources:
        found = options.two_flags, options.babyai, options.truth, options.quick
        for seed, source in sources([name], options.seeds, *found):
            yield "digits, whole" if name == "digits" else name, seed, source
        if name == "digits":
            for rules in QUICK_RULES if options.quick else RULES:
                for seed in options.seeds:
                    made = digits(rules, seed, trajectories=SPLIT)
                    frames = made.features.astype("float32")
                    source = Source(name, f"Q={rules}", frames, made.actions, made.lengths, made.truth)
                    yield f"digits, {SPLIT} parts", seed, source


def _sorted_levels(source: Source, seed: int) -> SortedLevels:
    """Numbers as they are; images as the default's rectangles, drawn by the seed."""
    if source.frames.ndim == 2:
        values = torch.from_numpy(source.frames).T.contiguous()
        return SortedLevels.build(Quantiser.fit(values).levels(values))
    generator, planner = torch.Generator().manual_seed(seed), PlannerOptions()
    height, width = source.frames.shape[1:3]
    features = make_features(planner.features, height, width, planner.rectangles, generator)
    plan = Plan(features.count, features.count, 0, planner.memory_limit)
    images, lengths = torch.from_numpy(source.frames), torch.from_numpy(source.lengths)
    return prepare({"observation.image": images}, lengths, features, plan, generator)[2]


def _fitted(
    source: Source, data: SortedLevels, seed: int, weight: float, options: SelectorOptions
) -> tuple[Row, Discovery]:
    small: dict[str, Any] = {"restarts": 4, "switch_rounds": 20} if options.quick else {}
    dpboost = DPBoost(
        macros=source.macros,
        max_transitions=max(source.changes),
        rounds=min(options.rounds, 10) if options.quick else options.rounds,
        seed=seed,
        switch_weight=weight,
        **small,
    )
    result = dpboost.fit_levels(data, source.actions, source.lengths)
    assert result.discovery is not None, "truth without a change"
    return _truth(result.labels, source), result.discovery


def _truth(labels: Tensor, source: Source) -> Row:
    scores = asdict(segmentation_scores(labels.numpy(), source.truth, source.lengths, source.tolerance))
    return {name: scores[name] for name in TRUTH}


def _of(row: Row, key: Row) -> bool:
    return all(row[name] == value for name, value in key.items())


def _read(path: Path) -> tuple[list[Row], list[Row]]:
    """Candidates and fits in the file, if it is there. Raises ValueError where it is another's."""
    if not path.exists():
        return [], []
    try:
        stored = json.loads(path.read_text())
        candidates, fits = stored["candidates"], stored["fits"]
        assert all(name in row for row in candidates + fits for name in KEY)
    except (ValueError, KeyError, TypeError, AssertionError) as error:
        raise ValueError(f"{path} holds no rows of this benchmark: give another --output") from error
    return candidates, fits


def _write(candidates: list[Row], fits: list[Row], path: Path) -> None:
    """Three lists, a row a line: what was scored, what every criterion would choose of it, and the fits."""
    parts = {"candidates": candidates, "choices": choices(candidates), "fits": fits}
    lists = [
        f'"{name}": [\n' + ",\n".join(json.dumps(row) for row in rows) + "\n]" for name, rows in parts.items()
    ]
    with replacing(path) as temporary:
        temporary.write_text("{" + ",\n".join(lists) + "}\n")


if __name__ == "__main__":
    cli.run(main, SelectorOptions)
