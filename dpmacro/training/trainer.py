"""Trainer: what DPBoost, the baseline and the switch functions share.

Demonstrations become sorted levels once; DPBoost (with one macro-action it is the baseline) and the
switch functions are fitted on them; a policy, its segmentation, pictures and TensorBoard events are saved.
"""

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Int64
from torch import Tensor
from torch.utils.tensorboard import SummaryWriter
from tqdm import tqdm

from dpmacro import figures
from dpmacro.boosting.crossfit import CLASSIFIER_FOLDS
from dpmacro.data.demonstrations import Demonstrations
from dpmacro.discovery.candidates import FINALISTS, LEADERS
from dpmacro.discovery.model_order import Choice, choose
from dpmacro.discovery.settings import paper_switches
from dpmacro.estimator.dpboost import DPBoost
from dpmacro.estimator.result import DPBoostResult
from dpmacro.features.base import Encoder
from dpmacro.features.columns import prepare
from dpmacro.features.kinds import make_features
from dpmacro.features.levels import SortedLevels
from dpmacro.features.memory import DRAWN, Demand, Plan
from dpmacro.features.quantising import Quantiser
from dpmacro.policy.config import PolicyConfig
from dpmacro.policy.policy import MacroPolicy
from dpmacro.policy.recovery import MAX_ACTIONS, Stretches
from dpmacro.switching.training import SWITCH_FOLDS, SwitchSettings
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
    found: DPBoostResult  # the segmentation and what was fitted to it
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
            found = self._fit(features, quantiser, data, macros, bound, choice, start, monitor)
            monitor.close()
            policy = self._policy(features, quantiser, found)
            pretrained = self._save(policy, found)
            TrainingPictures(writer, self.folder.figures).show(self.demonstrations, policy, found)
        return TrainingResult(policy, found, self.plan, pretrained, choice)

    def _fit(
        self,
        features: Encoder,
        quantiser: Quantiser,
        data: SortedLevels,
        macros: int,
        bound: int,
        choice: Choice | None,
        start: Int64[Tensor, " frames"] | None,
        monitor: Monitor,
    ) -> DPBoostResult:
        """Search, unless a segmentation is known, then fit classifiers and switch functions to it."""
        planner, dpboost = self.options.planner, self._dpboost(macros, bound)
        given = data, self.actions, self.lengths
        shared = {"groups": self._groups, "on_round": monitor.on_round}
        discovery = None if choice is None else choice.discovery
        if discovery is None:
            discovery = dpboost.discover_levels(*given, known=start, **shared)
        mirror = self._mirror and macros > 1
        return dpboost.fit_levels(
            *given,
            learner=self._learners.for_classifiers(data),
            switch_learner=self._learners.for_switches(data, features, quantiser, mirror),
            shrinkage=shrinkage_of(planner, planner.learner, planner.shrinkage),
            switches=self._switch_settings,
            discovery=discovery,
            **shared,
        )

    def _save(self, policy: MacroPolicy, found: DPBoostResult) -> Path:
        """Save the policy and the segmentation; returns its folder."""
        options = plain_options(self.options)
        return self.folder.checkpoint(len(found.loss), policy, options, found.labels, self.lengths)

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
            seed=self.options.seed,
            device=self.options.device,
        )

    def _choose(self, data: SortedLevels, writer: SummaryWriter) -> Choice:
        """Search with every setting, one macro-action aside, and choose by data that was left out."""
        discoveries = []
        for macros, bound in self._settings[1:]:
            monitor = Monitor(writer, self.demonstrations, macros, f"Q{macros}_S{bound}")
            shared = {"groups": self._groups, "on_round": monitor.on_round}
            dpboost = self._dpboost(macros, bound)
            discoveries.append(dpboost.discover_levels(data, self.actions, self.lengths, **shared))
            monitor.close()
        choice = choose([one for one in discoveries if one is not None])
        chart = figures.selection_chart(choice.points, choice.place, "How many macro-actions?")
        TrainingPictures(writer, self.folder.figures).add("selection", chart)
        return choice

    def _plan(self) -> tuple[Encoder, Plan]:
        """The feature set, and how its columns are held."""
        planner = self.options.planner
        n_frames, height, width = self.demonstrations.images.shape[:3]
        features = make_features(planner.features, height, width, planner.rectangles, self._generator)
        most = max(macros for macros, _ in self._settings)
        tried = max(planner.restarts, (FINALISTS + LEADERS) * CLASSIFIER_FOLDS) if most > 1 else 1
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

    def _prepare(self) -> tuple[Encoder, Quantiser, SortedLevels]:
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
        if self.options.planner.recipe == "paper":
            return False
        return self.demonstrations.symmetric if given is None else given

    def _policy(self, features: Encoder, quantiser: Quantiser, found: DPBoostResult) -> MacroPolicy:
        demonstrations, planner = self.demonstrations, self.options.planner
        height, width = demonstrations.images.shape[1:3]
        odds = [] if found.terms is None else found.terms.log_odds.tolist()
        config = PolicyConfig(
            type=planner.type,
            macros=found.macros,
            starts=found.switches.starts,
            action_names=demonstrations.action_names,
            image_shape=(height, width),
            stored_shape=demonstrations.stored_shape,
            features=planner.features,
            switches=found.switches.pairs,
            thresholds=tuple(found.switches.thresholds.tolist()),
            cues=found.switches.cues,
            recovery=planner.recovery,
            max_transitions=found.max_transitions,
            switch_weight=found.switch_weight,
            change_log_odds=tuple(tuple(row) for row in odds),
            world=demonstrations.world,
        )
        stretches = Stretches.of(found.labels, self.actions, self.lengths)
        learned = found.classifiers, found.switches.classifier
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
