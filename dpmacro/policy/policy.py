"""MacroPolicy: strong classifiers and switch functions that turn images into actions; saved and read back."""

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import torch
from jaxtyping import Bool, Float, Int64, Num
from safetensors import SafetensorError
from safetensors.torch import load_file, save_file
from torch import Tensor

from dpmacro.boosting.learners.base import Frames, StrongClassifier
from dpmacro.boosting.learners.convnet import ConvNetClassifier
from dpmacro.boosting.learners.kinds import classifier_from, classifier_tensors
from dpmacro.boosting.losses.base import Loss
from dpmacro.boosting.losses.classes import ExponentialLoss
from dpmacro.boosting.losses.vectors import LOSSES, HuberLoss
from dpmacro.features.base import Encoder, Observation, Seen
from dpmacro.features.history import History
from dpmacro.features.kinds import encoder_from
from dpmacro.features.quantising import Quantiser
from dpmacro.policy.config import PolicyConfig
from dpmacro.policy.files import CONFIG_NAME, read_config, write_config
from dpmacro.policy.observation import blank, checked
from dpmacro.policy.planner import MacroPlanner, PolicyState
from dpmacro.policy.recovery import RecoveringPlanner, Stretches
from dpmacro.policy.soundness import check_groups, check_parts, grouped
from dpmacro.utils.checks import as_count, as_kind, as_path, in_a_line, shown
from dpmacro.utils.files import replacing
from dpmacro.utils.tensors import as_device

__all__ = ["WEIGHTS_NAME", "MacroPolicy", "PolicyState"]

WEIGHTS_NAME = "model.safetensors"


@dataclass(frozen=True)
class MacroPolicy:
    """At every frame the switch functions of the current macro-action, then its strong classifier, decide.

    The highest switch function above its threshold changes the macro-action; the class with the highest
    f_q^m(x) is taken (Section IV of the paper), or the vector that f_q(x) stands for.
    """

    config: PolicyConfig
    features: Encoder  # just the columns that some stump looks at
    quantiser: Quantiser
    actor: StrongClassifier  # problems are macro-actions
    switcher: StrongClassifier | None  # problems are config.switches, then several starts; one class
    stretches: Stretches | None = None  # what demonstrators did, which recovery replays

    @classmethod
    def compact(
        cls,
        config: PolicyConfig,
        features: Encoder,
        quantiser: Quantiser,
        actor: StrongClassifier,
        switcher: StrongClassifier | None,
        stretches: Stretches | None = None,
    ) -> "MacroPolicy":
        """The policy over all columns of the training data, reduced to the columns that it uses."""
        parts = [actor] if switcher is None else [actor, switcher]
        used = torch.cat([part.used_columns() for part in parts]).unique()
        kept = features.select(used)
        return cls(
            replace(config, encoder=kept.spec()),
            kept,
            quantiser.select(used),
            actor.renumbered(used),
            None if switcher is None else switcher.renumbered(used),
            stretches,
        )

    @property
    def device(self) -> torch.device:
        """Where its tensors are."""
        return self.quantiser.cuts.device

    def initial_state(self, batch: int) -> PolicyState:
        """The state of `batch` environments before their first frame."""
        as_count("batch", batch)
        macro, action = (torch.full((batch,), value, device=self.device) for value in (self._first, -1))
        return PolicyState(macro, action, History.start(self.features, batch))

    def restart(self, state: PolicyState, which: Bool[Tensor, " batch"]) -> PolicyState:
        """The state where the environments of `which` begin anew while the others run on."""
        as_kind("state", state, PolicyState)
        if not isinstance(which, Tensor) or which.dtype != torch.bool or which.shape != state.macro.shape:
            raise ValueError(f"which is {shown(which)}: give true or false for each of {len(state.macro)}")
        macro = torch.where(which, self._first, state.macro)
        action = torch.where(which, -1, state.action)
        return PolicyState(macro, action, state.history.restart(which))

    @torch.inference_mode()
    def act(
        self, observation: Observation, state: PolicyState
    ) -> tuple[Num[Tensor, "batch *dims"], PolicyState]:
        """The action of every environment, a class or a vector, and the state after; errors as `decide`."""
        scores, state = self.decide(observation, state)
        if self.config.vector:
            return self.restored(scores, observation), state
        actions = scores.argmax(1)
        return actions, replace(state, action=actions)

    @torch.inference_mode()
    def decide(
        self, observation: Observation, state: PolicyState
    ) -> tuple[Float[Tensor, "batch outputs"], PolicyState]:
        """The scores of the current macro-actions, and the state but for the action that is then taken.

        Args:
            observation: the policy's inputs by key, a row for every environment.
            state: of `initial_state`, `restart`, or the frame before.

        Raises ValueError where an input is missing or not of the size the policy was trained on.
        """
        as_kind("state", state, PolicyState)
        seen, history = state.history.push(checked(observation, self.config, self.device))
        frames = self.frames(seen)
        macro = self._switch(frames, state)
        scores = self.actor.scores(frames)[torch.arange(len(macro), device=macro.device), macro]
        return scores, PolicyState(macro, state.action, history, seen)

    def restored(
        self, scores: Float[Tensor, "batch outputs"], observation: Observation
    ) -> Float[Tensor, "batch dims"]:
        """The vectors that scores stand for. Raises ValueError for a policy of classes."""
        transform = self.config.actions
        if transform is None:
            raise ValueError("the policy's actions are classes: its scores stand for no vectors")
        return transform.restore(scores, observation.get(self.config.action_state))

    def frames(self, seen: Seen) -> Frames:
        """What its classifiers look at."""
        levels = self.quantiser.levels(self.features.values(seen))
        if not self._networks:
            return Frames(levels)
        (camera,) = self.config.cameras
        return Frames(levels, seen[0][camera], seen[1][camera])

    @property
    def loss(self) -> Loss:
        """What its classifiers minimise."""
        if self.config.vector:
            return HuberLoss(self.config.outputs, LOSSES[self.config.loss])
        return ExponentialLoss(self.config.outputs)

    @property
    def _networks(self) -> bool:
        parts = [self.actor] if self.switcher is None else [self.actor, self.switcher]
        return any(isinstance(part, ConvNetClassifier) for part in parts)

    def _switch(self, frames: Frames, state: PolicyState) -> Int64[Tensor, " batch"]:
        """The macro-action of every environment at these frames."""
        macro = state.macro
        if self.switcher is None:
            return macro
        scores = self.switcher.scores(frames)[:, :, 0]
        sources, targets, thresholds = self._routes
        if len(self.config.starts) > 1:
            told = self._starts[scores[:, len(sources) :].argmax(1)]
            macro = torch.where(macro < 0, told, macro)
        if not len(sources):
            return macro
        excess = scores[:, : len(sources)] - thresholds
        excess = excess.masked_fill((sources != macro[:, None]) | ~self._cued[state.action], -torch.inf)
        highest = excess.max(1)
        return torch.where(highest.values > 0, targets[highest.indices], macro)

    @property
    def _first(self) -> int:
        """The macro-action that runs start in; -1 where the first frame tells."""
        starts = self.config.starts
        return starts[0] if len(starts) == 1 else -1

    @cached_property
    def _starts(self) -> Int64[Tensor, " starts"]:
        return torch.tensor(self.config.starts, device=self.device)

    @cached_property
    def _routes(self) -> tuple[Tensor, Tensor, Tensor]:
        """Where each switch function leads from and to, and its threshold."""
        pairs = torch.tensor(self.config.switches, dtype=torch.int64, device=self.device).reshape(-1, 2)
        sources, targets = pairs.unbind(1)
        thresholds = [float("inf") if own is None else own for own in self.config.thresholds]
        return sources, targets, torch.tensor(thresholds, device=self.device)

    @cached_property
    def _cued(self) -> Bool[Tensor, "actions switches"]:
        """Whether each switch function may fire after an action; the last row is for none so far."""
        n_actions, n_switches = len(self.config.action_names), len(self.config.switches)
        after = [[not self.config.cues] * n_switches for _ in range(n_actions + 1)]
        for switch, cues in enumerate(self.config.cues):
            for action in cues:
                after[action][switch] = True
        return torch.tensor(after, device=self.device)

    def planner(self, recovery: bool | None = None, *, seed: int = 0) -> MacroPlanner | RecoveringPlanner:
        """A planner for one running environment.

        Args:
            recovery: whether it gets itself out of loops (dpmacro/policy/recovery.py); None for what the
                policy was saved with.
            seed: of recovery's random draws.

        Raises ValueError where recovery is wanted and the policy holds no actions of demonstrators.
        """
        as_count("seed", seed, 0)
        planner, replayed = MacroPlanner(self), self.replayed(recovery)
        return planner if replayed is None else RecoveringPlanner(planner, replayed, seed)

    def replayed(self, recovery: bool | None = None) -> Stretches | None:
        """What recovery replays, None where there is no recovery; argument and errors as of `planner`."""
        if not (self.config.recovery if recovery is None else recovery):
            return None
        if self.stretches is None:
            raise ValueError(
                "the policy holds no actions of demonstrators, which recovery replays: train it again, or "
                "run it without recovery"
            )
        return self.stretches

    def to(self, device: str | torch.device) -> "MacroPolicy":
        """The policy with its tensors on `device`. Raises ValueError for one that is not there."""
        device = as_device(device)
        tensors = {name: tensor.to(device) for name, tensor in self._tensors().items()}
        return _assemble(self.config, tensors)

    def save(self, folder: str | Path) -> None:
        """Write the policy into `folder`, every file under a temporary name first.

        The files are model.safetensors, config.json and two more that LeRobot asks for
        (dpmacro/policy/files.py).
        """
        folder = as_path("folder", folder)
        self.save_weights(folder / WEIGHTS_NAME)
        write_config(self.config, folder)

    def save_weights(self, file: Path) -> None:
        """Write the numbers of the policy, all but its config, as safetensors."""
        tensors = {name: tensor.detach().cpu().contiguous() for name, tensor in self._tensors().items()}
        with replacing(file) as path:
            save_file(tensors, path)

    @classmethod
    def load(cls, folder: str | Path, device: str | torch.device = "cpu") -> "MacroPolicy":
        """Read a policy that `save` wrote.

        Raises ValueError naming the file where it is missing, unreadable or does not fit the other one.
        """
        folder, device = as_path("folder", folder), as_device(device)
        for name in (CONFIG_NAME, WEIGHTS_NAME):
            if not (folder / name).is_file():
                raise ValueError(
                    f"{folder} holds no {name}: give the pretrained_model folder of a training run"
                )
        return cls.load_weights(read_config(folder / CONFIG_NAME), folder / WEIGHTS_NAME, device)

    @classmethod
    def load_weights(
        cls, config: PolicyConfig, file: Path, device: str | torch.device = "cpu"
    ) -> "MacroPolicy":
        """The policy of this config and the numbers that `save_weights` wrote; errors as `load`."""
        try:
            tensors = load_file(file, device=str(device))
            check_groups(config, grouped(tensors))
            policy = _assemble(config, tensors)
            check_parts(**vars(policy))
            # A frame tells whether it runs, before a world is built.
            policy.act(blank(config, policy.device), policy.initial_state(1))
            return policy
        except (SafetensorError, LookupError, TypeError, ValueError, RuntimeError, OSError) as error:
            raise ValueError(f"{file} cannot be read ({in_a_line(error)}): train or copy it again") from error

    def _tensors(self) -> dict[str, Tensor]:
        groups = {"features": self.features.tensors(), "actor": classifier_tensors(self.actor)}
        if self.switcher is not None:
            groups["switcher"] = classifier_tensors(self.switcher)
        if self.stretches is not None:
            groups["stretches"] = self.stretches.tensors()
        named = {f"{group}.{name}": value for group, part in groups.items() for name, value in part.items()}
        return {**named, "quantiser.cuts": self.quantiser.cuts}


def _assemble(config: PolicyConfig, tensors: dict[str, Tensor]) -> MacroPolicy:
    groups = grouped(tensors)
    return MacroPolicy(
        config,
        encoder_from(config.encoder, groups.get("features", {})),
        Quantiser(**groups["quantiser"]),
        classifier_from(groups["actor"]),
        classifier_from(groups["switcher"]) if config.switches or len(config.starts) > 1 else None,
        Stretches.from_tensors(groups["stretches"]) if "stretches" in groups else None,
    )
