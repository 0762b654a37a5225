"""Initial segmentations where actions are classes."""

import torch
from jaxtyping import Int64
from torch import Tensor

from dpmacro.discovery.starts.cuts import feature_peaks, random_cuts, uniform_cuts
from dpmacro.features.levels import SortedLevels
from dpmacro.segmentation.recursion import segment

__all__ = ["action_events", "initial_segmentations"]


def initial_segmentations(
    data: SortedLevels,
    actions: Int64[Tensor, " frames"],
    lengths: Int64[Tensor, " trajectories"],
    restarts: int,
    macros: int,
    max_transitions: int,
    generator: torch.Generator,
) -> Int64[Tensor, "restarts frames"]:
    """Half feature peaks, a quarter action events, one of uniform cuts, the rest of random cuts."""
    n_peaks, n_events, n_uniform = (restarts + 1) // 2, restarts // 4, int(restarts > 3)
    n_random = restarts - n_peaks - n_events - n_uniform
    bounds = macros, max_transitions
    starts = [
        feature_peaks(data, lengths, n_peaks, *bounds, generator),
        action_events(actions, lengths, n_events, *bounds, generator),
        uniform_cuts(lengths, *bounds)[:n_uniform],
        random_cuts(lengths, n_random, *bounds, generator),
    ]
    return torch.cat(starts)


def action_events(
    actions: Int64[Tensor, " frames"],
    lengths: Int64[Tensor, " trajectories"],
    restarts: int,
    macros: int,
    max_transitions: int,
    generator: torch.Generator,
) -> Int64[Tensor, "restarts frames"]:
    """Clusters and cuts by what is done: actions that are taken seldom, like a grasp, make or end a subtask.

    Every restart draws some actions, the rarer the likelier (the first two take the rarest Q - 1). In
    turn, one gives each of Q - 1 of them a macro-action of its own, in the bounded segmentation that agrees
    best with the share of each in a window of frames (one frame wide at first, then drawn); the next begins
    another macro-action after each occurrence of one of up to Q of them, S times at most.
    """
    actions = actions.cpu()
    counts = actions.bincount()
    rarity = torch.where(counts > 0, 1 / counts.clamp(min=1), 0.0)
    others = int((counts > 0).sum()) - 1
    if others == 0 or macros == 1 or restarts == 0:
        return torch.zeros(restarts, len(actions), dtype=torch.int64)
    starts = []
    for restart in range(restarts):
        during, first = restart % 2 == 0, restart < 2
        most = min(macros - 1 if during or first else macros, others)
        size = most if during or first else 1 + int(torch.randint(most, (1,), generator=generator))
        drawn = rarity.topk(size).indices if first else torch.multinomial(rarity, size, generator=generator)
        if during:
            longest = max(float(lengths.float().mean()) / (max_transitions + 1), 1.0)
            exponent = 0.0 if first else float(torch.rand(1, generator=generator))
            window = int(longest**exponent) // 2 * 2 + 1
            starts.append(_during(actions, lengths, drawn, macros, max_transitions, window))
        else:
            starts.append(_after(actions, lengths, drawn, macros, max_transitions))
    return torch.stack(starts)


def _during(
    actions: Tensor, lengths: Tensor, drawn: Tensor, macros: int, max_transitions: int, window: int
) -> Int64[Tensor, " frames"]:
    """Macro-actions 1, 2, ... where the drawn actions are taken most, 0 elsewhere."""
    macro_of = torch.zeros(int(actions.max()) + 1, dtype=torch.int64)
    macro_of[drawn] = torch.arange(1, len(drawn) + 1)
    taken = torch.nn.functional.one_hot(macro_of[actions], macros).double()
    weighted = taken / taken.sum(0).clamp(min=1)
    shares = [
        torch.nn.functional.avg_pool1d(part.T[None], window, 1, window // 2, count_include_pad=False)[0].T
        for part in weighted.split(lengths.tolist())
    ]
    return segment(-torch.cat(shares), lengths, max_transitions).labels


def _after(
    actions: Tensor, lengths: Tensor, drawn: Tensor, macros: int, max_transitions: int
) -> Int64[Tensor, " frames"]:
    """The next macro-action in turn after every stretch of a drawn action."""
    parts = []
    for part in actions.split(lengths.tolist()):
        event = torch.isin(part, drawn)
        ends = event[:-1] & ~(event[1:] & (part[1:] == part[:-1]))
        over = torch.nn.functional.pad(ends.long(), (1, 0)).cumsum(0)
        parts.append(over.clamp(max=max_transitions) % macros)
    return torch.cat(parts)
