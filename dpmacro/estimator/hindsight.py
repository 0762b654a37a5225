"""The segmentation that fitted classifiers and switch functions want of frames whose actions are known.

Training ends with it and `annotate` begins with it, on the same numbers in the same order: what a training
reports and what its policy says of the same demonstrations later is the same, bit for bit.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int64, Num
from torch import Tensor

from dpmacro.boosting.learners.base import Frames, StrongClassifier
from dpmacro.boosting.losses.base import Loss
from dpmacro.boosting.losses.classes import MARGIN_LIMIT
from dpmacro.switching.costs import SwitchCosts, charges_of
from dpmacro.switching.functions import cued

__all__ = ["CHUNK", "SwitchTerms", "action_costs", "switch_terms_costs"]

CHUNK = 1024  # frames that are scored at a time: the same everywhere, since sums in floating point hang on it


@dataclass(frozen=True)
class SwitchTerms:
    """How switch functions join the costs of a segmentation.

    Attributes:
        pairs: (from, to) of every switch function.
        cues: actions that each may follow; none stands for any.
        log_odds: of every change in the segmentation that they were fitted to.
        weight: how much they count beside the actions' loss, above 0.
    """

    pairs: tuple[tuple[int, int], ...]
    cues: tuple[tuple[int, ...], ...]
    log_odds: Float[Tensor, "macros macros"]
    weight: float


@torch.inference_mode()
def action_costs(
    chunks: Iterable[Frames], classifiers: StrongClassifier, actions: Num[Tensor, "frames *dims"], loss: Loss
) -> Float[Tensor, "frames macros"]:
    """c_n(q), the loss of every frame's action under every macro-action.

    Args:
        chunks: the frames, `CHUNK` at a time.
        classifiers: problems are macro-actions.
        actions: of every frame; classes that the classifiers do not know cost nothing.
        loss: that of the classifiers.
    """
    costs, first = [], 0
    for frames in chunks:
        scores = classifiers.scores(frames)
        own = actions[first : first + len(scores)].to(scores.device)
        costs.append(loss.terms(scores, loss.targets(own)).sum(2))
        first += len(scores)
    return torch.cat(costs).double()


@torch.inference_mode()
def switch_terms_costs(
    chunks: Iterable[Frames],
    switcher: StrongClassifier,
    terms: SwitchTerms,
    actions: Num[Tensor, "frames *dims"],
    lengths: Int64[Tensor, " trajectories"],
) -> SwitchCosts:
    """What switch functions charge for staying and for changing; where one may not fire, its score is lowest.

    Args as for `action_costs`; `switcher` has a problem for each of the terms' pairs first.
    """
    scores = torch.cat([switcher.scores(frames)[:, : len(terms.pairs), 0] for frames in chunks])
    if terms.cues:
        asked = cued(actions, lengths, terms.cues).to(scores.device)
        scores = scores.masked_fill(~asked, -MARGIN_LIMIT)
    return charges_of(scores, terms.pairs, terms.log_odds.to(scores.device), lengths, terms.weight)
