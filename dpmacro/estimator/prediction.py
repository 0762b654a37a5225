"""What a fitted DPBoost says of sequences that it may never have seen."""

import torch
from jaxtyping import Float, Int64, Num, UInt8
from torch import Tensor

from dpmacro.boosting.learners.base import Frames
from dpmacro.estimator.hindsight import CHUNK, action_costs, switch_terms_costs
from dpmacro.estimator.result import DPBoostResult
from dpmacro.features.quantising import Quantiser
from dpmacro.segmentation.recursion import segment
from dpmacro.switching.functions import predicted_labels

__all__ = ["levels_of", "predicted", "segmented"]

FAR = 2.0**62  # whole numbers beyond are not told apart


def levels_of(quantiser: Quantiser, values: Num[Tensor, "columns frames"]) -> UInt8[Tensor, "columns frames"]:
    """Levels of values whose type need not be that of the cuts.

    Where the cuts are floating point, values are rounded to their precision. A value between two whole
    numbers has the level of the lower one where the cuts are whole.

    Raises ValueError where there are more or fewer columns than the quantiser knows.
    """
    cuts = quantiser.cuts
    if len(values) != len(cuts):
        raise ValueError(f"features have {len(values)} columns, those of fit had {len(cuts)}: give as many")
    if cuts.is_floating_point() or cuts.dtype == values.dtype:
        return quantiser.levels(values.to(cuts.dtype))
    whole = values.double().floor().clamp(-FAR, FAR) if values.is_floating_point() else values
    return Quantiser(cuts.long()).levels(whole.long())


def predicted(
    result: DPBoostResult,
    levels: UInt8[Tensor, "columns frames"],
    lengths: Int64[Tensor, " trajectories"],
) -> tuple[Int64[Tensor, " frames"], Float[Tensor, "frames outputs"]]:
    """Macro-labels of a running policy, frame by frame, never looking ahead, and its scores; on the CPU."""
    switches = result.switches
    scores = torch.cat([result.classifiers.scores(part).cpu() for part in _chunks(levels)])
    first = torch.full((len(lengths),), switches.starts[0])
    margins = torch.zeros(len(scores), 0)
    if switches.classifier is not None:
        own = torch.cat([switches.classifier.scores(part)[:, :, 0].cpu() for part in _chunks(levels)])
        margins = own[:, : len(switches.pairs)] - switches.thresholds
        if len(switches.starts) > 1:
            begun = own[lengths.cumsum(0) - lengths][:, len(switches.pairs) :]
            first = torch.tensor(switches.starts)[begun.argmax(1)]
    return predicted_labels(scores, margins, switches.pairs, switches.cues, lengths, first)


def segmented(
    result: DPBoostResult,
    levels: UInt8[Tensor, "columns frames"],
    actions: Num[Tensor, "frames *dims"],
    lengths: Int64[Tensor, " trajectories"],
) -> Int64[Tensor, " frames"]:
    """The macro-labels of least cost under the bound, in hindsight; on the CPU."""
    costs = action_costs(_chunks(levels), result.classifiers, actions.to(levels.device), result.action_loss)
    changing = None
    if result.terms is not None and result.switches.classifier is not None:
        extra = switch_terms_costs(
            _chunks(levels), result.switches.classifier, result.terms, actions, lengths
        )
        costs, changing = costs + extra.staying, extra.changing
    return segment(costs, lengths, result.max_transitions, changing, result.order).labels.cpu()


def _chunks(levels: UInt8[Tensor, "columns frames"]) -> list[Frames]:
    return [Frames(levels[:, first : first + CHUNK]) for first in range(0, levels.shape[1], CHUNK)]
