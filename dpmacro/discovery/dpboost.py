"""DPBoost: macro-labels and a strong classifier per macro-action, boosting and segmentation in turn.

    L(q, f) = sum_n sum_m exp(-y_n^m f_{q_n}^m(x_n))   subject to   #{n : q_n != q_{n+1}} <= S

in every trajectory (Lefakis and Fleuret, Section III). A search proposes segmentations
(`discovery/search.py`), left-out trajectories say which to keep, and classifiers and switch functions are
fitted to it with the exact learner (`discovery/settling.py`).
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from inspect import signature
from typing import Any

import numpy as np
import torch
from jaxtyping import Int64, Num
from torch import Tensor

from dpmacro.boosting.learners.base import Frames, WeakLearner
from dpmacro.boosting.learners.stumps import StumpLearner
from dpmacro.boosting.loop import Round
from dpmacro.discovery.candidates import Task, confidence
from dpmacro.discovery.hindsight import CHUNK, action_costs, switch_terms_costs
from dpmacro.discovery.result import Discovery, DPBoostResult
from dpmacro.discovery.search import adopt, discover
from dpmacro.discovery.settings import RECIPES, SearchSettings, paper_switches
from dpmacro.discovery.settling import FinalFit, settle
from dpmacro.features.levels import SortedLevels
from dpmacro.features.quantising import Quantiser
from dpmacro.segmentation.recursion import segment
from dpmacro.segmentation.segments import transition_counts
from dpmacro.switching.functions import predicted_labels
from dpmacro.switching.training import SwitchSettings
from dpmacro.utils.checks import as_count, as_flag, as_number, as_tensor, as_whole_vector

__all__ = ["DPBoost"]

MOST_ACTIONS = 2**16
MOST_SEED = 2**63 - 1

Matrix = Num[Tensor, "frames columns"] | np.ndarray
Vector = Int64[Tensor, " entries"] | np.ndarray | Sequence[int]


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
        self.seed = seed
        self.device = device
        self._check()

    def get_params(self, deep: bool = True) -> dict[str, Any]:
        """The options by name; `deep` is there for scikit-learn and changes nothing."""
        return {
            name: getattr(self, name) for name in signature(DPBoost.__init__).parameters if name != "self"
        }

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
        features: Matrix,
        actions: Vector,
        lengths: Vector,
        on_round: Callable[[Round], None] = lambda _: None,
    ) -> "DPBoost":
        """Find macro-labels, strong classifiers and switch functions.

        Args:
            features: finite numbers of every frame, [frames, columns], trajectories concatenated.
            actions: 0..M-1 of every frame.
            lengths: frames of every trajectory, 1 or more each.
            on_round: called after every boosting round.

        Macro-actions that end up without a frame are left out: there may be fewer than Q.

        Raises ValueError where shapes disagree, a feature is not finite, an action or a length is no whole
        number or out of range, or there are more macro-actions than frames.
        """
        self._check()
        values = self._features(features)
        quantiser = Quantiser.fit(values)
        data = SortedLevels.build(quantiser.levels(values))
        result = self.fit_levels(data, actions, lengths, on_round=on_round)
        self.result_ = replace(result, quantiser=quantiser)
        self.labels_, self.confidence_ = self.result_.labels, self.result_.confidence
        return self

    def predict(self, features: Matrix, lengths: Vector) -> Int64[Tensor, " frames"]:
        """Macro-labels of new sequences without their actions: those that a running policy would have.

        The switch functions choose them frame by frame, never looking ahead, each after the action that the
        classifiers would have taken in the frame before.
        """
        return self._predicted(self._frames(features), self._lengths(features, lengths))[0]

    def segment(self, features: Matrix, actions: Vector, lengths: Vector) -> Int64[Tensor, " frames"]:
        """Macro-labels of sequences in hindsight, exact: those of least cost under the bound.

        On the data of `fit` they are its labels. Arguments and errors as for `fit`.
        """
        result, levels = self._fitted, self._frames(features)
        lengths = self._lengths(features, lengths)
        actions = _actions(actions, len(levels.T)).to(levels.device)
        costs = action_costs(_chunks(levels), result.classifiers, actions)
        changing = None
        if result.terms is not None and result.switches.classifier is not None:
            extra = switch_terms_costs(
                _chunks(levels), result.switches.classifier, result.terms, actions, lengths
            )
            costs, changing = costs + extra.staying, extra.changing
        return segment(costs, lengths, result.max_transitions, changing).labels.cpu()

    def score(self, features: Matrix, actions: Vector, lengths: Vector) -> float:
        """Share of the frames, 0 to 1, whose action is right under the labels of `predict`."""
        levels = self._frames(features)
        chosen = self._predicted(levels, self._lengths(features, lengths))[1]
        return float((chosen == _actions(actions, len(chosen)).cpu()).float().mean())

    def discover_levels(
        self,
        data: SortedLevels,
        actions: Vector,
        lengths: Vector,
        *,
        groups: Int64[Tensor, " trajectories"] | None = None,
        known: Int64[Tensor, " frames"] | None = None,
        on_round: Callable[[Round], None] = lambda _: None,
    ) -> Discovery | None:
        """Candidate segmentations and their scores without the final fit; None where there is nothing to cut.

        Args:
            data: levels of every frame.
            actions, lengths: as for `fit`.
            groups: numbers 0.. of trajectories to leave out together; alone by default.
            known: labels 0..Q-1 that take the place of the search.
            on_round: called after every boosting round.
        """
        task = self._task(data, actions, lengths, groups)
        if task.macros == 1 or task.max_transitions == 0:
            return None
        if known is not None:
            return adopt(data, task, known, on_round)
        return discover(data, task, self._search, self.restarts, self._shrinkage, on_round)

    def fit_levels(
        self,
        data: SortedLevels,
        actions: Vector,
        lengths: Vector,
        *,
        groups: Int64[Tensor, " trajectories"] | None = None,
        learner: WeakLearner | None = None,
        switch_learner: WeakLearner | None = None,
        shrinkage: float | None = None,
        switches: SwitchSettings | None = None,
        discovery: Discovery | None = None,
        on_round: Callable[[Round], None] = lambda _: None,
    ) -> DPBoostResult:
        """`fit` on levels, with learners of the caller's; the result has no quantiser.

        Args:
            data: levels of every frame.
            actions, lengths: as for `fit`.
            groups: numbers 0.. of trajectories to leave out together; alone by default.
            learner: of the strong classifiers; exact stumps by default.
            switch_learner: of the switch functions, copies of the frames after them if any; by default
                stumps on `SWITCH_DRAWN` random columns a round.
            shrinkage: of the strong classifiers, where their learner wants another than the search.
            switches: how the switch functions learn, in place of this estimator's.
            discovery: what `discover_levels` found, where it has run already.
            on_round: called after every boosting round.
        """
        task = self._task(data, actions, lengths, groups)
        if discovery is None:
            discovery = self.discover_levels(data, actions, lengths, groups=groups, on_round=on_round)
        labels = torch.zeros(len(task.actions), dtype=torch.int64)
        weight, bound, runnable = 0.0, 0, False
        if discovery is not None:
            labels = discovery.kept.labels.unique(return_inverse=True)[1]
            bound, runnable = discovery.kept.transitions(task.lengths), discovery.kept.scores.runnable
            weight = self._search.switch_weight if runnable else 0.0
        switches = self._switches if switches is None else switches
        if not runnable:  # changes that cannot be recognised say nothing of where they belong
            switches = replace(switches, aligned=False)
        fit = FinalFit(
            StumpLearner(data) if learner is None else learner,
            StumpLearner(data, SWITCH_DRAWN) if switch_learner is None else switch_learner,
            self.rounds,
            self._shrinkage if shrinkage is None else shrinkage,
            self.early_stopping,
            switches,
            weight,
            self._search.held,
        )
        settled = settle(fit, replace(task, max_transitions=bound), labels, on_round)
        sure, final = torch.ones(len(labels)), None
        n_macros = int(settled.labels.max()) + 1
        if n_macros > 1:
            used = int(transition_counts(settled.labels, task.lengths).max())
            final = adopt(
                data, replace(task, macros=n_macros, max_transitions=used), settled.labels, on_round
            )
            sure = confidence(final.kept, final.task, settled.labels)
        return DPBoostResult(
            settled.labels,
            sure,
            settled.loss,
            settled.classifiers,
            settled.switches,
            settled.terms,
            settled.max_transitions,
            settled.unsettled,
            None,
            discovery,
            final,
        )

    @property
    def _search(self) -> SearchSettings:
        if self.recipe == "paper":
            return SearchSettings.paper()
        return SearchSettings(switch_weight=self.switch_weight)

    @property
    def _switches(self) -> SwitchSettings:
        if self.recipe == "paper":
            return paper_switches(self.switch_rounds, self.switch_window)
        return SwitchSettings(self.switch_rounds, self.switch_window, early_stopping=self.early_stopping)

    @property
    def _shrinkage(self) -> float:
        return 1.0 if self.recipe == "paper" else self.shrinkage

    @property
    def _device(self) -> torch.device:
        return torch.empty(0, device=self.device).device  # "cuda" becomes the card that it means

    @property
    def _fitted(self) -> DPBoostResult:
        if not hasattr(self, "result_"):
            raise ValueError("this DPBoost has found nothing yet: call fit first")
        return self.result_

    def _check(self) -> None:
        for name in ("macros", "rounds", "restarts", "switch_rounds", "switch_window"):
            as_count(name, getattr(self, name))
        if self.max_transitions is not None:
            as_count("max_transitions", self.max_transitions, 0)
        as_count("seed", self.seed, 0, MOST_SEED)
        as_number("shrinkage", self.shrinkage, 0, 1)
        if self.switch_weight != 0 or isinstance(self.switch_weight, bool):
            as_number("switch_weight", self.switch_weight, 0)
        as_flag("early_stopping", self.early_stopping)
        if self.recipe not in RECIPES:
            raise ValueError(f"recipe is {self.recipe!r}: choose one of {', '.join(RECIPES)}")
        try:
            torch.empty(0, device=self.device)
        except (RuntimeError, AssertionError, TypeError, ValueError) as error:
            raise ValueError(f"device is {self.device!r}, which is not to be had here: give 'cpu'") from error

    def _features(self, features: Matrix) -> Num[Tensor, "columns frames"]:
        """Checked, and column after column."""
        values = as_tensor("features", features, 2, "[frames, columns]").to(self._device).T.contiguous()
        if values.dtype == torch.bool:
            values = values.to(torch.uint8)
        if values.is_floating_point() and not bool(values.isfinite().all()):
            column, frame = (~values.isfinite()).nonzero()[0].tolist()
            raise ValueError(
                f"feature {column} of frame {frame} is {values[column, frame]}: features must be finite"
            )
        return values

    def _frames(self, features: Matrix) -> Num[Tensor, "columns frames"]:
        """The levels of new frames."""
        quantiser, values = self._fitted.quantiser, self._features(features)
        assert quantiser is not None, "fit made one"
        if len(values) != len(quantiser.cuts):
            raise ValueError(
                f"features have {len(values)} columns, those of fit had {len(quantiser.cuts)}: give the same"
            )
        return quantiser.levels(values.to(quantiser.cuts.dtype))

    def _lengths(self, features: Matrix, lengths: Vector) -> Int64[Tensor, " trajectories"]:
        return _lengths(lengths, len(features))

    def _predicted(
        self, levels: Num[Tensor, "columns frames"], lengths: Int64[Tensor, " trajectories"]
    ) -> tuple[Int64[Tensor, " frames"], Int64[Tensor, " frames"]]:
        result = self._fitted
        switches = result.switches
        scores = torch.cat([result.classifiers.scores(part).cpu() for part in _chunks(levels)])
        first = torch.full((len(lengths),), switches.starts[0])
        margins = torch.zeros(len(scores), 0)
        if switches.classifier is not None:
            own = torch.cat([switches.classifier.scores(part)[:, :, 0].cpu() for part in _chunks(levels)])
            margins = own[:, : len(switches.pairs)] - switches.thresholds
            if len(switches.starts) > 1:
                begun = own[lengths.cumsum(0) - lengths][:, len(switches.pairs) :]
                first = torch.tensor(switches.starts)[begun.argmax(1)]
        return predicted_labels(scores, margins, switches.pairs, switches.cues, lengths, first)

    def _task(
        self,
        data: SortedLevels,
        actions: Vector,
        lengths: Vector,
        groups: Int64[Tensor, " trajectories"] | None,
    ) -> Task:
        if data.levels.device != self._device:
            raise ValueError(f"levels are on {data.levels.device} and device is {self._device}: use one")
        actions, lengths = _actions(actions, data.n_frames), _lengths(lengths, data.n_frames)
        if self.macros > data.n_frames:
            raise ValueError(
                f"macros is {self.macros} but there are only {data.n_frames} frames: ask for fewer"
            )
        groups = torch.arange(len(lengths)) if groups is None else groups.cpu()
        bound = self.macros - 1 if self.max_transitions is None else self.max_transitions
        bound = min(bound, int(lengths.max()) - 1)
        n_actions = int(actions.max()) + 1
        return Task(actions.to(self._device), lengths, groups, n_actions, self.macros, bound, self.seed)


SWITCH_DRAWN = 32  # random columns that a round of stumps searches for switch functions


def _actions(actions: Vector, n_frames: int) -> Int64[Tensor, " frames"]:
    found = as_whole_vector("actions", actions, 0, "[frames], a number 0..M-1 for each")
    if len(found) != n_frames:
        raise ValueError(
            f"features have {n_frames} frames and actions {len(found)}: give one action per frame"
        )
    if int(found.max()) >= MOST_ACTIONS:
        raise ValueError(f"an action is {int(found.max())}: number them from 0, {MOST_ACTIONS} at most")
    return found


def _lengths(lengths: Vector, n_frames: int) -> Int64[Tensor, " trajectories"]:
    found = as_whole_vector("lengths", lengths, 1, "[trajectories], the frames of each").cpu()
    if int(found.sum()) != n_frames:
        raise ValueError(
            f"lengths add up to {int(found.sum())} and features have {n_frames} frames: they must agree"
        )
    return found


def _chunks(levels: Num[Tensor, "columns frames"]) -> list[Frames]:
    return [Frames(levels[:, first : first + CHUNK]) for first in range(0, levels.shape[1], CHUNK)]
