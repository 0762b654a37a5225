"""The parts of a policy out of a file: whether they fit one another and its config, before anything runs.

PyTorch would notice some of this, in words of its own; NaN votes, stretches of actions that do not exist or
classifiers of more macro-actions than the config counts would act, and act wrongly.
"""

from collections.abc import Mapping

import torch
from jaxtyping import Float64
from torch import Tensor

from dpmacro.boosting.learners.base import StrongClassifier
from dpmacro.boosting.learners.convnet import KERNEL, ConvNetClassifier
from dpmacro.boosting.learners.stumps import StumpClassifier
from dpmacro.features.base import Encoder
from dpmacro.features.quantising import Quantiser
from dpmacro.features.stored import check_encoder, check_quantiser, check_range, check_tensor
from dpmacro.policy.config import LARGEST, PolicyConfig
from dpmacro.policy.recovery import Stretches

__all__ = ["check_groups", "check_parts", "grouped"]

FRACTIONS = (torch.float32, torch.float64)
LARGEST_WEIGHT = 1e6  # of a network: what three layers make of it stays finite
PARTS = ("features", "quantiser", "actor")  # of every policy; a switcher and stretches are of some


def grouped(tensors: Mapping[str, Tensor]) -> dict[str, dict[str, Tensor]]:
    """The tensors of a file by part and by name, which a dot separates."""
    groups: dict[str, dict[str, Tensor]] = {}
    for name, tensor in tensors.items():
        group, _, field_name = name.partition(".")
        groups.setdefault(group, {})[field_name] = tensor
    return groups


def check_groups(config: PolicyConfig, groups: Mapping[str, Mapping[str, Tensor]]) -> None:
    """Raise ValueError where tensors are missing, or are of parts that the policy does not have.

    Args:
        config: of the policy.
        groups: the tensors by part and name.
    """
    needed = [*PARTS, *(["switcher"] if _asked(config) else [])]
    for part in needed:
        if part not in groups:
            raise ValueError(f"it has no tensors of {part}: a policy like this has {', '.join(needed)}")
    for part, tensors in groups.items():
        unused = part == "switcher" and any(tensor.numel() for tensor in tensors.values())
        if part not in (*needed, "switcher", "stretches") or (unused and not _asked(config)):
            raise ValueError(
                f"it has tensors of {part}, and the config of {', '.join(needed)}: copy both again"
            )
    if list(groups["quantiser"]) != ["cuts"]:
        raise ValueError(f"quantiser has {', '.join(groups['quantiser'])}: give cuts alone")


def check_parts(
    config: PolicyConfig,
    features: Encoder,
    quantiser: Quantiser,
    actor: StrongClassifier,
    switcher: StrongClassifier | None,
    stretches: Stretches | None,
) -> None:
    """Raise ValueError for the first part that does not fit the others; parameters are the policy's."""
    check_encoder(features, {key: one.shape for key, one in config.inputs.items()})
    check_quantiser(quantiser, features)
    reach = _reach("actor", actor, config.macros, config.outputs, features.count)
    _check_vectors(config, reach)
    if switcher is not None:
        _reach("switcher", switcher, _asked(config), 1, features.count)
    networks = any(isinstance(one, ConvNetClassifier) for one in (actor, switcher))
    if networks and [features.needs.get(camera) for camera in config.cameras] != [(0, 1)]:
        raise ValueError(
            f"networks look at one camera, inputs have {len(config.cameras)}: train the policy again"
        )
    if stretches is not None:
        _check_stretches(stretches, config)


def _asked(config: PolicyConfig) -> int:
    """The switch functions, and the starts that the first frame tells."""
    return len(config.switches) + (len(config.starts) if len(config.starts) > 1 else 0)


def _reach(
    name: str, classifier: StrongClassifier, problems: int, outputs: int, columns: int
) -> Float64[Tensor, "problems outputs"]:
    """The largest size that scores can have. Raises ValueError for a classifier of something else."""
    if isinstance(classifier, StumpClassifier):
        rounds = len(classifier.columns) if classifier.columns.ndim else None
        check_tensor(f"columns of {name}", classifier.columns, (torch.int64,), rounds, problems)
        check_tensor(f"thresholds of {name}", classifier.thresholds, (torch.uint8,), rounds, problems)
        check_tensor(f"votes of {name}", classifier.votes, FRACTIONS, rounds, problems, 2, outputs)
        check_range(f"columns of {name}", classifier.columns, 0, columns - 1)
        reach = classifier.votes.double().abs().amax(2).sum(0)
    else:
        assert isinstance(classifier, ConvNetClassifier), "there are two kinds"
        reach = _reach_of_networks(name, classifier, problems, outputs)
    if bool((reach > LARGEST).any()):
        raise ValueError(f"votes of {name} add up to {float(reach.max()):g}: give {LARGEST:g} at most")
    return reach


def _reach_of_networks(
    name: str, nets: ConvNetClassifier, problems: int, outputs: int
) -> Float64[Tensor, "problems outputs"]:
    rounds, narrow = (*nets.first_bias.shape, 0, 0, 0)[0:3:2]
    wide = (*nets.second_bias.shape, 0, 0, 0)[2]
    if not rounds or not narrow or not wide:
        raise ValueError(f"networks of {name} have no round or no channel: train the policy again")
    head, square = (outputs, wide, None, None), (KERNEL, KERNEL)
    shapes: dict[str, tuple[int | None, ...]] = {
        "first": (narrow, 6, *square),
        "first_bias": (narrow,),
        "second": (wide, narrow, *square),
        "second_bias": (wide,),
        "head": head,
        "head_bias": (outputs,),
        "steps": (),
    }
    for part, shape in shapes.items():
        tensor = getattr(nets, part)
        check_tensor(f"{part} of {name}", tensor, (torch.float32,), rounds, problems, *shape)
        if bool((tensor.abs() > LARGEST_WEIGHT).any()):
            raise ValueError(f"{part} of {name} holds more than {LARGEST_WEIGHT:g}: train the policy again")
    return nets.steps.double().abs().sum(0)[:, None].expand(problems, outputs)


def _check_vectors(config: PolicyConfig, reach: Float64[Tensor, "problems outputs"]) -> None:
    """Raise ValueError where the actions that scores stand for may be too large for float32."""
    if config.actions is None:
        return
    scale = torch.tensor(config.actions.scale, dtype=torch.float64)[list(config.actions.kept)]
    most = float((reach.cpu() * scale).max())
    if most > LARGEST:
        raise ValueError(f"votes and scales make actions of {most:g}: give {LARGEST:g} at most")


def _check_stretches(stretches: Stretches, config: PolicyConfig) -> None:
    if config.vector:
        raise ValueError("it has stretches of classes, and the config's actions are vectors: copy both again")
    check_range("actions of stretches", stretches.actions, 0, len(config.action_names) - 1)
    check_range("macros of stretches", stretches.macros, 0, config.macros - 1)
