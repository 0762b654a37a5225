"""DPBoost: macro-labels and a strong classifier per macro-action, boosting and segmentation in turn.

    L(q, f) = sum_n sum_m exp(-y_n^m f_{q_n}^m(x_n))   subject to   #{n : q_n != q_{n+1}} <= S

in every trajectory (Lefakis and Fleuret, Section III). A search proposes segmentations
(`discovery/search.py`), left-out trajectories say which to keep, and classifiers and switch functions are
fitted to it with the exact learner (`estimator/final.py`).
"""

from collections.abc import Callable
from dataclasses import replace
from inspect import signature
from typing import Any

import torch
from jaxtyping import Int64, UInt8
from torch import Tensor

from dpmacro.boosting.learners.base import WeakLearner
from dpmacro.boosting.learners.stumps import StumpLearner
from dpmacro.boosting.loop import Round
from dpmacro.discovery.result import Discovery
from dpmacro.discovery.search import adopt, discover, spread
from dpmacro.estimator.arguments import (
    Standardiser,
    as_actions,
    as_device,
    as_features,
    as_known,
    check_fit,
    check_options,
    standardised,
    task_of,
)
from dpmacro.estimator.final import finished
from dpmacro.estimator.prediction import levels_of, predicted, segmented
from dpmacro.estimator.recipes import search_of, shrinkage_of, switches_of
from dpmacro.estimator.result import DPBoostResult
from dpmacro.estimator.settling import FinalFit
from dpmacro.features.levels import SortedLevels
from dpmacro.features.quantising import Quantiser
from dpmacro.switching.settings import SwitchSettings
from dpmacro.utils.checks import shown
from dpmacro.utils.tensors import ArrayLike, as_lengths

__all__ = ["DPBoost"]

SWITCH_DRAWN = 32  # random columns that a round of stumps searches for switch functions


class DPBoost:
    """Macro-action discovery by change point detection and boosting.

    Follows scikit-learn's manners as far as sequences allow: options by keyword, `get_params`, `set_params`,
    `fit` returns the estimator, what it found ends in an underscore.

    Args:
        macros: Q >= 1; 1 is the baseline, a single classifier.
        max_transitions: S >= 0, the bound in every trajectory; None for Q - 1.
        rounds: boosting rounds of the final fit, 1 or more.
        shrinkage: factor in (0, 1] on every weak hypothesis.
        restarts: initial segmentations, 1 or more.
        switch_rounds: boosting rounds of the switch functions, 1 or more.
        switch_window: J >= 1, the frames from a change on that are its positive examples.
        switch_weight: how much the switch functions' losses count beside those of the actions when sequences
            are cut, 0 or more; 0 keeps them out.
        early_stopping: whether left-out trajectories say how many rounds are kept.
        recipe: "dpmacro", or "paper" for the paper's own: random starts, least training loss, switch
            functions fitted afterwards as in its Section IV; `switch_weight` is 0 then, and shrinkage 1.
        loss: of vectors, "huber" or "squared"; classes have the exponential loss.
        order: of macro-actions, "free", or "chain" for 0, 1, ..., Q - 1 in every trajectory.
        seed: of every draw, 0 or more.
        device: where tensors live.

    Attributes:
        labels_: macro-action of every frame of `fit`.
        confidence_: 0 to 1, how sure classifiers that never saw a frame are of its label.
        result_: everything that was found, a `DPBoostResult`.

    Raises ValueError naming the argument that is out of range.
    """

    def __init__(
        self,
        *,
        macros: int = 2,
        max_transitions: int | None = None,
        rounds: int = 300,
        shrinkage: float = 0.1,
        restarts: int = 32,
        switch_rounds: int = 400,
        switch_window: int = 3,
        switch_weight: float = 1.0,
        early_stopping: bool = False,
        recipe: str = "dpmacro",
        loss: str = "huber",
        order: str = "free",
        seed: int = 0,
        device: str | torch.device = "cpu",
    ) -> None:
        self.macros = macros
        self.max_transitions = max_transitions
        self.rounds = rounds
        self.shrinkage = shrinkage
        self.restarts = restarts
        self.switch_rounds = switch_rounds
        self.switch_window = switch_window
        self.switch_weight = switch_weight
        self.early_stopping = early_stopping
        self.recipe = recipe
        self.loss = loss
        self.order = order
        self.seed = seed
        self.device = device
        check_options(self.get_params())

    def get_params(self, deep: bool = True) -> dict[str, Any]:
        """The options by name; `deep` is there for scikit-learn and changes nothing."""
        return {
            name: getattr(self, name) for name in signature(DPBoost.__init__).parameters if name != "self"
        }

    def __repr__(self) -> str:
        defaults = signature(DPBoost.__init__).parameters
        given = self.get_params().items()
        return (
            f"DPBoost({', '.join(f'{name}={own!r}' for name, own in given if own != defaults[name].default)})"
        )

    def set_params(self, **options: Any) -> "DPBoost":
        """Change options; ValueError for one that does not exist or is out of range, and nothing changes."""
        known = self.get_params()
        for name in options:
            if name not in known:
                raise ValueError(f"{name} is no option of DPBoost: choose among {', '.join(known)}")
        vars(self).update(vars(DPBoost(**{**known, **options})))
        return self

    def fit(
        self,
        features: ArrayLike,
        actions: ArrayLike,
        lengths: ArrayLike,
        on_round: Callable[[Round], None] = lambda _: None,
        *,
        given: ArrayLike | None = None,
    ) -> "DPBoost":
        """Find macro-labels, strong classifiers and switch functions.

        Args:
            features: finite numbers of every frame, [frames, columns], trajectories concatenated.
            actions: of every frame 0..M-1, or a vector, [frames, dims] in floating point.
            lengths: frames of every trajectory, 1 or more each.
            on_round: called after every boosting round.
            given: macro-labels of some frames, 0..Q-1 and -1 elsewhere, that the segmentation keeps to while
                it cuts the other frames; None for none. Then no fewer macro-actions are tried than Q.

        Macro-actions that end up without a frame are left out: there may be fewer than Q, numbered anew in
        their order.

        Raises ValueError where shapes disagree, a feature is not finite, an action or a length is no whole
        number or out of range, there are more macro-actions than frames, or no segmentation under the bound
        or in the order keeps to the given labels.
        """
        check_options(self.get_params())
        if not callable(on_round):
            raise ValueError(f"on_round is {shown(on_round)}: give a function of a round")
        values = as_features(features, as_device(self.device))
        actions = as_actions(actions, values.shape[1])  # before features are sorted, which takes time
        self._standardiser = Standardiser.fit(actions) if actions.ndim == 2 else None
        lengths = as_lengths(lengths, values.shape[1], "features")
        quantiser = Quantiser.fit(values)
        data = SortedLevels.build(quantiser.levels(values))
        actions = standardised(actions, self._standardiser)
        result = self.fit_levels(data, actions, lengths, given=given, on_round=on_round)
        self.result_ = replace(result, quantiser=quantiser)
        self.labels_, self.confidence_ = self.result_.labels, self.result_.confidence
        return self

    def predict(self, features: ArrayLike, lengths: ArrayLike) -> Int64[Tensor, " frames"]:
        """Macro-labels of new sequences without their actions: those that a running policy would have.

        The switch functions choose them frame by frame, never looking ahead, each after the action that the
        classifiers would have taken in the frame before.
        """
        levels = self._levels(features)
        return predicted(self._fitted, levels, as_lengths(lengths, levels.shape[1], "features"))[0]

    def segment(
        self, features: ArrayLike, actions: ArrayLike, lengths: ArrayLike
    ) -> Int64[Tensor, " frames"]:
        """Macro-labels of sequences in hindsight, exact: those of least cost under the bound.

        On the data of `fit` they are its labels, where none were given to it: what is found here is what the
        fitted functions want alone. Arguments and errors as for `fit`.
        """
        levels = self._levels(features)
        actions = standardised(as_actions(actions, levels.shape[1]), self._standardiser)
        return segmented(self._fitted, levels, actions, as_lengths(lengths, levels.shape[1], "features"))

    def score(self, features: ArrayLike, actions: ArrayLike, lengths: ArrayLike) -> float:
        """Share of the frames, 0 to 1, whose action is right under the labels of `predict`.

        Of vectors the share of their variance that is explained.
        """
        levels = self._levels(features)
        actions = standardised(as_actions(actions, levels.shape[1]), self._standardiser).cpu()
        scores = predicted(self._fitted, levels, as_lengths(lengths, levels.shape[1], "features"))[1]
        return 1 - self._fitted.action_loss.error(scores, actions)

    def discover_levels(
        self,
        data: SortedLevels,
        actions: ArrayLike,
        lengths: ArrayLike,
        *,
        groups: Int64[Tensor, " trajectories"] | None = None,
        known: Int64[Tensor, " frames"] | None = None,
        given: ArrayLike | None = None,
        on_round: Callable[[Round], None] = lambda _: None,
    ) -> Discovery | None:
        """Candidate segmentations and their scores without the final fit; None where there is nothing to cut.

        Args:
            data: levels of every frame.
            actions, lengths: as for `fit`; vectors are standardised already.
            groups: numbers 0.. of trajectories to leave out together; alone by default.
            known: labels 0..Q-1 that take the place of the search; they keep to what is given.
            given: labels of some frames, as for `fit`.
            on_round: called after every boosting round.
        """
        task = task_of(self.get_params(), data, actions, lengths, groups, given)
        if task.macros == 1 or task.max_transitions == 0:
            return None
        if known is not None:
            return adopt(data, task, as_known(known, task), on_round)
        options = self.get_params()
        settings, shrinkage = search_of(options), shrinkage_of(options)
        return discover(data, task, settings, int(self.restarts), shrinkage, on_round)

    def fit_levels(
        self,
        data: SortedLevels,
        actions: ArrayLike,
        lengths: ArrayLike,
        *,
        groups: Int64[Tensor, " trajectories"] | None = None,
        learner: WeakLearner | None = None,
        switch_learner: WeakLearner | None = None,
        shrinkage: float | None = None,
        switches: SwitchSettings | None = None,
        discovery: Discovery | None = None,
        given: ArrayLike | None = None,
        on_round: Callable[[Round], None] = lambda _: None,
    ) -> DPBoostResult:
        """`fit` on levels, with learners of the caller's; the result has no quantiser.

        Args:
            data, actions, lengths, groups: as for `discover_levels`.
            learner: of the strong classifiers; exact stumps by default.
            switch_learner: of the switch functions, copies of the frames after them if any; by default
                stumps on `SWITCH_DRAWN` random columns a round.
            shrinkage: of the strong classifiers, where their learner wants another than the search.
            switches: how the switch functions learn, in place of this estimator's.
            discovery: what `discover_levels` found, where it has run already, with the same `given`.
            given: labels of some frames, as for `fit`.
            on_round: called after every boosting round.
        """
        options = self.get_params()
        task = task_of(options, data, actions, lengths, groups, given)
        check_fit(task, learner, switch_learner, shrinkage, switches, discovery)
        if discovery is None:
            discovery = self.discover_levels(
                data, actions, lengths, groups=groups, given=given, on_round=on_round
            )
        search = search_of(options)
        discovery = discovery and spread(data, task, discovery, search, on_round)
        fit = FinalFit(
            StumpLearner(data) if learner is None else learner,
            StumpLearner(data, SWITCH_DRAWN) if switch_learner is None else switch_learner,
            int(self.rounds),
            shrinkage_of(options) if shrinkage is None else shrinkage,
            bool(self.early_stopping),
            switches_of(options) if switches is None else switches,
            search.switch_weight,
            search.held,
        )
        return finished(data, task, discovery, fit, on_round)

    @property
    def _fitted(self) -> DPBoostResult:
        if not hasattr(self, "result_"):
            raise ValueError("this DPBoost has found nothing yet: call fit first")
        return self.result_

    def _levels(self, features: ArrayLike) -> UInt8[Tensor, "columns frames"]:
        """The levels of frames, by the cuts of `fit`."""
        quantiser = self._fitted.quantiser
        assert quantiser is not None, "fit made one"
        return levels_of(quantiser, as_features(features, quantiser.cuts.device))
