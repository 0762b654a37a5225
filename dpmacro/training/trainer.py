"""Trainer: what DPBoost, the baseline and the switch functions share.

Demonstrations become sorted levels once; DPBoost (with one macro-action it is the baseline) and the
switch functions are fitted on them; a policy, its segmentation, pictures and TensorBoard events are saved.
"""

from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Int64
from torch import Tensor
from torch.utils.tensorboard import SummaryWriter
from tqdm import tqdm

from dpmacro import figures
from dpmacro.boosting.crossfit import FOLDS
from dpmacro.boosting.learners.base import WeakLearner
from dpmacro.data.demonstrations import Demonstrations
from dpmacro.discovery.candidates import FINALISTS, LEADERS
from dpmacro.discovery.dpboost import DPBoost, DPBoostResult
from dpmacro.discovery.joint import change_log_odds
from dpmacro.discovery.model_order import Choice, choose
from dpmacro.features.base import FeatureSet, make_features
from dpmacro.features.columns import DRAWN, Demand, Plan, prepare
from dpmacro.features.levels import SortedLevels
from dpmacro.features.quantising import Quantiser
from dpmacro.policy.config import PolicyConfig
from dpmacro.policy.policy import MacroPolicy
from dpmacro.policy.recovery import MAX_ACTIONS, Stretches
from dpmacro.switching.alignment import realigned
from dpmacro.switching.functions import SwitchFunctions, starting_macro
from dpmacro.switching.training import FOLDS as SWITCH_FOLDS
from dpmacro.switching.training import SwitchSettings, fit_switches
from dpmacro.training.learners import WeakLearners, rounds_of, shrinkage_of
from dpmacro.training.monitor import Monitor
from dpmacro.training.options import PlannerOptions, TrainOptions
from dpmacro.training.pictures import TrainingPictures
from dpmacro.training.run_folder import RunFolder

__all__ = ["Trainer", "TrainingResult", "plain_options"]

MIRRORED = 3  # images for one while networks get mirror images: the mirror image, and both in one tensor
TABLES = 10  # float tables of a row per frame while boosting: scores, losses, weights, ...


@dataclass(frozen=True)
class TrainingResult:
    """What a run leaves behind."""

    policy: MacroPolicy
    discovery: DPBoostResult  # its labels with changes moved to where switch functions fire
    switches: SwitchFunctions
    plan: Plan  # how the feature columns were held
    pretrained: Path  # folder to give to eval.py
    choice: Choice | None  # of the number of macro-actions, where it was left open


class Trainer:
    """Runs one training: demonstrations in, a saved policy out.

    Args:
        demonstrations: what to learn from.
        options: how.
        folder: where to write.
    """

    def __init__(self, demonstrations: Demonstrations, options: TrainOptions, folder: RunFolder) -> None:
        self.demonstrations = demonstrations
        self.options = options
        self.folder = folder
        self.actions = torch.from_numpy(demonstrations.actions)
        self.lengths = torch.from_numpy(demonstrations.lengths)
        self._settings = _settings(options.planner)
        most = max(macros for macros, _ in self._settings)
        if most > len(self.actions):
            option = "max_macros" if options.planner.macros == "auto" else "macros"
            raise ValueError(
                f"planner.{option} is {most} but {demonstrations.root} has {len(self.actions)} frames: "
                "ask for fewer"
            )
        if options.planner.early_stopping and int(self._groups.max()) == 0:
            raise ValueError(
                f"planner.early_stopping leaves demonstrations out and {demonstrations.root} has one: "
                "record more, or leave it off"
            )
        if int(self.actions.max()) >= MAX_ACTIONS:
            raise ValueError(
                f"{demonstrations.root} has an action {int(self.actions.max())}: number them from 0, "
                f"a policy holds {MAX_ACTIONS} at most"
            )
        learners = options.planner.learner, options.planner.switch_learner
        height, width = demonstrations.images.shape[1:3]
        if set(learners) != {"stumps"} and min(height, width) < 2:
            raise ValueError(f"images are {height}x{width}: networks need 2x2 pixels at least, use stumps")
        self._generator = torch.Generator().manual_seed(options.seed)
        self._features, self.plan = self._plan()
        self._images = torch.from_numpy(demonstrations.images).to(options.device)
        self._learners = WeakLearners(options.planner, self._images, self.lengths, self.plan.drawn)

    def train(self, start: Int64[Tensor, " frames"] | None = None) -> TrainingResult:
        """Prepare features, discover macro-actions, fit switch functions, save.

        `start` is a segmentation that is known already: it takes the place of the search.
        """
        with SummaryWriter(str(self.folder.tensorboard)) as writer:
            features, quantiser, data = self._prepare()
            choice = self._choose(data, writer) if len(self._settings) > 1 else None
            macros, bound = self._settings[0] if choice is None else choice.setting
            monitor = Monitor(writer, self.demonstrations, macros)
            dpboost, known = self._dpboost(macros, bound), None if choice is None else choice.search
            given = data, self.actions, self.lengths
            if start is not None and macros > 1:
                known = dpboost.adopt(*given, start, monitor.on_round, self._groups)
            discovery = dpboost.fit(*given, monitor.on_round, self._groups, known)
            mirror = self._mirror and discovery.macros > 1
            learner = self._learners.for_switches(data, features, quantiser, mirror)
            settings = self._switch_settings
            fit = partial(self._fit_switches, learner, monitor)
            labels = realigned(partial(fit, replace(settings, focused=False)), discovery.labels, self.lengths)
            discovery, switches = replace(discovery, labels=labels), fit(settings, labels)
            monitor.close()
            policy = self._policy(features, quantiser, discovery, switches)
            pretrained = self._save(policy, discovery)
            pictures = TrainingPictures(writer, self.folder.figures)
            pictures.show(self.demonstrations, policy, discovery, switches)
        return TrainingResult(policy, discovery, switches, self.plan, pretrained, choice)

    def _save(self, policy: MacroPolicy, discovery: DPBoostResult) -> Path:
        """Save the policy and the segmentation; returns its folder."""
        options = plain_options(self.options)
        return self.folder.checkpoint(len(discovery.loss), policy, options, discovery.labels, self.lengths)

    @property
    def _switch_settings(self) -> SwitchSettings:
        planner = self.options.planner
        kind = planner.switch_learner
        return SwitchSettings(
            rounds=rounds_of(planner, kind, planner.switch_rounds),
            window=planner.switch_window,
            shrinkage=shrinkage_of(planner, kind, planner.switch_shrinkage),
            early_stopping=planner.early_stopping,
        )

    def _fit_switches(
        self,
        learner: WeakLearner,
        monitor: Monitor,
        settings: SwitchSettings,
        labels: Int64[Tensor, " frames"],
    ) -> SwitchFunctions:
        return fit_switches(
            learner,
            labels,
            self.lengths,
            torch.Generator().manual_seed(self.options.seed),
            settings,
            groups=self._groups,
            actions=self.actions,
            on_round=monitor.on_round,
        )

    def _dpboost(self, macros: int, max_transitions: int) -> DPBoost:
        planner = self.options.planner
        return DPBoost(
            macros,
            max_transitions,
            rounds_of(planner, planner.learner, planner.rounds),
            self._learners.for_classifiers,
            restarts=planner.restarts,
            seed=self.options.seed,
            device=self.options.device,
            shrinkage=planner.shrinkage,
            fit_shrinkage=shrinkage_of(planner, planner.learner, planner.shrinkage),
            switch_weight=planner.switch_weight,
            early_stopping=planner.early_stopping,
        )

    def _choose(self, data: SortedLevels, writer: SummaryWriter) -> Choice:
        """Search with every setting, one macro-action aside, and choose by data that was left out."""
        searches = []
        for macros, bound in self._settings[1:]:
            monitor = Monitor(writer, self.demonstrations, macros, f"Q{macros}_S{bound}")
            searches.append(
                self._dpboost(macros, bound).search(
                    data, self.actions, self.lengths, monitor.on_round, self._groups
                )
            )
            monitor.close()
        choice = choose(searches)
        chart = figures.selection_chart(choice.points, choice.place, "How many macro-actions?")
        TrainingPictures(writer, self.folder.figures).add("selection", chart)
        return choice

    def _plan(self) -> tuple[FeatureSet, Plan]:
        """The feature set, and how its columns are held."""
        planner = self.options.planner
        n_frames, height, width = self.demonstrations.images.shape[:3]
        features = make_features(planner.features, height, width, planner.rectangles, self._generator)
        most = max(macros for macros, _ in self._settings)
        tried = max(planner.restarts, (FINALISTS + LEADERS) * FOLDS) if most > 1 else 1
        tables = TABLES * 4 * tried * most * (int(self.actions.max()) + 1)
        image_bytes, mirror = self.demonstrations.images[0].size, self._mirror and most > 1
        stumps, networks = planner.switch_learner == "stumps", planner.switch_learner == "convnet"
        switches = TABLES * 4 * most * (most - 1) * (SWITCH_FOLDS + 1) + stumps * DRAWN * planner.switch_drawn
        demand = Demand(
            n_frames,
            image_bytes,
            features.count,
            tables,
            copies=int(mirror and stumps),
            switch_bytes=(1 + mirror) * switches + (mirror and networks) * MIRRORED * image_bytes,
        )
        return features, Plan.fitting(demand, planner.memory_limit)

    def _prepare(self) -> tuple[FeatureSet, Quantiser, SortedLevels]:
        """Features of every frame, quantised and, where memory allows, sorted."""
        with tqdm(desc="Features", total=self.plan.columns, unit="column") as bar:
            parts = self._images, self.lengths, self._features, self.plan, self._generator
            return prepare(*parts, bar.update)

    @property
    def _groups(self) -> Int64[Tensor, " trajectories"]:
        """The number of every trajectory: each is left out alone."""
        return torch.arange(len(self.lengths))

    @property
    def _mirror(self) -> bool:
        """Whether switch functions learn from mirror images, too: in a symmetric world only."""
        given = self.options.dataset.symmetric
        return self.demonstrations.symmetric if given is None else given

    def _policy(
        self,
        features: FeatureSet,
        quantiser: Quantiser,
        discovery: DPBoostResult,
        switches: SwitchFunctions,
    ) -> MacroPolicy:
        demonstrations = self.demonstrations
        height, width = demonstrations.images.shape[1:3]
        config = PolicyConfig(
            type=self.options.planner.type,
            macros=discovery.macros,
            first_macro=starting_macro(discovery.labels, self.lengths),
            action_names=demonstrations.action_names,
            image_shape=(height, width),
            stored_shape=demonstrations.stored_shape,
            features=self.options.planner.features,
            switches=tuple(switches.pairs),
            thresholds=tuple(switches.thresholds.tolist()),
            cues=switches.cues,
            max_transitions=0 if discovery.search is None else discovery.search.kept_transitions,
            switch_weight=discovery.switch_weight,
            change_log_odds=tuple(
                tuple(row)
                for row in change_log_odds(discovery.labels, self.lengths, discovery.macros).tolist()
            ),
            world=demonstrations.world,
        )
        stretches = Stretches.of(discovery.labels, self.actions, self.lengths)
        learned = discovery.classifiers, switches.classifier
        return MacroPolicy.compact(config, features, quantiser, *learned, stretches)


def _settings(planner: PlannerOptions) -> list[tuple[int, int]]:
    """Q and S of every search that the options ask for; where there is a choice, one macro-action first."""
    given = planner.max_transitions
    if planner.type == "baseline":
        return [(1, 0)]
    if isinstance(planner.macros, int):
        return [(planner.macros, planner.macros - 1 if given is None else given)]
    numbers = range(2, planner.max_macros + 1)
    bounds = {macros: (macros - 1, 2 * (macros - 1)) if given is None else (given,) for macros in numbers}
    return [(1, 0), *((macros, bound) for macros in numbers for bound in bounds[macros])]


def plain_options(options: TrainOptions) -> dict[str, Any]:
    """Options as JSON holds them: paths become strings."""
    return _plain(asdict(options))


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {name: _plain(part) for name, part in value.items()}
    return str(value) if isinstance(value, Path) else value
