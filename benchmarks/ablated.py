"""Run a script of this project with some of dpmacro's additions to the paper taken out.

    python benchmarks/ablated.py --without=cues --without=merging train.py --dataset.root=... --output_dir=...

What is taken out is replaced in this process alone; the script and its options are otherwise what they are.
`PARTS` says what there is to take out.
"""

import importlib
import runpy
import sys
from argparse import REMAINDER, ArgumentParser
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import torch

__all__ = ["PARTS", "Part", "apply"]

ROOT = Path(__file__).parents[1]


@dataclass(frozen=True)
class Part:
    """An addition to the paper, and how to do without it.

    Attributes:
        title: for people.
        options: of train.py, that take it out.
        patches: (module, name, what makes of the original what stands in for it).
        run_options: of eval.py, that take it out.
        camera, classes: whether it is of no use where there is no camera, or where actions are vectors.
    """

    title: str
    options: tuple[str, ...] = ()
    patches: tuple[tuple[str, str, Callable[[Any], Any]], ...] = ()
    run_options: tuple[str, ...] = ()
    camera: bool = False
    classes: bool = False


def _switches(**changed: Any) -> tuple[tuple[str, str, Callable[[Any], Any]], ...]:
    """Switch functions of the final fit with other settings, in train.py and in the estimator."""
    return tuple(
        (module, "SwitchSettings", lambda original: partial(original, **changed))
        for module in ("dpmacro.training.trainer", "dpmacro.estimator.recipes")
    )


def _search(**changed: Any) -> tuple[tuple[str, str, Callable[[Any], Any]], ...]:
    """A search with other settings."""

    def changing(original: Callable[[Any], Any]) -> Callable[[Any], Any]:
        return lambda options: replace(original(options), **changed)

    return (("dpmacro.estimator.dpboost", "search_of", changing),)


def _no_peaks(original: Any) -> Callable[..., torch.Tensor]:
    return lambda data, lengths, *rest: torch.zeros(0, int(lengths.sum()), dtype=torch.int64)


def _no_others(original: Callable[..., float]) -> Callable[..., float]:
    return lambda segments, scores, tolerance=0, others=(): original(segments, scores, tolerance)


def _as_it_is(original: Any) -> Callable[..., Any]:
    return lambda scored, *rest: list(scored)


PARTS = {
    "rectangles": Part(
        "rectangles and opponent colours", ("--planner.features=pixels",), camera=True, classes=True
    ),
    "mirror": Part("mirror images", ("--dataset.symmetric=false",), camera=True, classes=True),
    "starts": Part("starts that look at the data", patches=_search(starts="random")),
    "peaks": Part("feature-peak starts", patches=(("dpmacro.discovery.search", "feature_peaks", _no_peaks),)),
    "selection": Part("causal selection", patches=_search(criterion="loss")),
    "joint-cut": Part("joint cut", ("--planner.switch_weight=0",), _search(switch_weight=0.0)),
    "merging": Part("merging", patches=(("dpmacro.discovery.search", "simplified", _as_it_is),)),
    "cues": Part("cues", patches=_switches(cues=False, focused=False), classes=True),
    "focused": Part("focused learning", patches=_switches(focused=False), classes=True),
    "alignment": Part("alignment", patches=_switches(aligned=False)),
    "calibration": Part("calibration", patches=_switches(calibrated=False)),
    "rare": Part(
        "rule for rare changes", patches=(("dpmacro.switching.training", "best_threshold", _no_others),)
    ),
    "recovery": Part("recovery", run_options=("--policy.recovery=false",), classes=True),
}


def apply(names: Iterable[str]) -> None:
    """Take parts out of the modules of this process."""
    for name in names:
        for module, attribute, standing_in in PARTS[name].patches:
            found = importlib.import_module(module)
            setattr(found, attribute, standing_in(getattr(found, attribute)))


def main() -> None:
    """Take the parts out and run the script."""
    parser = ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None, allow_abbrev=False)
    parser.add_argument("--without", action="append", default=[], choices=PARTS, help="a part to take out")
    parser.add_argument("script", help="of this project, such as train.py")
    parser.add_argument("options", nargs=REMAINDER, help="of the script")
    given = parser.parse_args()
    script = ROOT / given.script
    if not script.is_file():
        parser.error(f"script is {given.script}: give one of this project, such as train.py")
    apply(given.without)
    sys.argv = [str(script), *given.options]
    sys.path.insert(0, str(script.parent))
    runpy.run_path(str(script), run_name="__main__")


if __name__ == "__main__":
    main()
