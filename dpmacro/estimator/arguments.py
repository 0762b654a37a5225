"""What DPBoost accepts: its options, and the features and actions of sequences.

Every error is a ValueError of one line that starts with the argument's name.
"""

from collections.abc import Mapping
from typing import Any

import torch
from jaxtyping import Int64, Num
from torch import Tensor

from dpmacro.discovery.settings import RECIPES
from dpmacro.utils.checks import (
    ArrayLike,
    as_count,
    as_flag,
    as_number,
    as_tensor,
    as_whole_vector,
    shown,
)

__all__ = ["as_actions", "as_device", "as_features", "check_options", "check_sizes"]

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
    as_device(options["device"])


def check_sizes(macros: int, early_stopping: bool, n_frames: int, n_trajectories: int) -> None:
    """Raise ValueError where there is too little data for the options."""
    if macros > n_frames:
        raise ValueError(f"macros is {macros} but there are only {n_frames} frames: ask for fewer")
    if early_stopping and n_trajectories == 1:
        raise ValueError(
            "early_stopping leaves trajectories out and lengths has one: give more, or give False"
        )


def as_device(device: Any) -> torch.device:
    """The device that tensors can be put on; "cuda" becomes the card that it means.

    Raises ValueError for one that does not exist here, or holds no values.
    """
    if not isinstance(device, str | torch.device):
        raise ValueError(f"device is {shown(device)}: give its name, 'cpu' or 'cuda:0' say")
    try:
        probe = torch.zeros(1, device=device)
        probe.item()
    except (RuntimeError, AssertionError, TypeError, ValueError) as error:
        raise ValueError(f"device is {shown(str(device))}, which cannot be used here: give 'cpu'") from error
    return probe.device


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


def as_actions(actions: ArrayLike, n_frames: int) -> Int64[Tensor, " frames"]:
    """The number of every frame's action, 0 or more."""
    shape = "[frames], the number 0..M-1 of each frame's action"
    found = as_whole_vector("actions", actions, shape, least=0, most=MOST_ACTIONS - 1)
    if len(found) != n_frames:
        raise ValueError(f"actions are {len(found)} but there are {n_frames} frames: give one for each")
    return found
