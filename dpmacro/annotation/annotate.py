"""Macro-labels for demonstrations, new or old: the segmentation that a saved policy's classifiers want."""

from collections.abc import Iterator
from dataclasses import dataclass

import torch
from jaxtyping import Float, Float32, Int64
from torch import Tensor

from dpmacro.boosting.learners.base import Frames
from dpmacro.data.demonstrations import Demonstrations
from dpmacro.estimator.hindsight import CHUNK, SwitchTerms, action_costs, switch_terms_costs
from dpmacro.features.history import Recording
from dpmacro.policy.policy import MacroPolicy
from dpmacro.segmentation.marginals import margins
from dpmacro.segmentation.recursion import segment
from dpmacro.utils.checks import as_kind

__all__ = ["Annotation", "annotate"]


@dataclass(frozen=True)
class Annotation:
    """What a policy says of demonstrations."""

    labels: Int64[Tensor, " frames"]  # macro-action of every frame, 0..Q-1
    confidence: Float32[Tensor, " frames"]  # 0..1, see `annotate`
    cost_by_bound: Float[Tensor, "trajectories bounds"]  # loss with at most s = 0..S transitions


def annotate(
    policy: MacroPolicy, demonstrations: Demonstrations, max_transitions: int | None = None
) -> Annotation:
    """The macro-labels under which the policy's strong classifiers explain the actions best, in hindsight.

    With the costs c_n(q) of the policy's classifiers the bounded segmentation is exact. The confidence of a
    frame is 1 - exp(-d), where d is what the best segmentation with another label there would cost more in
    loss; it says how sharply these classifiers decide, which on the demonstrations they were
    trained on is sharper than on new ones. Where switch functions had a say in the training's segmentation
    (dpmacro/switching/costs.py), the policy's have theirs here, on the frames on which they may fire. On the
    demonstrations that the policy was trained on the labels are those that the training reported, where it
    was given none.

    Args:
        policy: from a training run.
        demonstrations: with the policy's inputs and actions.
        max_transitions: S; by default the one that the policy was trained with. A chain has no other.

    Raises ValueError where inputs or actions are not those of the policy. Actions without names are its first
    ones.
    """
    config = as_kind("policy", policy, MacroPolicy).config
    as_kind("demonstrations", demonstrations, Demonstrations)
    _check(policy, demonstrations)
    if max_transitions is None:
        max_transitions = config.macros - 1 if config.max_transitions is None else config.max_transitions
    lengths = torch.from_numpy(demonstrations.lengths)
    costs, changing = _costs(policy, demonstrations)
    found = segment(costs, lengths, max_transitions, changing, config.order)
    sure = margins(costs, lengths, max_transitions, found.labels, changing, config.order)
    confidence = -torch.expm1(-sure.clamp(min=0)).float()
    return Annotation(found.labels.cpu(), confidence.cpu(), found.cost_by_bound.cpu())


def _check(policy: MacroPolicy, demonstrations: Demonstrations) -> None:
    """Raise ValueError where the demonstrations' inputs or actions are not those of the policy."""
    config, root, shown = policy.config, demonstrations.root, demonstrations.observations
    for key, one in config.inputs.items():
        if key not in shown:
            raise ValueError(f"{root} has no {key}, which the policy sees: it has {', '.join(shown)}")
        sizes = [
            f"images of {shape[1]}x{shape[0]}"
            if one.is_camera and len(shape) == 3
            else f"shape {list(shape)}"
            for shape in (shown[key].shape[1:], one.shape)
        ]
        if sizes[0] != sizes[1]:
            raise ValueError(f"{root} has {key} with {sizes[0]}: the policy was trained on {sizes[1]}")
    if demonstrations.vector != config.vector:
        kinds = ("vectors", "classes") if demonstrations.vector else ("classes", "vectors")
        raise ValueError("{} has actions that are {}: those of the policy are {}".format(root, *kinds))
    if config.vector and demonstrations.actions.shape[1] != len(config.action_names):
        raise ValueError(
            f"{root} has actions of {demonstrations.actions.shape[1]} numbers: those of the policy have "
            f"{len(config.action_names)}"
        )
    if not config.vector and not _same_actions(demonstrations.action_names, config.action_names):
        raise ValueError(
            f"{root} has the actions {', '.join(demonstrations.action_names)}: the policy "
            f"knows {', '.join(config.action_names)}"
        )


def _same_actions(names: tuple[str, ...], known: tuple[str, ...]) -> bool:
    """Whether actions 0..M-1 of these names are those of a policy."""
    numbers = tuple(map(str, range(max(len(names), len(known)))))
    if names == numbers[: len(names)]:
        return len(names) <= len(known)
    return names == known or (known == numbers[: len(known)] and len(names) == len(known))


@torch.inference_mode()
def _costs(
    policy: MacroPolicy, demonstrations: Demonstrations
) -> tuple[Float[Tensor, "frames macros"], Float[Tensor, "frames macros macros"] | None]:
    """Every frame's cost under every macro-action, and what changes cost; None where they cost nothing."""
    lengths = torch.from_numpy(demonstrations.lengths)
    config, transform = policy.config, policy.config.actions
    actions = torch.from_numpy(demonstrations.actions)
    if transform is not None:
        state = demonstrations.observations.get(config.action_state)
        actions = torch.from_numpy(transform.targets(demonstrations.actions, state))
    costs = action_costs(_chunks(policy, demonstrations), policy.actor, actions, policy.loss)
    if policy.switcher is None or not config.switch_weight:
        return costs, None
    log_odds = torch.tensor(config.change_log_odds)
    terms = SwitchTerms(config.switches, config.cues, log_odds, config.switch_weight)
    chunks = _chunks(policy, demonstrations)
    switching = switch_terms_costs(chunks, policy.switcher, terms, actions, lengths)
    return costs + switching.staying, switching.changing


def _chunks(policy: MacroPolicy, demonstrations: Demonstrations) -> Iterator[Frames]:
    """The frames as the policy's classifiers look at them, `CHUNK` at a time."""
    seen = {
        key: torch.from_numpy(demonstrations.observations[key]).to(policy.device)
        for key in policy.features.keys
    }
    lengths = torch.from_numpy(demonstrations.lengths)
    recording = Recording(seen, lengths)
    for first in range(0, int(lengths.sum()), CHUNK):
        yield policy.frames(recording.seen(policy.features, slice(first, first + CHUNK)))
