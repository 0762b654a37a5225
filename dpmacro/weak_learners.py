"""The weak learners that the options ask for: of the strong classifiers, and of the switch functions."""

from collections.abc import Sequence

import torch
from jaxtyping import Int64, UInt8
from torch import Tensor

from dpmacro.columns import with_views
from dpmacro.features import FeatureSet, frames_before
from dpmacro.learners import WeakLearner
from dpmacro.learners.convnet import ConvNetLearner
from dpmacro.learners.ensemble import InTurn
from dpmacro.learners.sorting import SortedLevels
from dpmacro.learners.stumps import StumpLearner
from dpmacro.options import PlannerOptions
from dpmacro.quantising import Quantiser
from dpmacro.views import View, other_views

__all__ = ["WeakLearners", "rounds_of", "shrinkage_of", "views_of"]


def rounds_of(planner: PlannerOptions, kind: str, rounds: int) -> int:
    """Boosting rounds in all of a learner of that kind, where stumps have `rounds`."""
    networks = planner.convnet.rounds
    return {"stumps": rounds, "convnet": networks, "mixed": rounds + networks}[kind]


def shrinkage_of(planner: PlannerOptions, kind: str, shrinkage: float) -> float:
    """Shrinkage of a learner of that kind, where stumps have `shrinkage`."""
    return planner.convnet.shrinkage if kind == "convnet" else shrinkage


def views_of(planner: PlannerOptions, width: int, mirrored: bool) -> list[View]:
    """What switch functions see beside the demonstrations, which may be `mirrored` already."""
    return other_views(planner.switch_mirror and not mirrored, round(planner.switch_shift * width))


class WeakLearners:
    """Makes weak learners of a set of frames.

    Args:
        planner: which kinds, and how many columns a round searches.
        images, lengths: the frames, for networks and other views.
        drawn: how many columns a round of the strong classifiers may search, 0 for all (see `Plan`).
    """

    def __init__(
        self,
        planner: PlannerOptions,
        images: UInt8[Tensor, "frames height width 3"],
        lengths: Int64[Tensor, " trajectories"],
        drawn: int,
    ) -> None:
        self._planner = planner
        self._images = images
        self._lengths = lengths
        self._drawn = drawn

    def for_classifiers(self, data: SortedLevels) -> WeakLearner:
        """The weak learner of the strong classifiers."""
        planner = self._planner
        drawn = planner.drawn or self._drawn
        stumps = StumpLearner(data, min(drawn, self._drawn or drawn), planner.reuse)
        return self._of_kind(planner.learner, planner.rounds, stumps, [])

    def for_switches(
        self, data: SortedLevels, features: FeatureSet, quantiser: Quantiser, views: Sequence[View]
    ) -> WeakLearner:
        """The weak learner of the switch functions; it holds the frames, then all of them in each view."""
        planner = self._planner
        if views:
            data = with_views(data, self._images, self._lengths, features, quantiser, views)
        stumps = StumpLearner(data, planner.switch_drawn)
        return self._of_kind(planner.switch_learner, planner.switch_rounds, stumps, views)

    def _of_kind(self, kind: str, rounds: int, stumps: StumpLearner, views: Sequence[View]) -> WeakLearner:
        """The learner of that name; a mixed one turns to networks after `rounds`."""
        if kind == "stumps":
            return stumps
        images, before = self._images, frames_before(self._lengths.to(self._images.device))
        before = torch.cat([before + number * len(images) for number in range(1 + len(views))])
        images = torch.cat([images, *(view(images) for view in views)])
        networks = ConvNetLearner(images, before, epochs=self._planner.convnet.epochs)
        return networks if kind == "convnet" else InTurn(stumps, rounds, networks)
