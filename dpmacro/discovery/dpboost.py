"""DPBoost: macro-labels and a strong classifier per macro-action, boosting and segmentation in turn.

    L(q, f) = sum_n sum_m exp(-y_n^m f_{q_n}^m(x_n))   subject to   #{n : q_n != q_{n+1}} <= S

in every trajectory (Lefakis and Fleuret, Section III). The objective has many local optima, so the
alternation starts from many seeded initial segmentations side by side, on a few dozen random
columns a round; those of fewer macro-actions are among them, since Q is what a planner may have, not what it
must. Left-out trajectories judge the distinct outcomes and what becomes of the best of them
(dpmacro/discovery/refinement.py); the chosen one is refitted with the exact learner.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Float, Int64, Num
from torch import Tensor

from dpmacro.boosting.learners.base import Frames, StrongClassifier, WeakLearner
from dpmacro.boosting.learners.stumps import StumpLearner
from dpmacro.boosting.loop import Boosting, Round, class_targets
from dpmacro.boosting.stopping import validated_rounds
from dpmacro.discovery.alternation import Alternated, SwitchCosts, alternate, pooled
from dpmacro.discovery.candidates import Judged, Task, best_verdict, confidence, distinct, judge
from dpmacro.discovery.joint import switch_costs
from dpmacro.discovery.refinement import recut, simplified
from dpmacro.discovery.result import Search
from dpmacro.discovery.starts import action_events, feature_peaks, initial_segmentations
from dpmacro.features.levels import SortedLevels
from dpmacro.features.quantising import Quantiser

__all__ = ["DPBoost", "DPBoostResult"]

PEAKS = 2  # rivals a restart that are cut at feature peaks, with two macro-actions; fewer with more


@dataclass(frozen=True)
class DPBoostResult:
    """A segmentation and what explains it."""

    labels: Int64[Tensor, " frames"]  # macro-action of every frame, 0..Q-1, each used
    confidence: Float[
        Tensor, " frames"
    ]  # 0..1, how sure classifiers that never saw the frame are of its label
    loss: Float[Tensor, " rounds"]  # objective per frame after every round of the exact fit
    classifiers: StrongClassifier  # problems are macro-actions, classes are actions
    quantiser: Quantiser | None  # from raw feature columns to levels; None where levels were given
    search: Search | None  # None where there was nothing to discover
    switch_weight: float  # how much the switch functions had to say in the end; 0 where nothing

    @property
    def macros(self) -> int:
        """The macro-actions that are used."""
        return int(self.labels.max()) + 1

    def scores(self, features: Num[Tensor, "frames columns"]) -> Float[Tensor, "frames macros actions"]:
        """f_q^m(x) of raw features; only for a result that was fitted on raw features."""
        assert self.quantiser is not None, "fitted on levels: use classifiers.scores"
        return self.classifiers.scores(Frames(self.quantiser.levels(features.T.contiguous())))


class DPBoost:
    """Macro-action discovery by change point detection and boosting.

    Args:
        macros: Q >= 1; 1 is the baseline, a single classifier.
        max_transitions: S >= 0, the bound in every trajectory; None for Q - 1.
        rounds: boosting rounds of the exact fit.
        learner: makes the weak learner of the exact fit from sorted levels; stumps discover and judge.
        restarts: initial segmentations (dpmacro/discovery/starts.py).
        seed: of every draw.
        device: where tensors live.
        shrinkage: factor in (0, 1] on every weak hypothesis.
        fit_shrinkage: likewise in the exact fit, where its learner wants another.
        discovery_rounds: rounds from every initial segmentation.
        warmup: rounds that keep the labels they start from, at most half of a stage: relabelling by barely
            trained classifiers forgets a good start. After it the labels are re-estimated every round.
        drawn: random columns searched a round while discovering.
        switch_weight: how much the switch functions' losses count beside those of the actions in the final
            segmentation; 0 keeps them out.
        early_stopping: whether left-out trajectories say how many of `rounds` the exact fit has.

    Raises ValueError naming the argument that is out of range.
    """

    def __init__(
        self,
        macros: int,
        max_transitions: int | None = None,
        rounds: int = 300,
        learner: Callable[[SortedLevels], WeakLearner] = StumpLearner,
        restarts: int = 32,
        seed: int = 0,
        device: str | torch.device = "cpu",
        *,
        shrinkage: float = 0.1,
        fit_shrinkage: float | None = None,
        discovery_rounds: int = 80,
        warmup: int = 30,
        drawn: int = 48,
        switch_weight: float = 1.0,
        early_stopping: bool = False,
    ) -> None:
        counts = {
            "macros": macros,
            "rounds": rounds,
            "restarts": restarts,
            "discovery_rounds": discovery_rounds,
            "drawn": drawn,
        }
        for name, value in counts.items():
            if value < 1:
                raise ValueError(f"{name} is {value}: give 1 or more")
        self.macros = macros
        self.max_transitions = macros - 1 if max_transitions is None else max_transitions
        if self.max_transitions < 0:
            raise ValueError(f"max_transitions is {max_transitions}: give 0 or more")
        self.rounds = rounds
        self.learner = learner
        self.restarts = restarts
        self.seed = seed
        self.device = torch.empty(0, device=device).device  # "cuda" becomes the card that it means
        self.shrinkage = shrinkage
        self.fit_shrinkage = shrinkage if fit_shrinkage is None else fit_shrinkage
        self.discovery_rounds = discovery_rounds
        self.warmup = warmup
        self.drawn = drawn
        self.switch_weight = switch_weight
        self.early_stopping = early_stopping

    def fit(
        self,
        features: Num[Tensor, "frames columns"] | np.ndarray | SortedLevels,
        actions: Int64[Tensor, " frames"] | np.ndarray | Sequence[int],
        lengths: Int64[Tensor, " trajectories"] | np.ndarray | Sequence[int],
        on_round: Callable[[Round], None] = lambda _: None,
        groups: Int64[Tensor, " trajectories"] | None = None,
        search: Search | None = None,
    ) -> DPBoostResult:
        """Find macro-labels and strong classifiers.

        Args:
            features: numbers of every frame, trajectories concatenated; or levels that are sorted already.
            actions: 0..M-1 of every frame.
            lengths: frames of every trajectory.
            on_round: called after every boosting round.
            groups: numbers 0.. of trajectories to leave out together, like mirror images; alone by default.
            search: what `search` found on the same data, where it has run already.

        Macro-actions that end up without a frame are pruned: the result may have fewer than Q.

        Raises ValueError where the shapes disagree, a feature is not finite, an action is negative, or there
        are more macro-actions than frames.
        """
        data, quantiser = self._prepare(features)
        task = self._task(data, actions, lengths, groups)
        if search is None and self.macros > 1 and task.max_transitions > 0:
            search = self._search(data, task, on_round)
        labels = torch.zeros_like(task.actions).cpu() if search is None else search.kept.labels
        generator = torch.Generator().manual_seed(self.seed)
        learner, rounds = self.learner(data), self.rounds
        if self.early_stopping:
            held = labels, task.actions, task.lengths, rounds, self.fit_shrinkage
            rounds = validated_rounds(learner, *held, generator, task.groups, on_round)
        costs = None if search is None else self._switch_costs(search.kept, task)
        if search is not None:
            task = replace(task, macros=int(labels.max()) + 1, max_transitions=search.kept_transitions)
        boosting = self._boosting(learner, task, 1, self.fit_shrinkage, generator)
        fitted = self._alternate(boosting, task, labels[None], "fit", rounds, on_round, costs)
        found = fitted.labels[0]
        sure = torch.ones(len(found)) if search is None else confidence(search.kept, search.task, found)
        used, pruned = found.unique(return_inverse=True)
        strong = boosting.strong().select(used.to(self.device))
        weight = 0.0 if costs is None else self.switch_weight
        return DPBoostResult(pruned, sure, fitted.loss[:, 0], strong, quantiser, search, weight)

    def search(
        self,
        data: SortedLevels,
        actions: Int64[Tensor, " frames"],
        lengths: Int64[Tensor, " trajectories"],
        on_round: Callable[[Round], None] = lambda _: None,
        groups: Int64[Tensor, " trajectories"] | None = None,
    ) -> Search:
        """Find and judge segmentations without the final fit; arguments and errors as for `fit`."""
        return self._search(data, self._task(data, actions, lengths, groups), on_round)

    def adopt(
        self,
        data: SortedLevels,
        actions: Int64[Tensor, " frames"],
        lengths: Int64[Tensor, " trajectories"],
        labels: Int64[Tensor, " frames"],
        on_round: Callable[[Round], None] = lambda _: None,
        groups: Int64[Tensor, " trajectories"] | None = None,
    ) -> Search:
        """Judge a segmentation that is known already, in place of a search; errors as for `fit`.

        `labels` are 0..Q-1; the other arguments are those of `fit`.
        """
        task = self._task(data, actions, lengths, groups)
        [judged] = judge(data, task, labels[None], on_round)
        return Search(
            task, Alternated(labels[None], torch.tensor([[judged.verdict.hindsight_loss]])), (judged,), 0
        )

    def _task(
        self,
        data: SortedLevels,
        actions: Int64[Tensor, " frames"] | np.ndarray | Sequence[int],
        lengths: Int64[Tensor, " trajectories"] | np.ndarray | Sequence[int],
        groups: Int64[Tensor, " trajectories"] | None,
    ) -> Task:
        actions = torch.as_tensor(actions).long()
        lengths = torch.as_tensor(lengths).long().cpu()
        _check(data, actions, lengths, self.macros)
        groups = torch.arange(len(lengths)) if groups is None else groups.cpu()
        bound = min(self.max_transitions, int(lengths.max()) - 1)
        n_actions = int(actions.max()) + 1
        return Task(actions.to(self.device), lengths, groups, n_actions, self.macros, bound, self.seed)

    def _prepare(
        self, features: Num[Tensor, "frames columns"] | np.ndarray | SortedLevels
    ) -> tuple[SortedLevels, Quantiser | None]:
        if isinstance(features, SortedLevels):
            if features.levels.device != self.device:
                raise ValueError(
                    f"levels are on {features.levels.device} and device is {self.device}: use one"
                )
            return features, None
        values = torch.as_tensor(features).to(self.device)
        if values.ndim != 2 or 0 in values.shape:
            raise ValueError(f"features have shape {tuple(values.shape)}: give [frames, columns]")
        values = values.T.contiguous()
        if values.is_floating_point() and not bool(values.isfinite().all()):
            column, frame = (~values.isfinite()).nonzero()[0].tolist()
            raise ValueError(
                f"feature {column} of frame {frame} is {values[column, frame]}: features must be finite"
            )
        quantiser = Quantiser.fit(values)
        return SortedLevels.build(quantiser.levels(values)), quantiser

    def _search(self, data: SortedLevels, task: Task, on_round: Callable[[Round], None]) -> Search:
        candidates = pooled([self._discover(data, smaller, on_round) for smaller in _smaller(task)])
        judged = self._judge(data, task, candidates, on_round)
        best = best_verdict([rival.verdict for rival in judged])
        return Search(task, candidates, tuple(judged), best)

    def _discover(self, data: SortedLevels, task: Task, on_round: Callable[[Round], None]) -> Alternated:
        """The alternation from every initial segmentation, on random columns."""
        generator = torch.Generator().manual_seed(self.seed)
        starts = initial_segmentations(
            data.levels,
            task.actions,
            task.lengths,
            self.restarts,
            task.macros,
            task.max_transitions,
            generator,
        )
        learner = StumpLearner(data, drawn=self.drawn)
        boosting = self._boosting(learner, task, len(starts), self.shrinkage, generator)
        return self._alternate(boosting, task, starts, "discover", self.discovery_rounds, on_round)

    def _judge(
        self, data: SortedLevels, task: Task, candidates: Alternated, on_round: Callable[[Round], None]
    ) -> list[Judged]:
        """Verdicts on what the alternation found, on cuts by rare actions and at feature peaks as they are,
        on what switch functions make of the best, and on the best of all with fewer macro-actions.

        The alternation knows no switch functions: it drifts away from cuts that can be recognised.
        """
        order = candidates.loss[-1].argsort()
        generator = torch.Generator().manual_seed(self.seed)
        bounds = task.macros, task.max_transitions
        events = action_events(task.actions, task.lengths, self.restarts // 4, *bounds, generator)
        peaks = [
            feature_peaks(
                data.levels,
                task.lengths,
                PEAKS * self.restarts // (smaller.macros - 1),
                smaller.macros,
                smaller.max_transitions,
                generator,
                task.actions,
            )
            for smaller in _smaller(task)
        ]
        rivals = torch.cat([candidates.labels[order], events, *peaks])
        judged = judge(data, task, rivals[distinct(rivals)], on_round)
        if self.switch_weight > 0 and task.n_groups > 1:
            judged = recut(judged, data, task, self.switch_weight, on_round)
        return simplified(judged, data, task, on_round)

    def _switch_costs(self, kept: Judged, task: Task) -> SwitchCosts | None:
        """What recognising the changes costs; None where they cannot be recognised anyway."""
        if self.switch_weight == 0 or not kept.verdict.runnable:
            return None
        costs, used = switch_costs(kept, task, self.switch_weight), int(kept.labels.max()) + 1
        return SwitchCosts(costs.staying[:, :used], costs.changing[:, :used, :used])

    def _boosting(
        self, learner: WeakLearner, task: Task, restarts: int, shrinkage: float, generator: torch.Generator
    ) -> Boosting:
        targets = class_targets(task.actions, task.n_actions)
        return Boosting(learner, targets, restarts * task.macros, shrinkage, generator)

    def _alternate(
        self,
        boosting: Boosting,
        task: Task,
        starts: Int64[Tensor, "restarts frames"],
        stage: str,
        rounds: int,
        on_round: Callable[[Round], None],
        costs: SwitchCosts | None = None,
    ) -> Alternated:
        bounds = task.macros, task.max_transitions
        warmup = min(self.warmup, rounds // 2)
        return alternate(
            boosting, task.actions, task.lengths, starts, *bounds, rounds, warmup, stage, on_round, costs
        )


def _smaller(task: Task) -> list[Task]:
    """The task with 2, 3, ... macro-actions and so many transitions as they need, up to the whole."""
    bound = task.max_transitions
    fewer = [replace(task, macros=n, max_transitions=min(n - 1, bound)) for n in range(2, task.macros)]
    return [*fewer, task]


def _check(data: SortedLevels, actions: Tensor, lengths: Tensor, macros: int) -> None:
    if len(actions) == 0 or data.n_frames != len(actions):
        raise ValueError(
            f"features have {data.n_frames} frames and actions {len(actions)}: give one action per frame"
        )
    if int(lengths.sum()) != len(actions) or int(lengths.min()) < 1:
        raise ValueError(f"lengths {lengths.tolist()} must be positive and add up to {len(actions)} frames")
    if int(actions.min()) < 0:
        raise ValueError(f"an action is {int(actions.min())}: actions are 0 or more")
    if macros > len(actions):
        raise ValueError(f"macros is {macros} but there are only {len(actions)} frames: ask for fewer")
