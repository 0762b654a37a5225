"""MacroPolicy: strong classifiers and switch functions that turn images into actions; saved and read back."""

import json
from collections.abc import Hashable
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from jaxtyping import Bool, Float, Int64, UInt8
from safetensors import SafetensorError
from safetensors.torch import load_file, save_file
from torch import Tensor

from dpmacro.boosting.learners.base import Frames, StrongClassifier
from dpmacro.boosting.learners.kinds import classifier_from, classifier_tensors
from dpmacro.features.base import FeatureSet, features_from
from dpmacro.features.quantising import Quantiser
from dpmacro.policy.config import PolicyConfig, read_config
from dpmacro.policy.recovery import Recovery, Stretches
from dpmacro.utils.files import replacing

__all__ = ["MacroPlanner", "MacroPolicy", "PolicyState"]

CONFIG_NAME = "config.json"
WEIGHTS_NAME = "model.safetensors"


@dataclass
class PolicyState:
    """Where every running environment of a batch stands."""

    macro: Int64[Tensor, " batch"]
    action: Int64[Tensor, " batch"]  # done last, -1 before the first
    previous: UInt8[Tensor, "batch height width 3"] | None = None  # None before the first frame
    restarted: Bool[Tensor, " batch"] | None = None  # environments whose next frame is their first


@dataclass(frozen=True)
class MacroPolicy:
    """At every frame the switch functions of the current macro-action, then its strong classifier, decide.

    The highest switch function above its threshold changes the macro-action; the action with the highest
    f_q^m(x) is taken (Section IV of the paper).
    """

    config: PolicyConfig
    features: FeatureSet  # just the columns that some stump looks at
    quantiser: Quantiser
    actor: StrongClassifier  # problems are macro-actions, classes are actions
    switcher: StrongClassifier | None  # problems are config.switches, one class
    stretches: Stretches | None = None  # what demonstrators did, for a planner in trouble

    @classmethod
    def compact(
        cls,
        config: PolicyConfig,
        features: FeatureSet,
        quantiser: Quantiser,
        actor: StrongClassifier,
        switcher: StrongClassifier | None,
        stretches: Stretches | None = None,
    ) -> "MacroPolicy":
        """The policy over all columns of the training data, reduced to the columns that it uses."""
        parts = [actor] if switcher is None else [actor, switcher]
        used = torch.cat([part.used_columns() for part in parts]).unique()
        return cls(
            config,
            features.select(used),
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
        first = self.config.first_macro
        macro, action = (torch.full((batch,), value, device=self.device) for value in (first, -1))
        return PolicyState(macro, action)

    def restart(self, state: PolicyState, which: Bool[Tensor, " batch"]) -> PolicyState:
        """The state where the environments of `which` begin anew while the others run on."""
        macro = torch.where(which, self.config.first_macro, state.macro)
        restarted = which if state.restarted is None else state.restarted | which
        action = torch.where(which, -1, state.action)
        return PolicyState(macro, action, state.previous, restarted)

    @torch.inference_mode()
    def act(
        self, images: UInt8[Tensor, "batch height width 3"], state: PolicyState
    ) -> tuple[Int64[Tensor, " batch"], PolicyState]:
        """The action of every environment and its state after this frame; errors as of `decide`."""
        scores, state = self.decide(images, state)
        actions = scores.argmax(1)
        return actions, replace(state, action=actions)

    @torch.inference_mode()
    def decide(
        self, images: UInt8[Tensor, "batch height width 3"], state: PolicyState
    ) -> tuple[Float[Tensor, "batch actions"], PolicyState]:
        """The score of every action, of which the highest is to be taken, and the state but for that action.

        Raises ValueError where the images are not of the size the policy was trained on.
        """
        if tuple(images.shape[1:]) != (*self.config.image_shape, 3):
            wanted = "x".join(map(str, (*self.config.image_shape, 3)))
            raise ValueError(
                f"an image is {'x'.join(map(str, images.shape[1:]))}: the policy was trained on {wanted}"
            )
        previous = images if state.previous is None else state.previous
        if state.restarted is not None:
            previous = torch.where(state.restarted[:, None, None, None], images, previous)
        levels = self.quantiser.levels(self.features.values(images, previous))
        frames = Frames(levels, images, previous)
        macro = self._switch(frames, state)
        scores = self.actor.scores(frames)[torch.arange(len(macro), device=macro.device), macro]
        return scores, PolicyState(macro, state.action, images)

    def _switch(self, frames: Frames, state: PolicyState) -> Int64[Tensor, " batch"]:
        macro = state.macro
        if self.switcher is None:
            return macro
        sources, targets, thresholds = self._routes
        excess = self.switcher.scores(frames)[:, :, 0] - thresholds
        excess = excess.masked_fill((sources != macro[:, None]) | ~self._cued[state.action], -torch.inf)
        highest = excess.max(1)
        return torch.where(highest.values > 0, targets[highest.indices], macro)

    @cached_property
    def _routes(self) -> tuple[Tensor, Tensor, Tensor]:
        """Where each switch function leads from and to, and its threshold."""
        sources, targets = torch.tensor(self.config.switches, device=self.device).unbind(1)
        return sources, targets, torch.tensor(self.config.thresholds, device=self.device)

    @cached_property
    def _cued(self) -> Bool[Tensor, "actions switches"]:
        """Whether each switch function may fire after an action; the last row is for none so far."""
        n_actions, n_switches = len(self.config.action_names), len(self.config.switches)
        after = [[not self.config.cues] * n_switches for _ in range(n_actions + 1)]
        for switch, cues in enumerate(self.config.cues):
            for action in cues:
                after[action][switch] = True
        return torch.tensor(after, device=self.device)

    def planner(self, recovery: bool = True) -> "MacroPlanner":
        """A planner for one running environment; `recovery` is for those in trouble."""
        return MacroPlanner(self, recovery)

    def to(self, device: str | torch.device) -> "MacroPolicy":
        """The policy with its tensors on `device`."""
        tensors = {name: tensor.to(device) for name, tensor in self._tensors().items()}
        return _assemble(self.config, tensors)

    def save(self, folder: Path) -> None:
        """Write config.json and model.safetensors into `folder`, each under a temporary name first."""
        tensors = {name: tensor.detach().cpu().contiguous() for name, tensor in self._tensors().items()}
        with replacing(folder / WEIGHTS_NAME) as path:
            save_file(tensors, path)
        with replacing(folder / CONFIG_NAME) as path:
            path.write_text(json.dumps(asdict(self.config), indent=2) + "\n")

    @classmethod
    def load(cls, folder: Path, device: str | torch.device = "cpu") -> "MacroPolicy":
        """Read a policy that `save` wrote.

        Raises ValueError naming the file where it is missing, unreadable or does not fit the other one.
        """
        for name in (CONFIG_NAME, WEIGHTS_NAME):
            if not (folder / name).is_file():
                raise ValueError(
                    f"{folder} holds no {name}: give the pretrained_model folder of a training run"
                )
        config = read_config(folder / CONFIG_NAME)
        try:
            policy = _assemble(config, load_file(folder / WEIGHTS_NAME, device=str(device)))
            # A frame tells whether the tensors fit one another, before a world is built.
            black = torch.zeros(1, *config.image_shape, 3, dtype=torch.uint8, device=policy.device)
            policy.act(black, policy.initial_state(1))
            return policy
        except (SafetensorError, LookupError, TypeError, ValueError, RuntimeError, OSError) as error:
            raise ValueError(
                f"{folder / WEIGHTS_NAME} cannot be read ({error}): train or copy it again"
            ) from error

    def _tensors(self) -> dict[str, Tensor]:
        groups = {"features": self.features.tensors(), "actor": classifier_tensors(self.actor)}
        if self.switcher is not None:
            groups["switcher"] = classifier_tensors(self.switcher)
        if self.stretches is not None:
            groups["stretches"] = self.stretches.tensors()
        named = {f"{group}.{name}": value for group, part in groups.items() for name, value in part.items()}
        return {**named, "quantiser.cuts": self.quantiser.cuts}


class MacroPlanner:
    """A policy in one running environment; it sees the observation's `pixels` and nothing else.

    With `recovery`, and a policy that knows what demonstrators did, it gets itself out of circles.
    """

    def __init__(self, policy: MacroPolicy, recovery: bool = True) -> None:
        self.policy = policy
        known = policy.stretches if recovery else None
        self._recovery = None if known is None else Recovery(known, policy.config.macros)
        self._state = policy.initial_state(1)

    @property
    def macro(self) -> int:
        """The current macro-action."""
        return int(self._state.macro[0])

    @property
    def memory(self) -> Hashable:
        """All of its state but the frame before (see `rollouts.Planner`); None with recovery, which draws."""
        return None if self._recovery is not None else (self.macro, int(self._state.action[0]))

    def reset(self, env: gym.Env | None = None) -> None:
        """Begin an episode; of which environment does not matter."""
        self._state = self.policy.initial_state(1)
        if self._recovery is not None:
            self._recovery.reset()

    def act(self, observation: dict[str, np.ndarray], info: dict[str, Any]) -> int:
        """The action for the frame that the environment shows now.

        It has the size that the demonstrations were stored with, and is shrunk as they were. Raises
        ValueError where it has not.
        """
        pixels = self.policy.config.sight.of(observation["pixels"], "the observation")
        images, before = torch.from_numpy(pixels)[None], self._state.previous
        scores, self._state = self.policy.decide(images.to(self.policy.device), self._state)
        if self._recovery is None:
            action = int(scores[0].argmax())
        else:
            seen = images if before is None else torch.cat([images, before.cpu()])
            action = self._recovery.act(seen.numpy().tobytes(), self.macro, scores[0].cpu().numpy())
        self.took(action)
        return action

    def took(self, action: int) -> None:
        """Say what was done in place of the action that `act` gave."""
        self._state = replace(self._state, action=torch.tensor([action], device=self.policy.device))


def _assemble(config: PolicyConfig, tensors: dict[str, Tensor]) -> MacroPolicy:
    groups: dict[str, dict[str, Tensor]] = {}
    for name, tensor in tensors.items():
        group, _, field_name = name.partition(".")
        groups.setdefault(group, {})[field_name] = tensor
    return MacroPolicy(
        config,
        features_from(config.features, *config.image_shape, groups["features"]),
        Quantiser(**groups["quantiser"]),
        classifier_from(groups["actor"]),
        classifier_from(groups["switcher"]) if config.switches else None,
        Stretches.from_tensors(groups["stretches"]) if "stretches" in groups else None,
    )
