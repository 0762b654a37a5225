"""The arguments that every function of this package shares, checked once."""

import torch
from jaxtyping import Bool, Int64, Num
from torch import Tensor

from dpmacro.utils.checks import as_count, shown
from dpmacro.utils.tensors import ArrayLike, as_lengths, as_tensor

__all__ = ["ORDERS", "checked"]

ORDERS = ("free", "chain")  # in which order macro-actions may follow one another
LARGEST = 1e30  # a cost that is allowed: any float holds it, and sums of many stay finite
MOST_TRANSITIONS = 2**20  # a larger bound would fill memory with best costs that are all the same


def checked(
    costs: ArrayLike,
    lengths: ArrayLike,
    max_transitions: int,
    transition_costs: ArrayLike | None,
    order: str = "free",
) -> tuple[Num[Tensor, "frames macros"], Int64[Tensor, " trajectories"], Num[Tensor, "..."] | None]:
    """The arguments of `segment` as tensors, lengths on the CPU; raises the errors that it names."""
    if order not in ORDERS:
        raise ValueError(f"order is {shown(order)}: give {' or '.join(map(repr, ORDERS))}")
    as_count("max_transitions", max_transitions, 0, MOST_TRANSITIONS)
    costs = as_tensor("costs", costs, 2, "[frames, macros], one macro at least")
    lengths = as_lengths(lengths, len(costs), "costs")
    if order == "chain":
        _check_chain(costs.shape[1], lengths, max_transitions)
    _check_sizes("costs", costs)
    if transition_costs is None:
        return costs, lengths, None
    wanted = [*costs.shape, costs.shape[1]]
    transition_costs = as_tensor("transition_costs", transition_costs, 3, f"{wanted}").to(costs.device)
    if list(transition_costs.shape) != wanted:
        raise ValueError(f"transition_costs have shape {list(transition_costs.shape)}: give {wanted}")
    pairs = torch.ones(wanted[1:], dtype=torch.bool, device=costs.device)
    pairs = pairs.triu(1).tril(1) if order == "chain" else pairs.fill_diagonal_(False)
    follows = torch.ones(len(costs), dtype=torch.bool, device=costs.device)
    follows[(lengths.cumsum(0) - lengths).to(costs.device)] = False
    _check_sizes("transition_costs", transition_costs, pairs, follows[:, None, None])
    return costs, lengths, transition_costs


def _check_chain(n_macros: int, lengths: Int64[Tensor, " trajectories"], max_transitions: int) -> None:
    """Raise ValueError where there is not one macro-action a segment, or not one frame a macro-action."""
    if n_macros != max_transitions + 1:
        raise ValueError(
            f"max_transitions is {max_transitions}: give {n_macros - 1}, one less than the macro-actions of "
            f"costs, where order is 'chain'"
        )
    short = (lengths < n_macros).nonzero()
    if len(short):
        place = int(short[0])
        raise ValueError(
            f"lengths[{place}] is {int(lengths[place])}: a chain of {n_macros} macro-actions needs as many "
            f"frames in every trajectory, so give {int(lengths.min())} macro-actions at most or leave short "
            f"trajectories out"
        )


def _check_sizes(name: str, values: Tensor, *read: Bool[Tensor, "..."]) -> None:
    """Raise ValueError where a value is not finite, or larger than `LARGEST`, and all of `read` are true."""
    wrong = ~(values.abs() <= LARGEST)  # NaN is wrong, too
    if not bool(wrong.any()):
        return
    for mask in read:
        wrong &= mask
    if len(places := wrong.nonzero()):
        place = tuple(places[0].tolist())
        raise ValueError(
            f"{name}[{', '.join(map(str, place))}] is {values[place].item()}: give finite costs, "
            f"{LARGEST:g} at most"
        )
