"""DPBoost: macro-labels and a strong classifier per macro-action, boosting and segmentation in turn.

    L(q, f) = sum_n sum_m exp(-y_n^m f_{q_n}^m(x_n))   subject to   #{n : q_n != q_{n+1}} <= S

in every trajectory (Lefakis and Fleuret, Section III). The objective has many local optima, so the
alternation starts from many seeded initial segmentations side by side, on a few dozen random
columns a round. Left-out trajectories choose among the distinct outcomes, and the chosen one is
refitted with the exact learner.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Int64, Num
from torch import Tensor

from dpmacro.boosting import Boosting, Round, class_targets
from dpmacro.initial import feature_peaks, random_cuts
from dpmacro.learners import Frames, StrongClassifier, WeakLearner
from dpmacro.learners.sorting import SortedLevels
from dpmacro.learners.stumps import StumpLearner
from dpmacro.quantising import Quantiser
from dpmacro.segmentation import segment
from dpmacro.selection import Verdict, best_verdict, distinct, judge
from dpmacro.stopping import validated_rounds

__all__ = ["Candidates", "DPBoost", "DPBoostResult"]

ROUNDING = 1e-4  # relative; scores are float32


@dataclass(frozen=True)
class Candidates:
    """Where the alternation ended from every initial segmentation."""

    labels: Int64[Tensor, "restarts frames"]
    loss: Float[Tensor, "rounds restarts"]  # objective per frame after every round


@dataclass(frozen=True)
class DPBoostResult:
    """A segmentation and what explains it."""

    labels: Int64[Tensor, " frames"]  # macro-action of every frame, 0..Q-1
    loss: Float[Tensor, " rounds"]  # objective per frame after every round of the exact fit
    classifiers: StrongClassifier  # problems are macro-actions, classes are actions
    quantiser: Quantiser | None  # from raw feature columns to levels; None where levels were given
    candidates: Candidates | None  # None where there was nothing to discover
    verdicts: dict[int, Verdict]  # of the restarts that were judged

    def scores(self, features: Num[Tensor, "frames columns"]) -> Float[Tensor, "frames macros actions"]:
        """f_q^m(x) of raw features; only for a result that was fitted on raw features."""
        assert self.quantiser is not None, "fitted on levels: use classifiers.scores"
        return self.classifiers.scores(Frames(self.quantiser.levels(features.T.contiguous())))


@dataclass(frozen=True)
class _Task:
    actions: Int64[Tensor, " frames"]
    lengths: Int64[Tensor, " trajectories"]
    groups: Int64[Tensor, " trajectories"]
    n_actions: int


class DPBoost:
    """Macro-action discovery by change point detection and boosting.

    Args:
        macros: Q >= 1; 1 is the baseline, a single classifier.
        max_transitions: S >= 0, the bound in every trajectory; None for Q - 1.
        rounds: boosting rounds of the exact fit.
        learner: makes the weak learner of the exact fit from sorted levels; stumps discover and judge.
        restarts: initial segmentations, the first half from feature peaks, the rest random cuts.
        seed: of every draw.
        device: where tensors live.
        shrinkage: factor in (0, 1] on every weak hypothesis.
        fit_shrinkage: likewise in the exact fit, where its learner wants another.
        discovery_rounds: rounds from every initial segmentation.
        warmup: rounds that keep the labels they start from, at most half of a stage: relabelling by barely
            trained classifiers forgets a good start. After it the labels are re-estimated every round.
        drawn: random columns searched a round while discovering.
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
        self.early_stopping = early_stopping

    def fit(
        self,
        features: Num[Tensor, "frames columns"] | np.ndarray | SortedLevels,
        actions: Int64[Tensor, " frames"] | np.ndarray | Sequence[int],
        lengths: Int64[Tensor, " trajectories"] | np.ndarray | Sequence[int],
        on_round: Callable[[Round], None] = lambda _: None,
        groups: Int64[Tensor, " trajectories"] | None = None,
    ) -> DPBoostResult:
        """Find macro-labels and strong classifiers.

        Args:
            features: numbers of every frame, trajectories concatenated; or levels that are sorted already.
            actions: 0..M-1 of every frame.
            lengths: frames of every trajectory.
            on_round: called after every boosting round.
            groups: numbers 0.. of trajectories to leave out together, like mirror images; alone by default.

        Raises ValueError where the shapes disagree, a feature is not finite, an action is negative, or there
        are more macro-actions than frames.
        """
        actions = torch.as_tensor(actions).long()
        lengths = torch.as_tensor(lengths).long().cpu()
        data, quantiser = self._prepare(features)
        _check(data, actions, lengths, self.macros)
        generator = torch.Generator().manual_seed(self.seed)
        groups = torch.arange(len(lengths)) if groups is None else groups.cpu()
        task = _Task(actions.to(self.device), lengths, groups, int(actions.max()) + 1)
        candidates: Candidates | None = None
        verdicts: dict[int, Verdict] = {}
        labels = torch.zeros(1, len(actions), dtype=torch.int64)
        if self.macros > 1 and self.max_transitions > 0:
            candidates = self._discover(data, task, generator, on_round)
            labels, verdicts = self._choose(data, task, candidates, on_round)
        learner, rounds = self.learner(data), self.rounds
        if self.early_stopping:
            held = labels[0], task.actions, lengths
            rounds = validated_rounds(learner, *held, rounds, self.fit_shrinkage, generator, groups, on_round)
        boosting = self._boosting(learner, task, 1, self.fit_shrinkage, generator)
        fitted = self._alternate(boosting, task, labels, "fit", rounds, on_round)
        return DPBoostResult(
            fitted.labels[0], fitted.loss[:, 0], boosting.strong(), quantiser, candidates, verdicts
        )

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

    def _boosting(
        self,
        learner: WeakLearner,
        task: _Task,
        restarts: int,
        shrinkage: float,
        generator: torch.Generator,
    ) -> Boosting:
        targets = class_targets(task.actions, task.n_actions)
        return Boosting(learner, targets, restarts * self.macros, shrinkage, generator)

    def _discover(
        self, data: SortedLevels, task: _Task, generator: torch.Generator, on_round: Callable[[Round], None]
    ) -> Candidates:
        """The alternation from every initial segmentation, on random columns."""
        n_peaks = (self.restarts + 1) // 2
        bound = min(self.max_transitions, int(task.lengths.max()) - 1)
        shape = (self.macros, bound, generator)
        initial = torch.cat(
            [
                feature_peaks(data.levels, task.lengths, n_peaks, *shape),
                random_cuts(task.lengths, self.restarts - n_peaks, *shape),
            ]
        )
        learner = StumpLearner(data, drawn=self.drawn)
        boosting = self._boosting(learner, task, self.restarts, self.shrinkage, generator)
        return self._alternate(boosting, task, initial, "discover", self.discovery_rounds, on_round)

    def _alternate(
        self,
        boosting: Boosting,
        task: _Task,
        labels: Int64[Tensor, "restarts frames"],
        stage: str,
        rounds: int,
        on_round: Callable[[Round], None],
    ) -> Candidates:
        """Boosting rounds, each followed by a segmentation once the warm-up is over.

        Boosting lowers the objective with the labels held, segmentation lowers it with the classifiers
        held and the labels so far among its choices: it never rises, which is asserted up to rounding.
        """
        restarts, n_frames = labels.shape
        labels, repeated = labels.to(self.device), task.lengths.repeat(restarts)
        warmup = min(self.warmup, rounds // 2)
        bound = min(self.max_transitions, int(task.lengths.max()) - 1)
        loss: list[Tensor] = []
        for number in range(1, rounds + 1):
            held = torch.nn.functional.one_hot(labels, self.macros).float()
            ended = boosting.round(held.transpose(0, 1).flatten(1))
            costs = boosting.losses().unflatten(1, (restarts, self.macros)).transpose(0, 1)
            changed = torch.zeros(restarts)
            if number > warmup and self.macros > 1:
                found = segment(costs.flatten(0, 1), repeated, bound).labels.view(restarts, n_frames)
                changed, labels = (found != labels).float().mean(1), found
            loss.append(costs.gather(2, labels[:, :, None]).double().mean((1, 2)))
            risen = loss[-1] > loss[max(len(loss) - 2, 0)] * (1 + ROUNDING)
            assert not bool(risen.any()), f"the objective rose in round {number} of {stage}"
            best = int(loss[-1].argmin())
            held_by = best * self.macros + labels[best]
            chosen = boosting.scores[torch.arange(n_frames, device=self.device), held_by].argmax(1)
            accuracy = float((chosen == task.actions).float().mean())
            over = tuple(ended.tolist()) if restarts == 1 else ()
            now = float(loss[-1][best]), accuracy, labels[best], float(changed[best])
            on_round(Round(stage, number, rounds, *now, ended=over))
            if bool(boosting.ended.all()):
                break
        return Candidates(labels.cpu(), torch.stack(loss).cpu())

    def _choose(
        self,
        data: SortedLevels,
        task: _Task,
        candidates: Candidates,
        on_round: Callable[[Round], None],
    ) -> tuple[Int64[Tensor, "1 frames"], dict[int, Verdict]]:
        """The candidate with the best verdict; with nothing to leave out, the one with the least loss."""
        order = candidates.loss[-1].argsort()
        order = order[distinct(candidates.labels[order])]
        if int(task.groups.max()) == 0:
            return candidates.labels[order[:1]], {}
        rivals = candidates.labels[order]
        verdicts = judge(
            data, task.actions, task.lengths, rivals, task.n_actions, self.seed, task.groups, on_round
        )
        best = best_verdict(verdicts)
        return rivals[best : best + 1], {int(order[k]): verdict for k, verdict in verdicts.items()}


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
