"""What DPBoost finds: candidate segmentations with their scores, and the one that was fitted."""

from dataclasses import dataclass

from jaxtyping import Float, Int64
from torch import Tensor

from dpmacro.boosting.learners.base import StrongClassifier
from dpmacro.discovery.alternation import Alternated
from dpmacro.discovery.candidates import Candidate, Task, left_out_charges
from dpmacro.discovery.criteria import CandidateScores
from dpmacro.discovery.hindsight import SwitchTerms
from dpmacro.features.quantising import Quantiser
from dpmacro.segmentation.recursion import segment
from dpmacro.segmentation.segments import transition_counts
from dpmacro.switching.functions import SwitchFunctions

__all__ = ["DPBoostResult", "Discovery"]


@dataclass(frozen=True)
class Discovery:
    """Candidate segmentations and what left-out data says of them."""

    task: Task
    alternated: Alternated  # from every initial segmentation
    candidates: tuple[Candidate, ...]  # outcomes, then what the switch functions made of the best of them
    best: int  # the one to keep, a place in `candidates`

    @property
    def macros(self) -> int:
        """Q, of which some may not be used."""
        return self.task.macros

    @property
    def max_transitions(self) -> int:
        """S, no more than the longest trajectory allows."""
        return self.task.max_transitions

    @property
    def changes(self) -> float:
        """Transitions per trajectory of the segmentation to keep."""
        return float(transition_counts(self.kept.labels, self.task.lengths).float().mean())

    @property
    def cost_by_bound(self) -> Float[Tensor, " bounds"]:
        """Nats a frame that left-out classifiers charge the best segmentation under each bound 0, 1, ...

        Macro-actions without frames are left out, and the bounds go up to twice the transitions that the
        segmentation to keep has in any trajectory, plus two.
        """
        charges = left_out_charges(self.kept, self.task)[:, self.kept.used]
        used = self.kept.transitions(self.task.lengths)
        bound = min(2 * used + 2, int(self.task.lengths.max()) - 1)
        return segment(charges, self.task.lengths, bound).cost_by_bound.sum(0) / len(charges)

    @property
    def kept(self) -> Candidate:
        """The one to keep."""
        return self.candidates[self.best]

    @property
    def scores(self) -> tuple[CandidateScores, ...]:
        """What left-out data says of each candidate."""
        return tuple(one.scores for one in self.candidates)


@dataclass(frozen=True)
class DPBoostResult:
    """A segmentation and what was fitted to it.

    Attributes:
        labels: macro-action of every frame, 0..Q-1, each used.
        confidence: 0..1, how sure classifiers that never saw the frame are of its label.
        loss: objective per frame after every round of the final fit.
        classifiers: problems are macro-actions, classes are actions.
        switches: between the macro-actions.
        terms: how the switch functions joined the final segmentation; None where they did not.
        max_transitions: S of the final segmentation.
        unsettled: frames whose label is not the one that the switch functions were fitted to; 0 where the
            final fit settled.
        quantiser: from raw feature columns to levels; None where levels were given.
        discovery: the candidates; None where there was nothing to discover.
        final: the labels scored on left-out data; None likewise.
    """

    labels: Int64[Tensor, " frames"]
    confidence: Float[Tensor, " frames"]
    loss: Float[Tensor, " rounds"]
    classifiers: StrongClassifier
    switches: SwitchFunctions
    terms: SwitchTerms | None
    max_transitions: int
    unsettled: int
    quantiser: Quantiser | None
    discovery: Discovery | None
    final: Discovery | None

    @property
    def macros(self) -> int:
        """The macro-actions that are used."""
        return int(self.labels.max()) + 1

    @property
    def switch_weight(self) -> float:
        """How much the switch functions counted in the final segmentation; 0 where nothing."""
        return 0.0 if self.terms is None else self.terms.weight
