"""What left-out data says of a segmentation, and which of several it prefers.

Candidate segmentations are compared in pairs on the same trajectories: what one costs more than another is
its mean difference over the trajectories, and its standard error that of the paired differences. Candidates
no more than one standard error worse than the best do equally well (the one-standard-error rule of Breiman
et al. 1984); which of those is kept is said by the caller.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int64
from torch import Tensor

__all__ = ["CandidateScores", "best_candidate", "equally_good", "part_sums", "standard_error"]

RECOGNISED = 0.5  # least share of the changes for a segmentation that can be run
ERROR_STRETCHES = 8  # where trajectories are fewer, so many stretches of frames give a standard error


@dataclass(frozen=True)
class CandidateScores:
    """Scores of a segmentation on left-out data, bounded deviances in nats.

    Losses are vectors of one entry for every part of the data (a group of trajectories): the part's sum
    divided by the number of all frames, so that an entry's sum is the mean a frame.

    Attributes:
        recognised: share of the changes that switch functions recognise at their first frame and not before.
        causal: loss when switch functions choose the labels; infinite where nothing was left out for them.
        causal_error: share of frames whose action is wrong, or of variance not explained, likewise.
        hindsight: loss under the segmentation's own labels.
        context: loss when every frame's label comes from the frames around it, the nearest left out.
        alone: loss of a single classifier.
        given: loss in hindsight of the frames whose label was given, alone; None where none was.
    """

    recognised: float
    causal: Float[Tensor, " parts"]
    causal_error: float
    hindsight: Float[Tensor, " parts"]
    context: Float[Tensor, " parts"]
    alone: Float[Tensor, " parts"]
    given: Float[Tensor, " given_parts"] | None = None

    @property
    def gain(self) -> float:
        """By how much the causal loss is below that of a single classifier, nats a frame."""
        return float((self.alone - self.causal).sum())

    @property
    def context_gain(self) -> float:
        """Likewise for the labels that come from the frames around each."""
        return float((self.alone - self.context).sum())

    @property
    def runnable(self) -> bool:
        """Whether a policy can tell when to change, and does better for it than a single classifier."""
        return self.recognised >= RECOGNISED and self.gain > 0

    def scalars(self) -> dict[str, float]:
        """Its numbers by name."""
        losses = ("causal", "hindsight", "context", "alone")
        return {
            "recognised": self.recognised,
            "causal_error": self.causal_error,
            **{f"{name}_loss": float(getattr(self, name).sum()) for name in losses},
        }


def part_sums(
    values: Float[Tensor, " frames"],
    lengths: Int64[Tensor, " trajectories"],
    groups: Int64[Tensor, " trajectories"],
) -> Float[Tensor, " parts"]:
    """Sums over groups of trajectories divided by the number of frames.

    Where there are fewer than `ERROR_STRETCHES` groups the parts are so many stretches of frames.
    """
    part_of = groups.repeat_interleave(lengths)
    if len(groups.unique()) < ERROR_STRETCHES:
        part_of = torch.arange(len(values)) * ERROR_STRETCHES // len(values)
    parts = part_of.unique(return_inverse=True)[1]
    sums = torch.zeros(int(parts.max()) + 1, dtype=values.dtype).index_add(0, parts, values)
    return sums / len(values)


def standard_error(differences: Float[Tensor, " parts"]) -> float:
    """Of a sum over parts, from the spread between them; 0 where there is one part, or nothing is finite."""
    if len(differences) < 2 or not bool(differences.isfinite().all()):
        return 0.0
    return float(differences.std() * len(differences) ** 0.5)


def equally_good(losses: Sequence[Float[Tensor, " parts"]]) -> list[int]:
    """The best of several, least in sum, and those no more than a paired standard error worse than it."""
    best = min(losses, key=lambda loss: float(loss.sum()))
    return [
        place
        for place, loss in enumerate(losses)
        if loss is best or float((loss - best).sum()) <= standard_error(loss - best)
    ]


def best_candidate(candidates: Sequence[CandidateScores], explaining: bool = False) -> int:
    """The number of the candidate to keep.

    Of those that can be run and do equally well by their causal loss, the one whose changes are recognised
    best, of those the one of least causal loss. Where none can be run, the one of least loss in hindsight.

    `explaining` asks first how well labels explain left-out actions, by the loss in hindsight: only
    candidates that do equally well by it come into question, unless others can be run and none of these.
    (Where actions are vectors any two halves of a task differ a little, and the change between them that is
    seen best need not be one of those that explain most.)

    Where labels were given, their loss is asked before all else. Every candidate has those labels; what tells
    candidates apart is whether classifiers that learned from the other trajectories agree with them.
    """
    places = list(range(len(candidates)))
    given = [one.given for one in candidates if one.given is not None]
    if given:
        places = equally_good(given)
    runnable = [place for place in places if candidates[place].runnable]
    if explaining:
        places = [places[k] for k in equally_good([candidates[place].hindsight for place in places])]
        runnable = [place for place in places if place in runnable] or runnable
    if not runnable:
        return min(places, key=lambda place: float(candidates[place].hindsight.sum()))
    close = [runnable[k] for k in equally_good([candidates[place].causal for place in runnable])]
    return max(close, key=lambda k: (candidates[k].recognised, -float(candidates[k].causal.sum())))
