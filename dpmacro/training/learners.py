"""The weak learners that the options name, for action classifiers and for switch functions."""

import torch

from dpmacro.boosting.learners.base import WeakLearner
from dpmacro.boosting.learners.convnet import ConvNetLearner
from dpmacro.boosting.learners.stumps import StumpLearner
from dpmacro.features.base import frames_before
from dpmacro.features.columns import with_mirror_images
from dpmacro.features.levels import SortedLevels
from dpmacro.training.data import Columns, TrainingData
from dpmacro.training.options import PlannerOptions, TrainOptions

__all__ = ["WeakLearners", "check_divisible", "rounds_of", "shrinkage_of"]


def rounds_of(planner: PlannerOptions, kind: str, rounds: int) -> int:
    """Boosting rounds of a classifier of that kind: `rounds` with stumps, the networks' own with convnet."""
    return planner.convnet.rounds if kind == "convnet" else rounds


def shrinkage_of(planner: PlannerOptions, kind: str, shrinkage: float) -> float:
    """Shrinkage of a classifier of that kind: `shrinkage` with stumps, the networks' own with convnet."""
    return planner.convnet.shrinkage if kind == "convnet" else shrinkage


def check_divisible(options: TrainOptions) -> None:
    """Raise ValueError where the options ask for what ranks cannot do together."""
    planner = options.planner
    wrong = {
        "dagger.iterations": options.dagger.iterations,
        "planner.learner": planner.learner if planner.learner == "convnet" else 0,
        "planner.switch_learner": planner.switch_learner if planner.switch_learner == "convnet" else 0,
    }
    for name, value in wrong.items():
        if value:
            raise ValueError(
                f"{name} is {value}: ranks divide feature columns; train without torchrun, or leave it out"
            )


class WeakLearners:
    """Makes the weak learners for one set of training frames.

    Args:
        planner: the options that name the kinds of weak learners and the columns that a round searches.
        data: the frames.
    """

    def __init__(
        self,
        planner: PlannerOptions,
        data: TrainingData,
    ) -> None:
        self._planner = planner
        self._data = data
        self._drawn = data.plan.drawn  # number of columns that memory lets a round search, 0 for all

    def for_classifiers(self, data: SortedLevels) -> WeakLearner:
        """The weak learner of the action classifiers."""
        planner = self._planner
        drawn = planner.drawn or self._drawn
        stumps = StumpLearner(data, min(drawn, self._drawn or drawn), planner.reuse)
        return stumps if planner.learner == "stumps" else self._networks(False)

    def for_switches(self, columns: Columns, mirror: bool) -> WeakLearner:
        """The weak learner of the switch functions; with `mirror` it holds mirror images after the frames."""
        planner, data = self._planner, columns.levels
        if planner.switch_learner == "convnet":
            return self._networks(mirror)
        if mirror:
            seen, lengths = self._data.observations, self._data.lengths
            data = with_mirror_images(data, seen, lengths, columns.encoder, columns.quantiser)
        drawn = planner.switch_drawn or self._drawn
        if drawn == 0 and not data.is_sorted:
            data = data.like(data.levels, sort=True)
        return StumpLearner(data, drawn)

    def _networks(self, mirror: bool) -> ConvNetLearner:
        """The networks, which look at images alone."""
        assert self._data.camera is not None, "the data checked it"
        images = self._data.observations[self._data.camera]
        before = frames_before(self._data.lengths.to(images.device))
        if mirror:
            images, before = torch.cat([images, images.flip(2)]), torch.cat([before, before + len(before)])
        return ConvNetLearner(images, before, epochs=self._planner.convnet.epochs)
