"""Macro-labels for demonstrations, new or old: the segmentation that a saved policy's classifiers want."""

from dataclasses import dataclass

import torch
from jaxtyping import Float, Float32, Int64
from torch import Tensor

from dpmacro.boosting import class_targets, exponentials_of
from dpmacro.demonstrations import Demonstrations
from dpmacro.features import frames_before
from dpmacro.learners import Frames
from dpmacro.marginals import margins
from dpmacro.policy import MacroPolicy
from dpmacro.segmentation import segment

__all__ = ["Annotation", "annotate"]

CHUNK = 1024  # frames whose features stand in memory at once


@dataclass(frozen=True)
class Annotation:
    """What a policy says of demonstrations."""

    labels: Int64[Tensor, " frames"]  # macro-action of every frame, 0..Q-1
    confidence: Float32[Tensor, " frames"]  # 0..1, see `annotate`
    cost_by_bound: Float[Tensor, "trajectories bounds"]  # exponential loss with at most s = 0..S transitions


def annotate(
    policy: MacroPolicy, demonstrations: Demonstrations, max_transitions: int | None = None
) -> Annotation:
    """The macro-labels under which the policy's strong classifiers explain the actions best, in hindsight.

    With the costs c_n(q) of the policy's classifiers the bounded segmentation is exact. The confidence of a
    frame is 1 - exp(-d), where d is what the best segmentation with another label there would cost more in
    exponential loss; it says how sharply these classifiers decide, which on the demonstrations they were
    trained on is sharper than on new ones. The switch functions have no say here, unlike in training
    (dpmacro/joint.py), so that a change which the actions leave open may lie elsewhere.

    Args:
        policy: from a training run.
        demonstrations: with the policy's actions and image size.
        max_transitions: S; by default the one that the policy was trained with.

    Raises ValueError where images or actions are not those of the policy.
    """
    config = policy.config
    if tuple(demonstrations.images.shape[1:3]) != config.image_shape:
        height, width = demonstrations.images.shape[1:3]
        wanted = "x".join(map(str, config.image_shape))
        raise ValueError(
            f"{demonstrations.root} has images of {height}x{width}: the policy was trained on {wanted}"
        )
    if len(demonstrations.action_names) != len(config.action_names):
        raise ValueError(
            f"{demonstrations.root} has the actions {', '.join(demonstrations.action_names)}: the policy "
            f"knows {', '.join(config.action_names)}"
        )
    if max_transitions is None:
        max_transitions = config.macros - 1 if config.max_transitions is None else config.max_transitions
    lengths = torch.from_numpy(demonstrations.lengths)
    costs = _costs(policy, demonstrations)
    found = segment(costs, lengths, max_transitions)
    sure = margins(costs, lengths, max_transitions, found.labels)
    confidence = -torch.expm1(-sure.clamp(min=0)).float()
    return Annotation(found.labels.cpu(), confidence.cpu(), found.cost_by_bound.cpu())


@torch.inference_mode()
def _costs(policy: MacroPolicy, demonstrations: Demonstrations) -> Float[Tensor, "frames macros"]:
    """c_n(q) = sum_m exp(-y_n^m f_q^m(x_n)) of every frame."""
    images = torch.from_numpy(demonstrations.images)
    before = frames_before(torch.from_numpy(demonstrations.lengths))
    actions = torch.from_numpy(demonstrations.actions).to(policy.device)
    targets = class_targets(actions, len(policy.config.action_names))
    parts = []
    for frames in torch.arange(len(images)).split(CHUNK):
        current, previous = images[frames].to(policy.device), images[before[frames]].to(policy.device)
        levels = policy.quantiser.levels(policy.features.values(current, previous))
        scores = policy.actor.scores(Frames(levels, current, previous))
        seen = targets[frames.to(policy.device), :, : scores.shape[2]]
        parts.append(exponentials_of(scores, seen).sum(2))
    return torch.cat(parts)
