"""What DPBoost accepts: its options, and the features and actions of sequences.

Every error is a ValueError of one line that starts with the argument's name.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, Int64, Num
from torch import Tensor

from dpmacro.boosting.learners.base import WeakLearner
from dpmacro.boosting.losses.base import Loss
from dpmacro.boosting.losses.classes import ExponentialLoss
from dpmacro.boosting.losses.vectors import LOSSES, HuberLoss
from dpmacro.discovery.result import Discovery
from dpmacro.discovery.settings import ORDERS, RECIPES
from dpmacro.discovery.task import Task
from dpmacro.features.levels import SortedLevels
from dpmacro.segmentation.given import FREE
from dpmacro.switching.settings import SwitchSettings
from dpmacro.utils.checks import as_count, as_flag, as_kind, as_number, shown
from dpmacro.utils.tensors import ArrayLike, as_device, as_lengths, as_tensor, as_whole_vector

__all__ = [
    "Standardiser",
    "as_actions",
    "as_device",
    "as_features",
    "as_known",
    "check_fit",
    "check_options",
    "standardised",
    "task_of",
]

ROUNDING = 1e-9  # relative; what varies by less does not vary
MOST_ACTIONS = 2**12  # every frame has a score for each, in every restart
MOST_SEED = 2**63 - 1
MOST_COUNT = 2**31 - 1


def check_options(options: Mapping[str, Any]) -> None:
    """Raise ValueError for the first option of DPBoost that is out of range."""
    for name in ("macros", "rounds", "restarts", "switch_rounds", "switch_window"):
        as_count(name, options[name], 1, MOST_COUNT)
    if options["max_transitions"] is not None:
        as_count("max_transitions", options["max_transitions"], 0)
    as_count("seed", options["seed"], 0, MOST_SEED)
    as_number("shrinkage", options["shrinkage"], above=0.0, most=1.0)
    as_number("switch_weight", options["switch_weight"], least=0.0)
    as_flag("early_stopping", options["early_stopping"])
    recipe = options["recipe"]
    if not isinstance(recipe, str) or recipe not in RECIPES:
        raise ValueError(f"recipe is {shown(recipe)}: choose one of {', '.join(RECIPES)}")
    for name, known in (("loss", LOSSES), ("order", ORDERS)):
        if not isinstance(options[name], str) or options[name] not in known:
            raise ValueError(f"{name} is {shown(options[name])}: choose one of {', '.join(known)}")
    if options["order"] == "chain" and options["max_transitions"] not in (None, options["macros"] - 1):
        raise ValueError(
            f"max_transitions is {shown(options['max_transitions'])} and order 'chain', which has one less "
            f"than macros, {options['macros'] - 1}: leave max_transitions out"
        )
    as_device(options["device"])


def task_of(
    options: Mapping[str, Any],
    data: SortedLevels,
    actions: ArrayLike,
    lengths: ArrayLike,
    groups: Int64[Tensor, " trajectories"] | None,
    given: ArrayLike | None = None,
) -> Task:
    """What DPBoost with these options is to explain. Raises ValueError where that cannot be.

    Args:
        options: of DPBoost, by name.
        data: levels of every frame.
        actions: classes, or standardised vectors.
        lengths: frames of every trajectory.
        groups: numbers 0.. of trajectories to leave out together; alone by default.
        given: labels of some frames that the segmentation keeps to, -1 elsewhere; None for none.
    """
    check_options(options)
    as_kind("data", data, SortedLevels)
    device, n_frames, macros = as_device(options["device"]), data.n_frames, int(options["macros"])
    if data.levels.device != device:
        raise ValueError(f"data is on {data.levels.device} and device is {device}: use one")
    actions, lengths = as_actions(actions, n_frames), as_lengths(lengths, n_frames, "features")
    if macros > n_frames:
        raise ValueError(f"macros is {macros} but there are only {n_frames} frames: ask for fewer")
    if options["early_stopping"] and len(lengths) == 1:
        raise ValueError(
            "early_stopping leaves trajectories out and lengths has one: give more, or give False"
        )
    if options["order"] == "chain" and int(lengths.min()) < macros:
        raise ValueError(
            f"macros is {macros} and order 'chain', but trajectory {int(lengths.argmin())} has "
            f"{int(lengths.min())} frames: ask for fewer macros, or leave it out"
        )
    groups = torch.arange(len(lengths)) if groups is None else _as_groups(groups, len(lengths))
    bound = macros - 1 if options["max_transitions"] is None else int(options["max_transitions"])
    loss: Loss
    if actions.ndim == 1:
        loss = ExponentialLoss(int(actions.max()) + 1)
    else:
        loss = HuberLoss(actions.shape[1], LOSSES[options["loss"]])
    bound = min(bound, int(lengths.max()) - 1)
    seed, order = int(options["seed"]), options["order"]
    task = Task(actions.to(device), lengths, groups, loss, macros, bound, seed, order)
    return task if given is None else _keeping(task, given)


def check_fit(
    task: Task,
    learner: WeakLearner | None,
    switch_learner: WeakLearner | None,
    shrinkage: float | None,
    switches: SwitchSettings | None,
    discovery: Discovery | None,
) -> None:
    """Raise ValueError for the first argument of `DPBoost.fit_levels` that does not fit the task.

    A learner of classifiers holds the task's frames, one of switch functions whole copies of them.
    """
    frames = int(task.lengths.sum())
    for name, one in (("learner", learner), ("switch_learner", switch_learner)):
        if one is None:
            continue
        held = getattr(one, "n_frames", None)
        if not isinstance(held, int) or not callable(getattr(one, "fit", None)):
            raise ValueError(f"{name} is a {type(one).__name__}: give a WeakLearner, like StumpLearner(data)")
        if held != frames and (name == "learner" or held % frames or not held):
            raise ValueError(f"{name} holds {held} frames and data {frames}: make it on these frames")
    if shrinkage is not None:
        as_number("shrinkage", shrinkage, above=0.0, most=1.0)
    if switches is not None:
        as_kind("switches", switches, SwitchSettings)
    if discovery is not None:
        found = as_kind("discovery", discovery, Discovery)
        lengths = task.lengths.tolist()
        if found.drawn is not None and len(found.drawn) == len(lengths):
            lengths = task.lengths[found.drawn.to(task.lengths.device)].tolist()
        searched = found.task.lengths.tolist()
        if searched != lengths:
            raise ValueError(
                f"discovery is of {len(searched)} trajectories with {sum(searched)} frames, and not of these "
                f"{len(lengths)} with {sum(lengths)}: give what discover_levels found of them"
            )


def as_known(known: ArrayLike, task: Task) -> Int64[Tensor, " frames"]:
    """Labels 0..Q-1 of all frames, that take the place of a search's."""
    labels = as_whole_vector("known", known, "[frames], the label of each", least=0, most=task.macros - 1)
    if len(labels) != len(task.actions):
        raise ValueError(
            f"known are {len(labels)} but there are {len(task.actions)} frames: give one for each"
        )
    return labels.to(task.actions.device)


def _as_groups(groups: ArrayLike, count: int) -> Int64[Tensor, " trajectories"]:
    found = as_whole_vector("groups", groups, "[trajectories], the number of each one's group", least=0).cpu()
    if len(found) != count:
        raise ValueError(f"groups are {len(found)} but there are {count} trajectories: give one for each")
    return found


def _keeping(task: Task, given: ArrayLike) -> Task:
    """The task with labels that are given, if any; ValueError where no segmentation keeps to them."""
    shape = "[frames], the label of each and -1 where it is free"
    labels = as_whole_vector("given", given, shape, least=FREE, most=task.macros - 1).cpu()
    if len(labels) != len(task.actions):
        raise ValueError(
            f"given are {len(labels)} but there are {len(task.actions)} frames: give one for each"
        )
    if bool((labels == FREE).all()):
        return task
    task = replace(task, given=labels)
    if task.macros > 1 and task.max_transitions == 0:
        raise ValueError("given are labels and max_transitions is 0, so that nothing is cut: allow 1 or more")
    try:
        task.known  # noqa: B018 - made once, where it raises what is wrong
    except ValueError as error:
        raise ValueError(f"given, {error}") from error
    return task


def as_features(features: ArrayLike, device: torch.device) -> Num[Tensor, "columns frames"]:
    """Finite numbers, column after column, from [frames, columns]."""
    values = as_tensor("features", features, 2, "[frames, columns]").to(device)
    if values.is_floating_point() and not bool(values.isfinite().all()):
        frame, column = (~values.isfinite()).nonzero()[0].tolist()
        raise ValueError(
            f"features[{frame}, {column}] is {values[frame, column].item()}: features must be finite, "
            "leave out or fill what is missing"
        )
    return values.T.contiguous()


@dataclass(frozen=True)
class Standardiser:
    """Vectors to mean 0 and deviation 1 in every dimension, by those of the training."""

    mean: Float[Tensor, " dims"]
    deviation: Float[Tensor, " dims"]  # of a constant dimension 1

    @classmethod
    def fit(cls, vectors: Float[Tensor, "frames dims"]) -> "Standardiser":
        """That of these vectors; a dimension is constant where it varies by rounding alone."""
        mean = vectors.double().mean(0)
        deviation = (vectors.double() - mean).square().mean(0).sqrt()
        constant = deviation <= ROUNDING * mean.abs().clamp(min=ROUNDING)
        return cls(mean, torch.where(constant, 1.0, deviation))

    def apply(self, vectors: Float[Tensor, "frames dims"]) -> Float[Tensor, "frames dims"]:
        """Standardised vectors, float32. Raises ValueError for another number of dimensions."""
        if vectors.shape[1:] != self.mean.shape:
            raise ValueError(
                f"actions have {vectors.shape[1]} dimensions, those of fit had {len(self.mean)}: give as many"
            )
        return ((vectors.double() - self.mean) / self.deviation).float()


def standardised(
    actions: Num[Tensor, "frames *dims"], by: Standardiser | None
) -> Num[Tensor, "frames *dims"]:
    """Vectors as `by` makes them, classes as they are where it is None. ValueError for the other kind."""
    if (actions.ndim == 2) != (by is not None):
        kind = "vectors" if actions.ndim == 1 else "classes"
        raise ValueError(f"actions have shape {list(actions.shape)}, those of fit were {kind}: give the same")
    return actions if by is None else by.apply(actions)


def as_actions(actions: ArrayLike, n_frames: int) -> Num[Tensor, "frames *dims"]:
    """The number of every frame's action, 0 or more, or a vector of finite floating point numbers each."""
    dims = getattr(actions, "ndim", None)
    if dims is None:
        dims = np.ndim(actions)
    if dims == 2:
        found = as_tensor("actions", actions, 2, "[frames] of classes or [frames, dims] of vectors")
        if not found.is_floating_point():
            raise ValueError(
                f"actions are whole numbers of shape {list(found.shape)}: give [frames], the number of each "
                "frame's action, or floating point numbers for vectors"
            )
        wrong = (~found.isfinite()).nonzero()
        if len(wrong):
            frame, dim = wrong[0].tolist()
            raise ValueError(f"actions[{frame}, {dim}] is {found[frame, dim].item()}: actions must be finite")
        if found.shape[1] > 1 and bool(((found == 0) | (found == 1)).all() & (found.sum(1) == 1).all()):
            raise ValueError(
                f"actions are one-hot vectors of shape {list(found.shape)}: give [frames], the number of "
                "each frame's action, like actions.argmax(1)"
            )
    else:
        shape = "[frames], the number 0..M-1 of each frame's action (vectors are [frames, dims])"
        found = as_whole_vector("actions", actions, shape, least=0, most=MOST_ACTIONS - 1)
    if len(found) != n_frames:
        raise ValueError(f"actions are {len(found)} but there are {n_frames} frames: give one for each")
    return found
