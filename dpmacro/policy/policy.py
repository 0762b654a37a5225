"""MacroPolicy: strong classifiers and switch functions that turn images into actions; saved and read back."""

import json
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path

import torch
from jaxtyping import Bool, Float, Int64, UInt8
from safetensors import SafetensorError
from safetensors.torch import load_file, save_file
from torch import Tensor

from dpmacro.boosting.learners.base import Frames, StrongClassifier
from dpmacro.boosting.learners.kinds import classifier_from, classifier_tensors
from dpmacro.features.base import Encoder
from dpmacro.features.kinds import features_from
from dpmacro.features.quantising import Quantiser
from dpmacro.policy.config import PolicyConfig, read_config
from dpmacro.policy.planner import MacroPlanner, PolicyState
from dpmacro.policy.recovery import RecoveringPlanner, Stretches
from dpmacro.utils.files import replacing

__all__ = ["MacroPolicy", "PolicyState"]

CONFIG_NAME = "config.json"
WEIGHTS_NAME = "model.safetensors"


@dataclass(frozen=True)
class MacroPolicy:
    """At every frame the switch functions of the current macro-action, then its strong classifier, decide.

    The highest switch function above its threshold changes the macro-action; the action with the highest
    f_q^m(x) is taken (Section IV of the paper).
    """

    config: PolicyConfig
    features: Encoder  # just the columns that some stump looks at
    quantiser: Quantiser
    actor: StrongClassifier  # problems are macro-actions, classes are actions
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
        macro, action = (torch.full((batch,), value, device=self.device) for value in (self._first, -1))
        return PolicyState(macro, action)

    def restart(self, state: PolicyState, which: Bool[Tensor, " batch"]) -> PolicyState:
        """The state where the environments of `which` begin anew while the others run on."""
        macro = torch.where(which, self._first, state.macro)
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

    def planner(self, recovery: bool | None = None, *, seed: int = 0) -> MacroPlanner | RecoveringPlanner:
        """A planner for one running environment.

        Args:
            recovery: whether it gets itself out of loops (dpmacro/policy/recovery.py); None for what the
                policy was saved with.
            seed: of recovery's random draws.

        Raises ValueError where recovery is wanted and the policy holds no actions of demonstrators.
        """
        if recovery is None:
            recovery = self.config.recovery
        if not recovery:
            return MacroPlanner(self)
        if self.stretches is None:
            raise ValueError(
                "the policy holds no actions of demonstrators, which recovery replays: train it again, or "
                "run it without recovery"
            )
        return RecoveringPlanner(MacroPlanner(self), self.stretches, seed)

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
    def load(cls, folder: str | Path, device: str | torch.device = "cpu") -> "MacroPolicy":
        """Read a policy that `save` wrote.

        Raises ValueError naming the file where it is missing, unreadable or does not fit the other one.
        """
        folder = Path(folder)
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
        classifier_from(groups["switcher"]) if config.switches or len(config.starts) > 1 else None,
        Stretches.from_tensors(groups["stretches"]) if "stretches" in groups else None,
    )
