"""Which criterion, from the demonstrations alone, tells the true segmentation from its rivals.

python benchmarks/bench_selectors.py --sources='[digits]' --seeds='[0, 1]'

DPBoost finds and judges rivals, told Q and the largest true number of changes. Every criterion picks one of
them; the truth, which no criterion sees, says what that one is worth beside the best there was. A second
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
from selector_scores import choices, fit_table, picture, table
from torch import Tensor
from tqdm import tqdm

from dpmacro.boosting.crossfit import bounded_deviance
from dpmacro.data.synthetic import digits
from dpmacro.discovery.candidates import MARGIN, Judged
from dpmacro.discovery.dpboost import DPBoost
from dpmacro.discovery.result import Search
from dpmacro.features.columns import prepare
from dpmacro.features.kinds import make_features
from dpmacro.features.levels import SortedLevels
from dpmacro.features.memory import Plan
from dpmacro.features.quantising import Quantiser
from dpmacro.figures import save
from dpmacro.metrics import segmentation_scores
from dpmacro.segmentation.marginals import costs_without
from dpmacro.segmentation.recursion import segment
from dpmacro.training.options import PlannerOptions
from dpmacro.utils import cli
from dpmacro.utils.files import replacing

NOTES = """\
Truth: accuracy of frames, boundary F1 at the tolerance given. Regret: by how much the best rival beats the
one chosen; of rivals that a criterion ties, the mean. rho: Spearman's rank correlation of criterion and
accuracy over the rivals of a case, mean over the cases that have one. n: cases and seeds. With one trajectory
nothing is left out for switch functions: their detection is that on training data, and nothing is causal."""
REACH = 5  # frames on either side of one that context may not see
SPLIT = 6  # trajectories that the digits are cut into, beside the whole
WEIGHTS = (1.0, 0.0)  # of the switch functions; the first one's rivals are judged
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
    """Fit and judge, writing the rows as they come; print the tables, also of an interrupted run."""
    check_recorded(options.sources, options.two_flags, options.babyai)
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    print("\n".join(header(shlex.join(["python", *sys.orig_argv[1:]]))), flush=True)
    rivals, fits = _read(options.rows)
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
                        found, search = _fitted(source, data, seed, weight, options)
                        fits = [row for row in fits if not _of(row, case | {"switch_weight": weight})]
                        fits.append(key | setting | found)
                        if weight == WEIGHTS[0]:
                            rivals = [row for row in rivals if not _of(row, case)]
                            rivals += [key | row for row in judged_rows(search, source)]
                        _write(rivals, fits, options.rows)
                    bar.update()
    finally:
        chosen = choices(rivals)
        print("\n".join([*table(chosen), "", *fit_table(fits)]))
        print(NOTES)
        print(f"rows     {options.rows}")
        if chosen:
            save(picture(chosen), options.rows.with_suffix(".png"))
            print(f"picture  {options.rows.with_suffix('.png')}")


def judged_rows(search: Search, source: Source) -> list[Row]:
    """A row for every rival: its truth, and every criterion, None where it has no say."""
    actions, lengths = torch.from_numpy(source.actions), torch.from_numpy(source.lengths)
    rows = []
    for place, rival in enumerate(search.judged):
        found = criteria(rival, search, actions, lengths)
        finite = {name: value if abs(value) < torch.inf else None for name, value in found.items()}
        rows.append({"rival": place, **_truth(rival.labels, source), **finite})
    return rows


def criteria(rival: Judged, search: Search, actions: Tensor, lengths: Tensor) -> dict[str, float]:
    """What can be said of a rival without the truth; nan or infinite where a criterion has no say.

    Losses are means over frames. `refitted_loss` and `context_loss` are those of labels found anew on
    left-out frames: the cheapest segmentation, and for every frame the best label by frames more than
    `REACH` away; `unstable` is the share of frames that the former changes.
    """
    frames, bound = torch.arange(len(actions)), search.max_transitions
    targets = torch.nn.functional.one_hot(actions, rival.scores.shape[2]).bool()[:, None]
    margins = torch.where(targets, rival.scores, -rival.scores)
    charges = bounded_deviance(rival.scores, targets, MARGIN)
    again = segment(charges, lengths, bound)
    context = costs_without(charges, lengths, bound, REACH).argmin(1)
    same = (search.candidates.labels == rival.labels).all(1)
    training = min(search.candidates.loss[-1][same].tolist(), default=float("nan"))
    verdict = asdict(rival.verdict)
    if len(lengths) < 2:
        verdict |= {name: float("nan") for name in ("causal_loss", "causal_error", "gain", "gain_error")}
    return verdict | {
        "training_loss": training,
        "exponential_loss": float((-margins).exp().sum(2)[frames, rival.labels].mean()),
        "refitted_loss": float(again.cost.sum()) / len(actions),
        "context_loss": float(charges[frames, context].mean()),
        "unstable": float((again.labels != rival.labels).float().mean()),
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
    return prepare(images, lengths, features, plan, generator)[2]


def _fitted(
    source: Source, data: SortedLevels, seed: int, weight: float, options: SelectorOptions
) -> tuple[Row, Search]:
    small: dict[str, Any] = {"restarts": 4, "discovery_rounds": 10} if options.quick else {}
    rounds = min(options.rounds, 10) if options.quick else options.rounds
    planner = DPBoost(source.macros, max(source.changes), rounds, seed=seed, switch_weight=weight, **small)
    result = planner.fit(data, source.actions, source.lengths)
    assert result.search is not None, "truth without a change"
    return _truth(result.labels, source), result.search


def _truth(labels: Tensor, source: Source) -> Row:
    scores = asdict(segmentation_scores(labels.numpy(), source.truth, source.lengths, source.tolerance))
    return {name: scores[name] for name in TRUTH}


def _of(row: Row, key: Row) -> bool:
    return all(row[name] == value for name, value in key.items())


def _read(path: Path) -> tuple[list[Row], list[Row]]:
    """Rivals and fits in the file, if it is there. Raises ValueError where it is another's."""
    if not path.exists():
        return [], []
    try:
        stored = json.loads(path.read_text())
        rivals, fits = stored["rivals"], stored["fits"]
        assert all(name in row for row in rivals + fits for name in KEY)
    except (ValueError, KeyError, TypeError, AssertionError) as error:
        raise ValueError(f"{path} holds no rows of this benchmark: give another --output") from error
    return rivals, fits


def _write(rivals: list[Row], fits: list[Row], path: Path) -> None:
    """Three lists, a row a line: what was judged, what every criterion would choose of it, and the fits."""
    parts = {"rivals": rivals, "choices": choices(rivals), "fits": fits}
    lists = [
        f'"{name}": [\n' + ",\n".join(json.dumps(row) for row in rows) + "\n]" for name, rows in parts.items()
    ]
    with replacing(path) as temporary:
        temporary.write_text("{" + ",\n".join(lists) + "}\n")


if __name__ == "__main__":
    cli.run(main, SelectorOptions)
