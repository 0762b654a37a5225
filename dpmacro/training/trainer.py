"""Trainer: what DPBoost, the baseline and the switch functions share.

Demonstrations become sorted levels once; DPBoost (with one macro-action it is the baseline) and the
switch functions are fitted on them; a policy, its segmentation, pictures and TensorBoard events are saved.
"""

import math
from dataclasses import dataclass, replace
from pathlib import Path

import torch
from jaxtyping import Int64
from torch import Tensor

from dpmacro import figures
from dpmacro.data.demonstrations import Demonstrations
from dpmacro.discovery.fields import field_of
from dpmacro.discovery.model_order import Choice, choose, searches
from dpmacro.discovery.order import order_of
from dpmacro.discovery.refinement import fewer
from dpmacro.discovery.result import Discovery
from dpmacro.discovery.settings import paper_switches
from dpmacro.estimator.arguments import task_of
from dpmacro.estimator.dpboost import DPBoost
from dpmacro.estimator.result import DPBoostResult
from dpmacro.features.levels import SortedLevels
from dpmacro.features.memory import Plan
from dpmacro.parallel import ALONE, Ranks
from dpmacro.policy.config import CLASSES, InputConfig, PolicyConfig
from dpmacro.policy.policy import MacroPolicy
from dpmacro.policy.recovery import Stretches
from dpmacro.segmentation.given import FREE
from dpmacro.switching.settings import SwitchSettings
from dpmacro.training.data import Columns, TrainingData, state_key
from dpmacro.training.learners import WeakLearners, rounds_of, shrinkage_of
from dpmacro.training.monitor import Monitor
from dpmacro.training.options import PlannerOptions, TrainOptions
from dpmacro.training.pictures import TrainingPictures
from dpmacro.training.run_folder import RunFolder, plain_options
from dpmacro.utils.events import Events

__all__ = ["Trainer", "TrainingResult"]


@dataclass(frozen=True)
class TrainingResult:
    """What a run leaves behind."""

    policy: MacroPolicy
    found: DPBoostResult  # the segmentation and what was fitted to it
    plan: Plan  # how the feature columns were held
    pretrained: Path  # folder to give to eval.py
    choice: Choice | None  # of the number of macro-actions, where it was left open
    notes: tuple[str, ...] = ()  # what a user should know of the choices made with the data
    ranks: Ranks = ALONE  # who trained


class Trainer:
    """Runs one training: demonstrations in, a saved policy out.

    Args:
        demonstrations: what to learn from.
        options: how.
        folder: where the leading rank writes.
        given: labels of some frames that the segmentation keeps to, -1 elsewhere; None for none.
        ranks: who train together, each with a share of the columns.
    """

    def __init__(
        self,
        demonstrations: Demonstrations,
        options: TrainOptions,
        folder: RunFolder,
        given: Int64[Tensor, " frames"] | None = None,
        ranks: Ranks = ALONE,
    ) -> None:
        self.demonstrations = demonstrations
        self.options = options
        self.folder = folder
        self.given = given
        self._settings = _settings(options.planner, demonstrations.vector)
        self._order_notes: tuple[str, ...] = ()
        most, n_frames = max(macros for macros, _ in self._settings), int(demonstrations.lengths.sum())
        if most > n_frames:
            option = "max_macros" if options.planner.macros == "auto" else "macros"
            raise ValueError(
                f"planner.{option} is {most} but {demonstrations.root} has {n_frames} frames: ask for fewer"
            )
        if options.planner.early_stopping and len(demonstrations.lengths) == 1:
            raise ValueError(
                f"planner.early_stopping leaves demonstrations out and {demonstrations.root} has one: "
                "record more, or leave it off"
            )
        if options.planner.recovery and demonstrations.vector:
            raise ValueError(
                "planner.recovery replays discrete actions and those of "
                f"{demonstrations.root} are vectors: leave it off"
            )
        generator = torch.Generator().manual_seed(options.seed)
        self.ranks = ranks
        self.data = TrainingData(demonstrations, options, most, generator, ranks)
        self._learners = WeakLearners(options.planner, self.data)

    def train(self, start: Int64[Tensor, " frames"] | Discovery | None = None) -> TrainingResult:
        """Prepare features, discover macro-actions, fit switch functions, save.

        `start` is a segmentation, or what a search found: it takes the place of the search.
        """
        with Events(self.folder.tensorboard) as writer:
            columns, choice, found = self._learn(writer, start)
            policy = self._policy(columns, found)
            pretrained = self._save(policy, found)
            TrainingPictures(writer, self.folder.figures).show(self.demonstrations, policy, found)
        return TrainingResult(policy, found, self.data.plan, pretrained, choice, self._notes, self.ranks)

    def help(self) -> None:
        """`train` of a rank that does not lead: its share of the work, and nothing written."""
        self._learn(None, None)

    def _learn(
        self, writer: Events | None, start: Int64[Tensor, " frames"] | Discovery | None
    ) -> tuple[Columns, Choice | None, DPBoostResult]:
        """The feature columns, how the number of macro-actions was chosen, and what was found."""
        columns = self.data.prepare()
        if self.options.planner.order == "auto":
            self._ask_the_data_for_an_order(columns.levels)
        choice = self._choose(columns.levels, writer) if len(self._settings) > 1 else None
        if choice is not None and writer is not None:
            chart = figures.selection_chart(choice.points, choice.place, "How many macro-actions?")
            TrainingPictures(writer, self.folder.figures).add("selection", chart)
        macros, bound = self._settings[0] if choice is None else choice.setting
        monitor = Monitor(writer, self.demonstrations, macros)
        if choice is not None and choice.discovery is not None:
            start = choice.discovery
        found = self._fit(columns, self._dpboost(macros, bound), start, monitor)
        monitor.close()
        self.ranks.check_alike(found.labels, found.loss, *found.classifiers.tensors().values())
        return columns, choice, found

    def _fit(
        self,
        columns: Columns,
        dpboost: DPBoost,
        start: Int64[Tensor, " frames"] | Discovery | None,
        monitor: Monitor,
    ) -> DPBoostResult:
        """Search, unless a segmentation is known, then fit classifiers and switch functions to it."""
        planner = self.options.planner
        given = columns.levels, self.data.actions, self.data.lengths
        shared = {"groups": self.data.groups, "given": self.given, "on_round": monitor.on_round}
        if not isinstance(start, Discovery):
            start = dpboost.discover_levels(*given, known=start, **shared)
        mirror = self.data.mirror and dpboost.macros > 1
        return dpboost.fit_levels(
            *given,
            learner=self._learners.for_classifiers(columns.levels),
            switch_learner=self._learners.for_switches(columns, mirror),
            shrinkage=shrinkage_of(planner, planner.learner, planner.shrinkage),
            switches=self._switch_settings,
            discovery=start,
            **shared,
        )

    def _save(self, policy: MacroPolicy, found: DPBoostResult) -> Path:
        """Save the policy and the segmentation; returns its folder."""
        segmentation = found.labels, self.data.lengths
        return self.folder.checkpoint(len(found.loss), policy, plain_options(self.options), *segmentation)

    @property
    def _switch_settings(self) -> SwitchSettings:
        planner = self.options.planner
        kind = planner.switch_learner
        rounds = rounds_of(planner, kind, planner.switch_rounds)
        if planner.recipe == "paper":
            return paper_switches(rounds, planner.switch_window)
        return SwitchSettings(
            rounds=rounds,
            window=planner.switch_window,
            shrinkage=shrinkage_of(planner, kind, planner.switch_shrinkage),
            early_stopping=planner.early_stopping,
        )

    def _dpboost(self, macros: int, max_transitions: int) -> DPBoost:
        planner = self.options.planner
        return DPBoost(
            macros=macros,
            max_transitions=max_transitions,
            rounds=rounds_of(planner, planner.learner, planner.rounds),
            shrinkage=planner.shrinkage,
            restarts=planner.restarts,
            switch_weight=planner.switch_weight,
            early_stopping=planner.early_stopping,
            recipe=planner.recipe,
            loss=planner.loss,
            order="free" if planner.order == "auto" else planner.order,
            seed=self.options.seed,
            device=self.options.device,
        )

    def _ask_the_data_for_an_order(self, data: SortedLevels) -> None:
        """From here on the options have one order, "free" or "chain", and a note says why."""
        planner = self.options.planner
        notes: tuple[str, ...] = ()
        chosen, most = "free", max(macros for macros, _ in self._settings)
        open_ = planner.max_transitions is None and planner.recipe != "paper"
        if self.demonstrations.vector and open_ and most > 1:
            asked = {**self._dpboost(most, most - 1).get_params(), "order": "free"}
            given = data, self.data.actions, self.data.lengths, self.data.groups
            found = order_of(data, task_of(asked, *given))
            chosen = found.chosen
            notes = (
                f"order {chosen}: with {most} stages in one order for all demonstrations linear models leave "
                f"{found.chain:.3g}, in any order {found.free:.3g} (squared error a frame)",
            )
        self.options = replace(self.options, planner=replace(planner, order=chosen))
        self._settings = _settings(self.options.planner, self.demonstrations.vector)
        self._order_notes = notes

    def _choose(self, data: SortedLevels, writer: Events | None) -> Choice:
        """Search with every setting, one macro-action aside, and choose by data that was left out.

        Of vectors there is one search, with most macro-actions, that serves for all numbers of them
        (`refinement.fewer`): one more always explains a little more, and two that differ little are made one.
        """
        vectors, discoveries = self.demonstrations.vector, []
        for macros, bound in self._settings[1:]:
            monitor = Monitor(writer, self.demonstrations, macros, f"Q{macros}_S{bound}")
            shared = {"groups": self.data.groups, "on_round": monitor.on_round}
            given = data, self.data.actions, self.data.lengths
            dpboost = self._dpboost(macros, bound)
            found = dpboost.discover_levels(*given, **shared)
            if found is not None:
                discoveries.append(found)
                if vectors:
                    field = field_of(data, task_of(dpboost.get_params(), *given, self.data.groups))
                    discoveries += fewer(field.data, found, monitor.on_round)
            monitor.close()
        return choose(discoveries)

    @property
    def _notes(self) -> tuple[str, ...]:
        """What the demonstrations and their actions tell of the choices made."""
        told = () if self.data.transform is None else self.data.transform.report()
        kept = () if self.given is None else (self._kept_note,)
        return (*self.demonstrations.notes, *told, *kept, *self._order_notes)

    @property
    def _kept_note(self) -> str:
        assert self.given is not None, "the caller asked"
        parts = self.given.split(self.data.lengths.tolist())
        kept = sum(bool((part != FREE).any()) for part in parts)
        return f"labels of {kept} of {len(parts)} demonstrations are kept as they were given"

    def _policy(self, columns: Columns, found: DPBoostResult) -> MacroPolicy:
        demonstrations, planner, transform = self.demonstrations, self.options.planner, self.data.transform
        state = state_key(demonstrations) if transform is not None and transform.relative else ""
        odds = [] if found.terms is None else found.terms.log_odds.tolist()
        config = PolicyConfig(
            type=planner.type,
            macros=found.macros,
            starts=found.switches.starts,
            inputs={
                key: InputConfig(values.shape[1:], demonstrations.stored_shapes.get(key))
                for key, values in demonstrations.observations.items()
                if key in (*columns.encoder.keys, state)
            },
            encoder=columns.encoder.spec(),
            action_names=demonstrations.action_names,
            outputs=self.data.outputs,
            loss=CLASSES if transform is None else planner.loss,
            action_transform=None if transform is None else transform.to_dict(),
            action_state=state,
            switches=found.switches.pairs,
            thresholds=tuple(None if own == math.inf else own for own in found.switches.thresholds.tolist()),
            cues=found.switches.cues,
            recovery=planner.recovery,
            order=planner.order,
            max_transitions=found.max_transitions,
            switch_weight=found.switch_weight,
            change_log_odds=tuple(tuple(row) for row in odds),
            tasks=demonstrations.tasks,
            world=demonstrations.world,
        )
        stretches = None
        if transform is None:
            stretches = Stretches.of(found.labels, self.data.actions, self.data.lengths)
        seen, learned = (columns.encoder, columns.quantiser), (found.classifiers, found.switches.classifier)
        return MacroPolicy.compact(config, *seen, *learned, stretches)


def _settings(planner: PlannerOptions, vectors: bool) -> list[tuple[int, int]]:
    """Q and S of every search that the options ask for; where there is a choice, one macro-action first."""
    given = planner.max_transitions
    if planner.type == "baseline":
        return [(1, 0)]
    if planner.macros is None:
        raise ValueError("planner.macros is not given: give the number of names that the labels have")
    if isinstance(planner.macros, int):
        return [(planner.macros, planner.macros - 1 if given is None else given)]
    return [(1, 0), *searches(planner.max_macros, given, planner.order, vectors)]
